"""What happens in an episode and when: the moments behind the metrics, for replays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from crowdbench.evaluation.episode import Episode
from crowdbench.evaluation.interactions import cut_offs
from crowdbench.evaluation.social_metrics import TTC_LIMIT, time_to_collision
from crowdbench.simulation.contact import INTENTS

EventKind = Literal[
    "cutoff", "ttc", "switch", "success", "collision", "timeout", "agent_error"
]  # fmt: skip


@dataclass(frozen=True)
class Event:
    """Something that a replay marks.

    Attributes:
        kind: a cut-off, a stretch with a time to collision below ``TTC_LIMIT``, a pedestrian that
            gives up its goal as its hidden intent had it, or how the episode ended.
        first, last: states between which it lasts; the same for a moment.
        pedestrian: whom it concerns; None for an end without one.
        value: time gap of a cut-off, least time to collision of a stretch [s]; else None.
        detail: intent of a switch, what a collision was with, message of an agent's error.
    """

    kind: EventKind
    first: int
    last: int
    pedestrian: int | None = None
    value: float | None = None
    detail: str = ""


def find_events(episode: Episode) -> list[Event]:
    """Everything that a replay marks, in the order in which it begins; the end comes last."""
    found = [*_cut_offs(episode), *_close_calls(episode), *_switches(episode)]
    return [*sorted(found, key=lambda event: (event.first, event.last)), _end(episode)]


def _cut_offs(episode: Episode) -> list[Event]:
    """The crossings that ``cutoff`` counts, at the state that the crossing step leads to."""
    gaps = episode.crossing_gaps
    return [
        Event("cutoff", step + 1, step + 1, pedestrian, float(gaps[step, pedestrian]))
        for step, pedestrian in cut_offs(gaps, episode.control_period)
    ]


def _close_calls(episode: Episode) -> list[Event]:
    """The states that ``ttc_below_1s`` counts, joined to stretches."""
    ttc = time_to_collision(episode)
    below = np.any(ttc < TTC_LIMIT, axis=1)
    edges = np.diff(np.concatenate([[False], below, [False]]).astype(int))
    events = []
    for first, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        stretch = ttc[first:end]
        nearest = int(np.argmin(stretch.min(axis=0)))
        # Row t of the array is the state after action t.
        events.append(Event("ttc", int(first) + 1, int(end), nearest, float(stretch.min())))
    return events


def _switches(episode: Episode) -> list[Event]:
    """Legs that were interrupted: at the first state at which the time for it has come."""
    time = np.arange(episode.steps) * episode.control_period + 1e-9
    due = episode.pedestrian_switch_time[:-1] <= time[:, None]
    return [
        Event("switch", step, step, p, detail=INTENTS[episode.pedestrian_intent[step, p]])
        for step, p in np.argwhere(due).tolist()
    ]


def _end(episode: Episode) -> Event:
    contact, detail = episode.contact, ""
    pedestrian = None
    if episode.outcome == "collision" and contact is not None:
        detail = contact.kind
        pedestrian = contact.index if contact.kind == "pedestrian" else None
    elif episode.outcome == "agent_error":
        detail = episode.error or ""
    return Event(episode.outcome, episode.steps, episode.steps, pedestrian, detail=detail)
