"""The section of a scenario that says who walks in it, and how."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from crowdbench.extensions import WALKING_MODELS
from crowdbench.messages import Form
from crowdbench.scenario.digest import later
from crowdbench.scenario.fields import (
    NonNegative,
    OneOrRange,
    Positive,
    Range,
    Section,
    Share,
    Speed,
    Text,
    Whole,
    known,
)
from crowdbench.scenario.habits import Attention, Groups, Queue, Stops
from crowdbench.scenario.recorded import MOST, Recording
from crowdbench.scenario.streams import MOST_STREAMS, Streams

Radius = Annotated[Positive, Field(le=2)]


def _named(value: Any) -> Any:
    """Take a path alone for a recording that needs nothing else, and null for none."""
    if value is None:
        return {}
    return {"file": value} if value and isinstance(value, str) else value


class Pedestrians(Section):
    """The people: how many, how they walk, where to, and how many of them are reactive."""

    count: Annotated[int, Field(ge=0, le=MOST, strict=True), Whole] = Field(
        8, description="how many"
    )
    radius: OneOrRange[Radius] = Field(
        0.25, description="of everybody, or a range from which each person's is drawn [m]"
    )
    speed: Range[Speed] = Field(
        (0.3, 0.6), description="preferred walking speed, drawn per person [m/s]"
    )
    speed_mean: Speed | None = later(
        None, "0.2", description="preferred speeds are normal within `speed`, not uniform [m/s]"
    )
    speed_deviation: Positive | None = later(
        None, "0.2", le=10, description="standard deviation of the same [m/s]"
    )
    acceleration: Positive | None = later(
        None, "0.2", le=100, description="limit on how fast a person's velocity changes [m/s2]"
    )
    model: Annotated[Text, known(WALKING_MODELS)] = Field(
        "orca", description="how they avoid others: the name of a walking model"
    )
    recording: Annotated[
        Recording,
        BeforeValidator(_named),
        Form("the path of a recording, a section that has it as `file`, or null"),
    ] = later(
        Recording(),
        "0.2",
        description="the file by which people walk, where the model is `recorded`",
    )
    control: Literal["scripted", "agents"] = Field(
        "scripted", description="agents: each pedestrian is a PettingZoo agent too"
    )
    reactive: Share = Field(1.0, description="share of the pedestrians that see the robot")
    attention: Attention = later(Attention(), "0.2", description="who looks away at times")
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
    leg_from: Literal["position", "goal"] = later(
        "position",
        "0.2",
        description="where a leg starts: where the pedestrian is, or its last goal, so that what "
        "is drawn does not depend on what was in the way",
    )
    streams: Streams = later(
        (),
        "0.2",
        max_length=MOST_STREAMS,
        description="people who walk from region to region; the others walk anywhere",
    )
    stops: Stops = later(Stops(), "0.2", description="on the way to a goal")
    standing: Share = later(
        0.0,
        "0.2",
        description="share of the people that stand in a place of their own; none of them is in a "
        "queue, group or stream",
    )
    groups: Groups = later(Groups(), "0.2", description="people who walk together")
    queues: Annotated[
        tuple[Queue, ...], Form("a list of queues {head: [x, y], direction: 90, count: 5}")
    ] = later((), "0.2", max_length=20, description="lines of people who wait to be served")
    on_arrival: Literal["new_goal", "stop"] = Field(
        "new_goal",
        description="walk on to another goal, or stand still; who has been served in a queue "
        "always walks on",
    )
    spawn_clearance: NonNegative = Field(
        1.0, le=200, description="least gap between a pedestrian and a robot's start, surfaces [m]"
    )

    @property
    def radii(self) -> tuple[float, float]:
        """The smallest and the largest radius [m]."""
        return self.radius if isinstance(self.radius, tuple) else (self.radius, self.radius)

    @model_validator(mode="after")
    def _speeds_can_be_drawn(self) -> Pedestrians:
        low, high = self.speed
        if (self.speed_mean is None) != (self.speed_deviation is None):
            names = ["speed_mean", "speed_deviation"]
            given, lacking = names if self.speed_deviation is None else reversed(names)
            raise ValueError(f"{given}: given without {lacking}; allowed: both or neither")
        if self.speed_mean is not None and not low <= self.speed_mean <= high:
            raise ValueError(
                f"speed_mean: {self.speed_mean:g} m/s lies outside speed; "
                f"allowed: >= {low:g} and <= {high:g}"
            )
        return self
