"""How many people there are in a recording, how close and how fast, over time."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from crowdbench.people.recording import CrowdRecording

QUANTILES = (10, 50, 90)
"""Of speeds [%]."""


@dataclass(frozen=True)
class Span:
    """A part of a recording.

    Attributes:
        begin: its first moment [s].
        end: its last [s].
        people: who are there, mean over time.
        density: the same, per square metre of the area walked on [1/m²].
        speeds: ``QUANTILES`` of walking speeds [m/s]; NaN if nobody is there.
    """

    begin: float
    end: float
    people: float
    density: float
    speeds: tuple[float, ...]


def over_time(recording: CrowdRecording, count: int) -> list[Span]:
    """A recording in parts of the same length.

    The area is that of the whole recording, so that densities can be compared.

    Args:
        recording: of whom.
        count: of parts.
    """
    limits = np.linspace(0.0, recording.duration, count + 1)
    return [_span(recording, *pair) for pair in pairwise(limits.tolist())]


def whole(recording: CrowdRecording) -> Span:
    """A recording as one part."""
    return over_time(recording, 1)[0]


def most_people(recording: CrowdRecording) -> int:
    """That are there at the same time."""
    times = np.concatenate([recording.begins, recording.ends])
    change = np.repeat([1, -1], len(recording.begins))
    # Who leaves at the moment when another one appears is still there.
    return int(np.cumsum(change[np.lexsort((-change, times))]).max())


def _span(recording: CrowdRecording, begin: float, end: float) -> Span:
    there = np.minimum(recording.ends, end) - np.maximum(recording.begins, begin)
    people = float(there.clip(min=0).sum()) / (end - begin)
    within = (begin <= recording.times) & (recording.times <= end)
    speeds = recording.speeds[within]
    told = np.percentile(speeds, QUANTILES) if len(speeds) else np.full(len(QUANTILES), np.nan)
    return Span(begin, end, people, people / recording.area, tuple(map(float, told)))
