"""What a planner is told: about its robot before an episode, and by it at every step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Scenario


@dataclass(frozen=True)
class RobotSpec:
    """What a planner may know about the robot it drives.

    Attributes:
        name: the robot's name in the environment, e.g. ``robot_0``.
        drive: what an action is: ``differential`` v [m/s], w [rad/s]; ``omnidirectional`` speeds
            ahead and to the left [m/s]; or the name of another drive.
        length, width: footprint [m], centred on the pose, length along the heading.
        speed: lowest and highest forward speed [m/s].
        turn_rate: lowest and highest turn rate [rad/s], left positive; differential drive.
        lateral_speed: lowest and highest speed to the left [m/s]; omnidirectional drive.
        acceleration: limits on the change of either number of an action in a second, or None.
        control_period: time between two actions [s].
        goal_tolerance: distance at which the goal counts as reached [m].
        lidar_angles: (beams,) direction of each beam from the robot's heading [rad], left positive.
        lidar_range: distance a beam reports when it hits nothing [m].
        latency: whole control periods until a command acts; those under way are not observed, but
            an agent can remember what it asked for. Before the first one acts the robot stands.
        lidar_mount: where on the robot the beams begin, x ahead, y left [m], and how far the LiDAR
            is turned to the left [rad], which ``lidar_angles`` have in them.
        goal: where the robot has to get in this episode: x, y [m] in the frame of ``pose``, its own
            at the start; None where no episode is meant. On a map, the observed ``goal`` is a point
            on the way there.
    """

    name: str
    drive: str
    length: float
    width: float
    speed: tuple[float, float]
    turn_rate: tuple[float, float]
    lateral_speed: tuple[float, float]
    acceleration: tuple[float, float] | None
    control_period: float
    goal_tolerance: float
    lidar_angles: NDArray[np.float64]
    lidar_range: float
    latency: int = 0
    lidar_mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    goal: tuple[float, float] | None = None

    @classmethod
    def from_scenario(cls, scenario: Scenario, name: str = "robot_0") -> RobotSpec:
        """The robot that a scenario describes."""
        robots = scenario.robots
        return cls(
            name=name,
            drive=robots.drive,
            length=robots.length,
            width=robots.width,
            speed=robots.speed,
            turn_rate=robots.turn_rate,
            lateral_speed=robots.lateral_speed,
            acceleration=robots.acceleration,
            control_period=scenario.control_period,
            goal_tolerance=robots.goal_tolerance,
            lidar_angles=lidar_angles(scenario) + scenario.lidar.mount[2],
            lidar_range=scenario.lidar.range,
            latency=robots.latency,
            lidar_mount=scenario.lidar.mount,
        )

    @property
    def radius(self) -> float:
        """Radius of the circle around the footprint [m]."""
        return float(np.hypot(self.length, self.width) / 2)

    @property
    def corners(self) -> NDArray[np.float64]:
        """(4, 2) footprint corners in the robot frame, counter-clockwise [m]."""
        x, y = self.length / 2, self.width / 2
        return np.array([[x, y], [-x, y], [-x, -y], [x, -y]])


def lidar_angles(scenario: Scenario) -> NDArray[np.float64]:
    """(beams,) beam directions from the LiDAR's own heading [rad].

    A full circle starts ahead and goes counter-clockwise; a narrower field of view goes from its
    right edge to its left edge.
    """
    beams, view = scenario.lidar.beams, np.deg2rad(scenario.lidar.field_of_view)
    if scenario.lidar.field_of_view >= 360:
        return np.arange(beams, dtype=np.float64) * (2 * np.pi / beams)
    return np.linspace(-view / 2, view / 2, beams) if beams > 1 else np.zeros(1)


@dataclass(frozen=True)
class Observation:
    """What the robot senses at one control step.

    Attributes:
        lidar: (beams,) float32 distances from the LiDAR, ``RobotSpec.lidar_mount`` [m].
        velocity: (2,) float32 what the drive does now, in the terms of an action.
        goal: (2,) float32 goal in the robot frame, x ahead, y left [m]; on a map, the point ahead
            on the shortest path to it.
        pose: (3,) float32 odometry since reset: x, y [m], heading [rad]; starts at zero, and drifts
            where the scenario says so.
        state: everything about the world (``CrowdEnv.state()``); None unless the agent is
            privileged.
    """

    lidar: NDArray[np.float32]
    velocity: NDArray[np.float32]
    goal: NDArray[np.float32]
    pose: NDArray[np.float32]
    state: Mapping[str, NDArray[Any]] | None = field(default=None, repr=False)
