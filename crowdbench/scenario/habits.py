"""Sections of a scenario that say what people do beside walking to their goals."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from crowdbench.scenario.digest import later
from crowdbench.scenario.fields import Positive, Range, Section, Share

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
