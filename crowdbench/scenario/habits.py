"""Sections of a scenario that say what people do beside walking to their goals."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field

from crowdbench.messages import Form
from crowdbench.scenario.digest import later
from crowdbench.scenario.fields import Number, Positive, Range, Section, Share, Whole

Coordinate = Annotated[Number, Field(ge=-1000, le=1000)]
Members = Annotated[int, Field(ge=2, le=6, strict=True), Whole]
Seconds = Annotated[Positive, Field(le=600)]


class Attention(Section):
    """Some of the reactive pedestrians look away at times, and see no robot then."""

    away_share: Share = later(
        0.0, "0.2", description="share of the reactive pedestrians that look away at times"
    )
    away_for: Range[Seconds] = later((2.0, 5.0), "0.2", description="how long they do [s]")
    every: Range[Seconds] = later(
        (5.0, 10.0), "0.2", description="how long they look around in between [s]"
    )


class Stops(Section):
    """On some of their legs people stop for a while, and then walk on to the same goal."""

    share: Share = later(0.0, "0.2", description="share of the legs on which somebody stops")
    duration: Range[Seconds] = later((2.0, 5.0), "0.2", description="for how long [s]")


class Queue(Section):
    """A line of people who are served one after another.

    Who has been served walks away, and another one joins the end: a queue of ``count`` takes one
    pedestrian more.
    """

    head: Annotated[tuple[Coordinate, Coordinate], Form("two numbers, x and y")] = later(
        (0.0, 0.0), "0.2", description="x and y of the first one's place [m]"
    )
    direction: Annotated[Number, Field(ge=-360, le=360)] = later(
        0.0, "0.2", description="in which they face, the line reaching back from the head [deg]"
    )
    count: Annotated[int, Field(ge=1, le=100, strict=True), Whole] = later(
        5, "0.2", description="how many stand in it"
    )
    spacing: Annotated[Positive, Field(le=10)] = later(
        0.8, "0.2", description="from one place to the next [m]"
    )
    service: Range[Seconds] = later(
        (4.0, 10.0), "0.2", description="how long the first one is served [s]"
    )

    @property
    def facing(self) -> tuple[float, float]:
        """Unit vector in which everybody looks."""
        angle = math.radians(self.direction)
        return math.cos(angle), math.sin(angle)

    def places(self) -> list[tuple[float, float]]:
        """Of everybody in line, the first one's first [m]."""
        x, y = self.facing
        steps = [self.spacing * k for k in range(self.count)]
        return [(self.head[0] - step * x, self.head[1] - step * y) for step in steps]


class Groups(Section):
    """Some of the people walk together: abreast, or behind each other where it is narrow.

    After Moussaid et al., "The walking behaviour of pedestrian social groups and its impact on
    crowd dynamics", PLoS ONE 5(4), 2010, who saw up to 70 % of pedestrians walk in groups of two
    to four.
    """

    share: Share = later(
        0.0,
        "0.2",
        description="share of the people that walk in groups: as many whole groups as it has "
        "people for",
    )
    size: Range[Members] = later(
        (2, 4), "0.2", description="people of a group, least and most, drawn per group"
    )
