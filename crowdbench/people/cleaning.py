"""From the rows of a file to tracks without gaps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crowdbench.people.errors import RecordingError
from crowdbench.people.recording import CrowdRecording, FloatArray, IntArray

LONGEST_GAP = 0.5
"""For which a person may be missing and still has a single track [s]."""
_TOO_FAST = 10.0
"""No nine of ten speeds are above that of a sprinter [m/s]."""
_FARTHEST = 1e8
"""More than any coordinate on the Earth, in whatever system [m]."""
_PERIODS = (0.001, 10.0)
"""In which positions can follow one another [s]: times in milliseconds are no seconds."""
_LONGEST = 1e6
"""Of a recording [s]: eleven days."""
_TOO_SLOW, _TOO_NARROW = 0.03, 1.0
"""Several people who hardly move [m/s] within a metre [m] are no crowd."""
UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
"""How many make a metre."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Positions as a file has them, in any order.

    Attributes:
        kind: of the file, in words.
        ids: (N,) whose.
        times: (N,) [s].
        positions: (N, 2) [m].
        frames: (N,) None where the file has times alone.
        walls: as of a recording.
        unit: in which the file has its positions.
    """

    kind: str
    ids: IntArray
    times: FloatArray
    positions: FloatArray
    frames: IntArray | None = None
    walls: tuple[FloatArray, ...] = ()
    unit: str = "m"


def clean(path: Path, rows: Rows) -> CrowdRecording:
    """Sort rows into tracks, fill short gaps, and let long ones end a track.

    A gap is the time for which a person is missing: with a position every 0.4 s, one of 0.8 s
    between two positions is a gap of 0.4 s. People seen only once are left out.

    Args:
        path: of the file, for messages.
        rows: all of it.

    Raises:
        RecordingError: a position or time cannot be, an id is there twice at a time, nobody is
            seen twice, or unit, times or frame rate must be others.
    """
    ids, times, positions, frames = _sorted(path, rows)
    same, interval = ids[1:] == ids[:-1], np.diff(times)
    if not same.any():
        raise RecordingError(f"{path}: nobody is seen twice, so there is nothing to be replayed")
    period = float(f"{np.median(interval[same]):.9g}")  # without what rounding has added
    if not _PERIODS[0] <= period <= _PERIODS[1]:
        raise RecordingError(
            f"{path}: it has a position every {period:.3g} s, and has to have one every "
            f"{_PERIODS[0]:g} to {_PERIODS[1]:g} s; are times or frame rate wrong?"
        )
    if frames is None:
        frames = np.rint((times - times.min()) / period).astype(np.int64)
    missing = np.where(same, interval - period, 0.0)
    ends = ~same | (missing > max(LONGEST_GAP, period / 2) * (1 + 1e-6))
    filled = np.where(ends, 0, np.rint(interval / period).astype(np.int64) - 1).clip(min=0)

    # Each row is followed by those that fill the gap behind it, a share of the way each.
    counts = np.append(filled, 0) + 1
    row = np.repeat(np.arange(len(ids)), counts)
    step = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    following = np.minimum(row + 1, len(ids) - 1)
    share = step / counts[row]
    times = times[row] + share * (times[following] - times[row])
    frames = np.rint(frames[row] + share * (frames[following] - frames[row])).astype(np.int64)
    positions = positions[row] + share[:, None] * (positions[following] - positions[row])

    track = np.concatenate([[0], np.cumsum(ends)])[row]
    kept = np.bincount(track)[track] > 1
    starts = np.flatnonzero(np.diff(track[kept], prepend=-1))
    recording = CrowdRecording(
        name=path.name,
        kind=rows.kind,
        period=period,
        people=ids[row][kept][starts],
        starts=np.append(starts, kept.sum()),
        times=times[kept] - times[kept].min(),
        frames=frames[kept],
        positions=positions[kept],
        interpolated=(step > 0)[kept],
        walls=rows.walls,
    )
    _require_plausible(path, recording, rows.unit)
    return recording


def _sorted(path: Path, rows: Rows) -> tuple[IntArray, FloatArray, FloatArray, IntArray | None]:
    """Ids, times, positions and frames by person and time, checked."""
    if len(rows.ids) == 0:
        raise RecordingError(f"{path}: there are no positions in it")
    ids, times, positions, frames = rows.ids, rows.times, rows.positions, rows.frames

    def refuse(row: int, problem: str) -> RecordingError:
        place = f"{times[row]:g} s" if frames is None else f"frame {frames[row]}"
        return RecordingError(f"{path}: {place}, person {ids[row]}: {problem}")

    sound = (np.abs(positions) < _FARTHEST).all(axis=1) & np.isfinite(times)
    if not sound.all():
        told = f"time, x and y have to be finite, and x and y below {_FARTHEST:g} m"
        raise refuse(int(np.argmin(sound)), told)
    if times.min() < 0:
        raise refuse(int(np.argmin(times)), "frames and times are 0 or later")
    if not _in_order(ids, times):
        order = np.lexsort((times, ids))
        ids, times, positions = ids[order], times[order], positions[order]
        frames = None if frames is None else frames[order]
    twice = (ids[1:] == ids[:-1]) & (times[1:] == times[:-1])
    if twice.any():
        raise refuse(int(np.argmax(twice)), "is there twice")
    return ids, times, positions, frames


def _in_order(ids: IntArray, times: FloatArray) -> bool:
    later = (ids[1:] == ids[:-1]) & (times[1:] >= times[:-1])
    return bool(np.all((ids[1:] > ids[:-1]) | later))


def _require_plausible(path: Path, recording: CrowdRecording, unit: str) -> None:
    """Refuse what must be in another unit, and say in which, and times far from all others.

    Raises:
        RecordingError: people are too fast, or too close and slow, or the recording is too long.
    """
    if recording.duration > _LONGEST:
        raise RecordingError(
            f"{path}: its last position is {recording.duration:.3g} s after the first, and at most "
            f"{_LONGEST:.3g} s are allowed"
        )
    typical = float(np.percentile(recording.speeds, 90))
    low, high = recording.extent
    crowded = len(recording.people) > 1 and float(np.linalg.norm(high - low)) < _TOO_NARROW
    if typical <= _TOO_FAST and not (crowded and typical < _TOO_SLOW):
        return
    others = {name: typical * UNITS[unit] / scale for name, scale in UNITS.items() if name != unit}
    meant = [
        f"in {name} it would be {_plain(speed)} m/s (unit: {name})"
        for name, speed in others.items()
        if 0.1 < speed < 4
    ]
    raise RecordingError(
        f"{path}: read in {unit}, people walk at {_plain(typical)} m/s (a tenth of the time "
        f"faster), which cannot be; {'; '.join([*meant, 'or is the frame rate wrong?'])}"
    )


def _plain(speed: float) -> str:
    """Two digits and no exponent, as 120 or 0.12."""
    return f"{float(f'{speed:.2g}'):,g}" if speed < 1e6 else f"{speed:.2g}"
