"""Sections of a scenario: the place, the robots and their LiDAR, obstacles, the reward."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from crowdbench.extensions import DRIVES
from crowdbench.messages import Form
from crowdbench.scenario.digest import later
from crowdbench.scenario.fields import (
    Mount,
    NonNegative,
    Pair,
    Positive,
    Range,
    Section,
    Share,
    Signed,
    Size,
    Text,
    Weight,
    Whole,
    known,
)
from crowdbench.scenario.places import Box, Centre, Place, Polygons, Regions, Walls


class Arena(Section):
    """Where the scene takes place, by default around the origin; a corridor runs along x."""

    kind: Literal["open", "corridor", "map"] = Field(
        "open", description="a corridor has walls on its long sides, a map those that it says"
    )
    length: Positive = Field(10.0, le=200, description="extent along x [m]; an image says its own")
    width: Positive = Field(10.0, le=200, description="extent along y [m]; an image says its own")
    walls: Walls = later((), "0.2", description="map: thin walls [x1, y1, x2, y2] [m]")
    polygons: Polygons = later((), "0.2", description="map: what is solid, by its corners [m]")
    image: Annotated[Text, Form("the name of a YAML file of map_server")] | None = later(
        None,
        "0.2",
        description="map: YAML file of map_server; read once, what it shows becomes polygons",
    )
    regions: Regions = later(
        {}, "0.2", description="by name: [x_min, y_min, x_max, y_max] or corners of a polygon [m]"
    )
    centre: Centre = later(
        (0.0, 0.0), "0.2", description="map: of the area [m]; an image says its own"
    )

    @property
    def bounds(self) -> Box:
        """x_min, y_min, x_max, y_max [m]"""
        (x, y), half_length, half_width = self.centre, self.length / 2, self.width / 2
        return x - half_length, y - half_width, x + half_length, y + half_width


class Odometry(Section):
    """Noise of the odometry, by which a robot's belief of its own pose drifts away from the truth.

    After the odometry motion model of Thrun, Burgard, Fox, "Probabilistic Robotics" (2005), section
    5.4: each control period is a turn, a way straight on and another turn, and each of the three is
    believed with a normal error whose variance these say.
    """

    rotation: NonNegative = later(
        0.0, "0.2", le=1, description="variance of a turn by its square (alpha_1)"
    )
    rotation_by_translation: NonNegative = later(
        0.0, "0.2", le=1, description="of a turn by the square of the way (alpha_2) [rad²/m²]"
    )
    translation: NonNegative = later(
        0.0, "0.2", le=1, description="of the way by its square (alpha_3)"
    )
    translation_by_rotation: NonNegative = later(
        0.0, "0.2", le=1, description="of the way by the squares of the turns (alpha_4) [m²/rad²]"
    )


class Robots(Section):
    """The robots: how they drive, and their rectangular footprint."""

    count: Annotated[int, Field(ge=1, le=32, strict=True), Whole] = Field(1, description="how many")
    drive: Annotated[Text, known(DRIVES)] = later(
        "differential", "0.2", description="what an action means: the name of a drive"
    )
    length: Positive = Field(0.4, le=5, description="footprint along the heading [m]")
    width: Positive = Field(0.3, le=5, description="footprint across the heading [m]")
    speed: Range[Signed] = Field((0.0, 1.0), description="forward speed [m/s]")
    turn_rate: Range[Signed] = Field(
        (-1.5, 1.5), description="turn rate [rad/s], left positive; differential drive"
    )
    lateral_speed: Range[Signed] = later(
        (-1.0, 1.0), "0.2", description="sideways speed [m/s], left positive; omnidirectional drive"
    )
    acceleration: Pair[Positive] | None = Field(
        None, description="limits on the change of either number of an action in a second"
    )
    latency: Annotated[int, Field(ge=0, le=50, strict=True), Whole] = later(
        0, "0.2", description="whole control periods until a command acts; before, the robot stands"
    )
    odometry: Odometry = later(
        Odometry(), "0.2", description="drift of what the robot believes of its pose"
    )
    travel: Positive = Field(
        8.0, le=200, description="straight distance from start to goal [m]; unless both are given"
    )
    start: Place = later(
        None, "0.2", description="region of arena.regions, or point [x, y], where robots begin"
    )
    goal: Place = later(None, "0.2", description="region or point that they drive to")
    look_ahead: Positive = later(
        3.0,
        "0.2",
        le=200,
        description="map: how far ahead on the shortest path the observed goal is at most [m]",
    )
    goal_tolerance: Positive = Field(0.3, le=5, description="arrival distance [m]")


class Lidar(Section):
    """A planar LiDAR on the robot, by default at its centre."""

    beams: Annotated[int, Field(ge=1, le=4096, strict=True), Whole] = Field(
        180, description="rays per scan, evenly spaced"
    )
    field_of_view: Positive = Field(360.0, le=360, description="centred ahead [deg]")
    range: Positive = Field(6.0, le=100, description="largest distance reported [m]")
    noise: NonNegative = Field(0.0, le=1, description="standard deviation of a distance [m]")
    dropout: Share = Field(0.0, description="share of beams that report the full range")
    mount: Mount = later(
        (0.0, 0.0, 0.0), "0.2", description="where on the robot it is: x, y [m], heading [rad]"
    )


class Obstacles(Section):
    """Static round obstacles, placed at random."""

    count: Annotated[int, Field(ge=0, le=200, strict=True), Whole] = Field(
        0, description="how many"
    )
    radius: Range[Size] = Field((0.3, 0.5), description="drawn per obstacle [m]")


class Reward(Section):
    """Weights of R = R_goal + R_collision + R_social (paper, section III.B)."""

    arrival: Weight = Field(20.0, description="on arrival (r_arrival)")
    progress: Weight = Field(9.0, description="per metre nearer to the goal (w_1)")
    collision: Weight = Field(-60.0, description="on contact (r_collision)")
    proximity: Weight = Field(
        -0.4, description="times 1 - d / proximity_range for the nearest surface (w_2)"
    )
    proximity_range: Positive = Field(
        1.25, le=1000, description="beyond which nothing is near (r + 1 m) [m]"
    )
    social: NonNegative = Field(
        0.2, le=1_000_000, description="times 1 - d / social_radius (w_3); 0 switches it off"
    )
    social_radius: Positive = Field(
        1.2, le=1000, description="beyond which nobody is cut in on (r_s), centres [m]"
    )
    social_horizon: Positive = Field(
        2.0, le=1000, description="how far the interaction is predicted [s]"
    )
