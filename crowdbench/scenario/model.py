"""What a scenario may say: every field with its unit and range."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from crowdbench.extensions import DRIVES, WALKING_MODELS
from crowdbench.messages import Form, explain, quoted
from crowdbench.registry import Registry
from crowdbench.scenario import room
from crowdbench.scenario.changes import assign, flatten
from crowdbench.scenario.digest import digest, later
from crowdbench.scenario.errors import ScenarioError

MAX_STEPS = 100_000
"""Control steps of an episode, at most."""


def _whole(value: Any) -> Any:
    """Take 12.0 for 12, as YAML writes 1.2e1."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError(f"the lower bound {pair[0]} exceeds the upper {pair[1]}")
    return pair


def _known(registry: Registry[Any]) -> AfterValidator:
    """Refuse a name that nothing has; what it stands for loads when an environment is made."""

    def check(name: str) -> str:
        if name not in registry:
            raise ValueError(registry.unknown(name))
        return name

    return AfterValidator(check)


T = TypeVar("T")
Whole = BeforeValidator(_whole)
Text = Annotated[str, Field(strict=True)]
# Strict: text and truth values are no numbers.
Number = Annotated[float, Field(strict=True)]
Positive = Annotated[Number, Field(ge=0.001)]
NonNegative = Annotated[Number, Field(ge=0)]
Size = Annotated[Number, Field(ge=0.001, le=20)]
Speed = Annotated[Number, Field(ge=0, le=10)]
Signed = Annotated[Number, Field(ge=-20, le=20)]
Share = Annotated[Number, Field(ge=0, le=1)]
Weight = Annotated[Number, Field(ge=-1_000_000, le=1_000_000)]
Range = Annotated[tuple[T, T], AfterValidator(_ordered), Form("two numbers, lowest then highest")]
Pair = Annotated[tuple[T, T], Form("two numbers, one for each number of an action")]


class _Section(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False
    )


class Arena(_Section):
    """Where the scene takes place; the origin is its centre, a corridor runs along x."""

    kind: Literal["open", "corridor"] = Field(
        "open", description="a corridor has walls on its long sides"
    )
    length: Positive = Field(10.0, le=200, description="extent along x [m]")
    width: Positive = Field(10.0, le=200, description="extent along y [m]")


class Robots(_Section):
    """The robots: how they drive, and their rectangular footprint."""

    count: Annotated[int, Field(ge=1, le=32, strict=True), Whole] = Field(1, description="how many")
    drive: Annotated[Text, _known(DRIVES)] = later(
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
    travel: Positive = Field(8.0, le=200, description="straight distance from start to goal [m]")
    goal_tolerance: Positive = Field(0.3, le=5, description="arrival distance [m]")


class Lidar(_Section):
    """A planar LiDAR at the robot's centre."""

    beams: Annotated[int, Field(ge=1, le=4096, strict=True), Whole] = Field(
        180, description="rays per scan, evenly spaced"
    )
    field_of_view: Positive = Field(360.0, le=360, description="centred ahead [deg]")
    range: Positive = Field(6.0, le=100, description="largest distance reported [m]")
    noise: NonNegative = Field(0.0, le=1, description="standard deviation of a distance [m]")
    dropout: Share = Field(0.0, description="share of beams that report the full range")


class Obstacles(_Section):
    """Static round obstacles, placed at random."""

    count: Annotated[int, Field(ge=0, le=200, strict=True), Whole] = Field(
        0, description="how many"
    )
    radius: Range[Size] = Field((0.3, 0.5), description="drawn per obstacle [m]")


class Pedestrians(_Section):
    """The people: how many, how they walk, where to, and how many of them are reactive."""

    count: Annotated[int, Field(ge=0, le=500, strict=True), Whole] = Field(
        8, description="how many"
    )
    radius: Positive = Field(0.25, le=2, description="of everybody [m]")
    speed: Range[Speed] = Field(
        (0.3, 0.6), description="preferred walking speed, drawn per person [m/s]"
    )
    model: Annotated[Text, _known(WALKING_MODELS)] = Field(
        "orca", description="how they avoid others: the name of a walking model"
    )
    control: Literal["scripted", "agents"] = Field(
        "scripted", description="agents: each pedestrian is a PettingZoo agent too"
    )
    reactive: Share = Field(1.0, description="share of the pedestrians that see the robot")
    field_of_view: Positive = Field(
        220.0, le=360, description="within which a reactive pedestrian sees the robot [deg]"
    )
    responsibility: Share = Field(
        0.5, description="share of an evasion that a pedestrian takes on when meeting the robot"
    )
    goals: Literal["unimodal", "multimodal"] = Field(
        "unimodal", description="multimodal: a leg may be interrupted"
    )
    switch_probability: Share = Field(
        0.5, description="multimodal: chance that a leg is interrupted, half of them to return"
    )
    leg: Positive = Field(
        4.0, le=200, description="least distance from a leg's start to its goal [m]"
    )
    on_arrival: Literal["new_goal", "stop"] = Field(
        "new_goal", description="walk on to another goal, or stand still"
    )
    spawn_clearance: NonNegative = Field(
        1.0, le=200, description="least gap between a pedestrian and a robot's start, surfaces [m]"
    )


class Reward(_Section):
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


class Scenario(_Section):
    """One world to be crossed, complete and immutable.

    Together with an episode seed it fixes everything that happens except what agents decide.
    """

    name: Annotated[Text, Form("1 to 100 letters, digits and _.-")] = Field(
        min_length=1,
        max_length=100,
        pattern=r"^[A-Za-z0-9_.-]+$",
        description="letters, digits and _.-; by default the file's",
    )
    description: Text = Field("", description="what it is like, in a line")
    control_period: Positive = Field(0.2, le=2, description="time between two actions [s]")
    substeps: Annotated[int, Field(ge=1, le=50, strict=True), Whole] = Field(
        4, description="physics steps per control period, at least; fast or small bodies take more"
    )
    time_limit: Positive = Field(40.0, le=3600, description="after which an episode ends [s]")
    arena: Arena = Arena()
    robots: Robots = Robots()
    lidar: Lidar = Lidar()
    obstacles: Obstacles = Obstacles()
    pedestrians: Pedestrians = Pedestrians()
    reward: Reward = Reward()

    @property
    def max_steps(self) -> int:
        """Control steps until the time limit."""
        return max(1, round(self.time_limit / self.control_period))

    @property
    def digest(self) -> str:
        """12 hex digits that change whenever anything about the world changes.

        Name, description and reward weights are left out: they do not change what happens.
        ``later`` fields count only where they differ from their defaults.
        """
        return digest(self, plain=type(self)(name=self.name))

    def override(self, changes: Mapping[str, Any]) -> Scenario:
        """Return a copy with some fields replaced, e.g. ``{"pedestrians.count": 12}``.

        Raises:
            ScenarioError: unknown field or value out of range.
        """
        document = self.model_dump()
        for key, value in flatten(changes).items():
            assign(document, key, value)
        return validate(document, source=self.name)

    @model_validator(mode="after")
    def _it_ends(self) -> Scenario:
        if self.time_limit > (MAX_STEPS + 0.5) * self.control_period:
            raise ValueError(
                f"time_limit {self.time_limit:g} s at control_period {self.control_period:g} s: "
                f"an episode has at most {MAX_STEPS:,} steps; allowed: control_period >= "
                f"{self.time_limit / MAX_STEPS:g} or time_limit <= "
                f"{MAX_STEPS * self.control_period:g}"
            )
        return self

    @model_validator(mode="after")
    def _everybody_fits(self) -> Scenario:
        if problem := room.misfit(self):
            raise ValueError(problem)
        return self


def validate(document: dict[str, Any], source: str) -> Scenario:
    """Make a scenario of a document.

    Raises:
        ScenarioError: names the source, the fields and what is allowed.
    """
    try:
        return Scenario.model_validate(document)
    except ValidationError as error:
        raise ScenarioError(f"scenario {quoted(source)}: {explain(error, Scenario)}") from error
