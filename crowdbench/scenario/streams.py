"""Streams: people who walk from one region to another, through others on the way."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from crowdbench.messages import Form, short
from crowdbench.scenario.fields import Section, Share, Text
from crowdbench.scenario.maps import unknown_region

if TYPE_CHECKING:
    from crowdbench.scenario.model import Scenario
    from crowdbench.scenario.people import Pedestrians

MOST_STREAMS = 32
MOST_VIA = 6
"""Regions on the way of a stream."""
_SLACK = 1e-9


class Stream(Section):
    """People who walk from one region to another; who arrives enters anew in the first."""

    start: Text = Field(description="region of arena.regions in which they enter")
    goal: Text = Field(description="region in which they leave")
    via: Annotated[tuple[Text, ...], Form("a list of regions")] = Field(
        (), max_length=MOST_VIA, description="regions that they walk through, in this order"
    )
    share: Share = Field(1.0, description="of all pedestrians; all shares add up to 1 at most")


Streams = Annotated[
    tuple[Stream, ...], Form("a list of streams {start: region, goal: region, share: 0.5}")
]


def misrouted(scenario: Scenario) -> str:
    """Which stream does not fit the rest, with what is allowed; empty where all do."""
    streams, arena = scenario.pedestrians.streams, scenario.arena
    if streams and scenario.pedestrians.recording.file:
        return "pedestrians.streams: people walk as recorded; allowed: no pedestrians.recording"
    for i, stream in enumerate(streams):
        where = f"pedestrians.streams.{i}"
        for field, name in (
            ("start", stream.start),
            *(("via", name) for name in stream.via),
            ("goal", stream.goal),
        ):
            if problem := unknown_region(name, arena):
                return f"{where}.{field}: {problem}"
        if stream.start == stream.goal:
            return (
                f"{where}.goal: {short(stream.goal)} is the start too; allowed: another region of "
                "arena.regions"
            )
    total = sum(stream.share for stream in streams)
    if total > 1.0 + _SLACK:
        return f"pedestrians.streams: the shares add up to {total:g}; allowed: 1 at most"
    return ""


def stream_sizes(people: Pedestrians) -> list[int]:
    """How many of the people belong to each stream: shares, rounded so that no one is lost."""
    sizes: list[int] = []
    share = 0.0
    for stream in people.streams:
        share += stream.share
        sizes.append(round(share * people.count) - sum(sizes))
    return sizes
