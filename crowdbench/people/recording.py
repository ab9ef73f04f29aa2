"""Recorded people as arrays: one track after another, each without gaps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SPEED_WINDOW = 0.8
"""Over which a walking speed is measured [s]: heads sway and single positions are noisy."""
FASTEST = 3.0
"""Beyond which a step from one position to the next counts as a jump [m/s]."""
_ROUNDING = 1e-6
"""By which a moment may miss a track and still is its beginning or end [s]."""
_SIDE = 0.5
"""Of the cells that make up the area walked on [m]."""


class Present(NamedTuple):
    """Who is there at a time.

    Attributes:
        tracks: (M,) their numbers, ascending.
        positions: (M, 2) [m].
    """

    tracks: IntArray
    positions: FloatArray


class Jump(NamedTuple):
    """A step that nobody walks.

    Attributes:
        frame: in which it ends, as the file numbers them.
        time: the same [s].
        person: the id in the file.
        speed: from the position before [m/s].
    """

    frame: int
    time: float
    person: int
    speed: float


@dataclass(frozen=True, eq=False)
class CrowdRecording:
    """People who walk as recorded.

    A track is a person from appearing to leaving; one who is lost for long in between has several.
    Rows are sorted by track and time; every track has two of them or more.

    Attributes:
        name: of the file that it is from.
        kind: of that file, in words.
        period: seconds from one position of a person to the next, as a rule.
        people: (T,) whose track it is, the id in the file.
        starts: (T + 1,) first row of each track, then N.
        times: (N,) [s], 0 where the first track begins.
        frames: (N,) as the file numbers them; where it has times alone, these in periods, rounded.
        positions: (N, 2) [m].
        interpolated: (N,) positions that fill a gap of the file.
        walls: closed lines (K, 2) [m] around and within the area that can be walked on.
    """

    name: str
    kind: str
    period: float
    people: IntArray
    starts: IntArray
    times: FloatArray
    frames: IntArray
    positions: FloatArray
    interpolated: NDArray[np.bool_]
    walls: tuple[FloatArray, ...] = ()

    @property
    def duration(self) -> float:
        """Until the last track ends [s]."""
        return float(self.ends.max())

    @cached_property
    def begins(self) -> FloatArray:
        """When each track begins, (T,) [s]."""
        return self.times[self.starts[:-1]]

    @cached_property
    def ends(self) -> FloatArray:
        """When each track ends, (T,) [s]."""
        return self.times[self.starts[1:] - 1]

    @cached_property
    def moments(self) -> FloatArray:
        """At which somebody's position was recorded, ascending [s]."""
        return np.unique(self.times)

    def at(self, time: float) -> Present:
        """Who is there at a time, between two positions on the line from one to the other.

        Args:
            time: [s]; nobody is there before 0 or after ``duration``.
        """
        return self.at_times(np.array([time]))[1]

    def at_times(self, times: FloatArray) -> tuple[IntArray, Present]:
        """Who is there at several times, as ``at`` says it of one.

        Args:
            times: (T,) [s].

        Returns:
            Which of the times each row is of, (M,) ascending, and the rows.
        """
        earliest, latest = times[:, None] + _ROUNDING, times[:, None] - _ROUNDING
        which, tracks = np.nonzero((self.begins <= earliest) & (latest <= self.ends))
        time = times[which]
        after = np.searchsorted(self._keys, time + tracks * self._stride, side="right")
        # Neither rounding in the keys nor the last position of all leads into the next track.
        row = np.clip(after - 1, self.starts[tracks], self.starts[tracks + 1] - 2)
        before = self.times[row]
        share = np.clip((time - before) / (self.times[row + 1] - before), 0.0, 1.0)[:, None]
        positions = (1 - share) * self.positions[row] + share * self.positions[row + 1]
        return which, Present(tracks, positions)

    @cached_property
    def _stride(self) -> float:
        return self.duration + 1.0

    @cached_property
    def _keys(self) -> FloatArray:
        """Times that grow from track to track as well, (N,)."""
        return self.times + self.track_of_row * self._stride

    @cached_property
    def track_of_row(self) -> IntArray:
        """The track of each row, (N,)."""
        return np.repeat(np.arange(len(self.people)), np.diff(self.starts))

    @cached_property
    def speeds(self) -> FloatArray:
        """Walking speed at each row, (N,) [m/s].

        The way in a straight line from half of ``SPEED_WINDOW`` before to half of it after, less
        where the track begins or ends.
        """
        reach = max(1, round(SPEED_WINDOW / 2 / self.period))
        rows = np.arange(len(self.times))
        first = np.maximum(rows - reach, self.starts[self.track_of_row])
        last = np.minimum(rows + reach, self.starts[self.track_of_row + 1] - 1)
        way = np.linalg.norm(self.positions[last] - self.positions[first], axis=1)
        return way / (self.times[last] - self.times[first])

    def jumps(self, fastest: float = FASTEST) -> list[Jump]:
        """Steps from one position to the next that are faster than somebody walks.

        Args:
            fastest: what still passes [m/s].

        Returns:
            By frame and person.
        """
        way = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        within = self.track_of_row[1:] == self.track_of_row[:-1]
        speed = np.divide(way, np.diff(self.times), out=np.zeros_like(way), where=within)
        rows = np.flatnonzero(speed > fastest)
        found = [
            Jump(
                int(self.frames[row + 1]),
                float(self.times[row + 1]),
                int(self.people[self.track_of_row[row]]),
                float(speed[row]),
            )
            for row in rows
        ]
        return sorted(found)

    @cached_property
    def extent(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest x and y of all positions, each (2,) [m]."""
        return self.positions.min(axis=0), self.positions.max(axis=0)

    @cached_property
    def segments(self) -> FloatArray:
        """The walls piece by piece, (S, 4) x1, y1, x2, y2 [m]."""
        pieces = [np.hstack([line[:-1], line[1:]]) for line in self.walls]
        return np.concatenate([np.empty((0, 4)), *pieces])

    @cached_property
    def area(self) -> float:
        """Of all square cells of half a metre that somebody sets foot in [m²]."""
        cells = np.floor(self.positions / _SIDE).astype(np.int64)
        cells -= cells.min(axis=0)
        return len(np.unique(cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1])) * _SIDE**2
