"""People who walk as recorded: when and where, and how those who are reactive leave their way.

A recording is resampled to the control periods of an episode, from a moment on that the seed
draws. People appear where it has them, walk by it, and leave with it; they do not push each other
or stop at walls, since real ones did not overlap. A reactive one that sees a robot walks by ORCA
against robots and walls alone, towards where the recording has it next, and takes on
``pedestrians.responsibility`` of the evasion; behind its recording, it catches up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario.recorded import AHEAD
from crowdbench.simulation.orca import NEIGHBOUR_DISTANCE, orca_velocities
from crowdbench.simulation.walking import Crowd, WalkingModel

if TYPE_CHECKING:
    from crowdbench.people import CrowdRecording

CATCH_UP = 0.5
"""By how much those who have left their way may exceed their recorded speed [m/s]."""
_AWAY, _APART = 10_000.0, 10.0
"""Where people are kept who are not there, and how far from each other [m]."""


@dataclass(frozen=True)
class Tracks:
    """The people of an episode at its control periods.

    Attributes:
        position: (T, P, 2) [m]; NaN where a person is not there.
        period: between two of them [s].
        begin: moment of the recording at which the episode begins [s].
    """

    position: NDArray[np.float64]
    period: float
    begin: float

    @classmethod
    def of(
        cls,
        recording: CrowdRecording,
        origin: NDArray[np.float64],
        begin: float,
        duration: float,
        period: float,
        rows: int,
    ) -> Tracks:
        """Resample a recording.

        Args:
            recording: of the people.
            origin: (2,) its point that becomes the world's origin [m].
            begin: moment at which the episode begins [s].
            duration: of the episode; people are known for ``AHEAD`` longer [s].
            period: of control [s].
            rows: P, for at least as many as are there in that time; the others are never there.
        """
        # Not one more where periods do not add up to it: rows are counted for that time.
        steps = math.floor((duration + AHEAD) / period + 1e-9) + 1
        position = np.full((steps, rows, 2), np.nan)
        row_of: dict[int, int] = {}
        for step in range(steps):
            present = recording.at(begin + step * period)
            for track, place in zip(
                present.tracks.tolist(), present.positions - origin, strict=True
            ):
                position[step, row_of.setdefault(track, len(row_of))] = place
        return cls(position, period, begin)

    def at(self, step: int) -> NDArray[np.float64]:
        """(P, 2) where everybody is in a control period, NaN after the last one [m]."""
        past = step >= len(self.position)
        return np.full_like(self.position[0], np.nan) if past else self.position[step]

    def velocity(self, step: int) -> NDArray[np.float64]:
        """(P, 2) to the next control period, 0 for those who are not there then [m/s]."""
        velocity = (self.at(step + 1) - self.at(step)) / self.period
        return np.where(np.isnan(velocity), 0.0, velocity)

    def ahead(self, step: int) -> NDArray[np.float64]:
        """(AHEAD / period, P, 2) where everybody will be in the control periods to come [m]."""
        count = round(AHEAD / self.period)
        known = self.position[step + 1 : step + 1 + count]
        past = np.full((count - len(known), *known.shape[1:]), np.nan)
        return np.concatenate([known, past])

    def ways(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """First and last place of each person (P, 2) [m], and the mean speed between (P,) [m/s]."""
        there = np.isfinite(self.position[..., 0])
        first, last = there.argmax(axis=0), len(there) - 1 - there[::-1].argmax(axis=0)
        rows = np.arange(self.position.shape[1])
        moved = np.diff(self.position, axis=0)
        steps = np.sqrt((moved * moved).sum(axis=2))
        duration = np.maximum(last - first, 1) * self.period
        begin, end = self.position[first, rows], self.position[last, rows]
        never = ~there.any(axis=0)
        begin[never], end[never] = away(len(rows))[never], away(len(rows))[never]
        return begin, end, np.where(never, 0.0, np.nansum(steps, axis=0) / duration)


def away(count: int) -> NDArray[np.float64]:
    """(P, 2) places far from everything, for people who are not there [m]."""
    return np.column_stack([_AWAY + _APART * np.arange(count), np.full(count, _AWAY)])


def distances(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, M) between points (N, 2) and (M, 2) [m]."""
    offset = a[:, None] - b
    apart: NDArray[np.float64] = np.sqrt((offset * offset).sum(axis=2))
    return apart


class Recorded(WalkingModel):
    """Walks by ``tracks``, which the world sets when the episode begins.

    Attributes:
        tracks: of the people.
        held: (P,) who could not appear, at least once, since a robot was in the way.
    """

    tracks: Tracks
    held: NDArray[np.bool_]

    def follow(self, tracks: Tracks) -> None:
        """Begin an episode."""
        self.tracks = tracks
        self.held = np.zeros(tracks.position.shape[1], dtype=np.bool_)

    def present(
        self,
        before: NDArray[np.bool_],
        reach: NDArray[np.float64],
        robots: NDArray[np.float64],
        step: int,
    ) -> NDArray[np.bool_]:
        """(P,) who is there in a control period.

        Whoever would appear on top of a robot is held back until it has gone on.

        Args:
            before: (P,) who is there so far.
            reach: (P,) distance to a robot at which they touch [m].
            robots: (A, 2) places of those that are still in the scene [m].
            step: the control period.
        """
        places = self.tracks.at(step)
        there = np.isfinite(places[:, 0])
        if len(robots):
            gaps = distances(places, robots).min(axis=1)
            blocked = there & ~before & (gaps <= reach)
            self.held |= blocked
            there &= ~blocked
        return there

    def velocities(self, crowd: Crowd, time: float) -> NDArray[np.float64]:
        """Lead everybody to where the recording has them next."""
        step = round(time / crowd.period)
        velocities = self.tracks.velocity(step)
        places, following = self.tracks.at(step), self.tracks.at(step + 1)
        moving = crowd.present & np.isfinite(following[:, 0])
        wanted = np.where(moving[:, None], (following - crowd.position) / crowd.period, 0.0)
        speed = np.sqrt((velocities * velocities).sum(axis=1))
        off = moving & (np.abs(crowd.position - places).max(axis=1) > 1e-6)
        for p in np.flatnonzero(off).tolist():
            wanted[p] = _at_most(wanted[p], speed[p] + CATCH_UP)
        near = distances(crowd.position, crowd.robot_position) <= NEIGHBOUR_DISTANCE
        for p in np.flatnonzero(moving & (crowd.sees_robot & near).any(axis=1)).tolist():
            wanted[p] = _evading(crowd, p, wanted[p], max(speed[p], CATCH_UP) + CATCH_UP)
        return wanted


def _at_most(velocity: NDArray[np.float64], speed: float) -> NDArray[np.float64]:
    """The same direction, no faster [m/s]."""
    pace = math.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1])
    return velocity * (speed / pace) if pace > speed else velocity


def _evading(
    crowd: Crowd, p: int, wanted: NDArray[np.float64], fastest: float
) -> NDArray[np.float64]:
    """(2,) velocity of person ``p`` by ORCA against robots and walls [m/s]."""
    one, out = slice(p, p + 1), np.empty((1, 2))
    orca_velocities(
        crowd.position[one],
        crowd.velocity[one],
        wanted[None],
        np.array([fastest]),
        crowd.radius[one],
        crowd.sees_robot[one],
        crowd.robot_position,
        crowd.robot_velocity,
        crowd.robot_radius,
        crowd.responsibility,
        crowd.obstacles,
        crowd.walls,
        crowd.period,
        out,
    )
    return out[0]
