"""A cleaned recording as a file of its own: NPZ, compressed, without pickle."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.messages import brief
from crowdbench.people.errors import RecordingError
from crowdbench.people.recording import CrowdRecording, IntArray
from crowdbench.people.stated import Stated, settle
from crowdbench.replacing import replacing

_ARRAYS = {"people": "i1", "starts": "i1", "times": "f1", "frames": "i1", "positions": "f2"}
_ARRAYS |= {"interpolated": "b1", "name": "U0", "kind": "U0", "period": "f0"}
_ARRAYS |= {"wall_points": "f2", "wall_starts": "i1"}
"""What is in the file, of which kind each is, and how many dimensions it has."""
_DAMAGE = (
    OSError, EOFError, ValueError, KeyError, RuntimeError, zlib.error, zipfile.BadZipFile
)  # fmt: skip


def save(recording: CrowdRecording, path: Path) -> None:
    """Write a recording, in metres and seconds; the same bytes for the same recording.

    Args:
        recording: what to write.
        path: of the file, which is replaced.

    Raises:
        OSError: it cannot be written.
    """
    arrays: dict[str, Any] = {
        name: getattr(recording, name) for name in _ARRAYS if not name.startswith("wall")
    }
    arrays["wall_points"] = np.concatenate([np.empty((0, 2)), *recording.walls])
    arrays["wall_starts"] = np.cumsum([0, *map(len, recording.walls)])
    with replacing(path) as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load(path: Path, given: Stated) -> CrowdRecording:
    """Read what ``save`` has written.

    Raises:
        RecordingError: the file is damaged, of something else, or not what the user says.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in _ARRAYS}
    except _DAMAGE as error:
        raise RecordingError(
            f"{path}: damaged, or not from `crowdbench people --save` ({brief(error)})"
        ) from error
    if any(f"{array.dtype.kind}{array.ndim}" != _ARRAYS[name] for name, array in arrays.items()):
        raise RecordingError(f"{path}: not from `crowdbench people --save`")
    _require_consistent(path, arrays)
    wall_points, wall_starts = arrays.pop("wall_points"), arrays.pop("wall_starts")
    recording = CrowdRecording(
        name=str(arrays.pop("name")),
        kind=str(arrays.pop("kind")),
        period=float(arrays.pop("period")),
        walls=tuple(np.split(wall_points, wall_starts[1:-1])) if len(wall_points) else (),
        **arrays,
    )
    settle(path, Stated("m", 1 / recording.period), given)
    return recording


def _require_consistent(path: Path, arrays: dict[str, Any]) -> None:
    rows, times = len(arrays["times"]), arrays["times"]
    positions, points = arrays["positions"], arrays["wall_points"]
    shapes = [
        arrays["starts"].shape == (len(arrays["people"]) + 1,),
        positions.shape == (rows, 2),
        len(arrays["frames"]) == len(arrays["interpolated"]) == rows,
        points.shape[1] == 2,
    ]
    right = all(shapes) and len(arrays["people"]) > 0 and bool(arrays["period"] > 0)
    right = right and _divides(arrays["starts"], rows)
    right = right and (_divides(arrays["wall_starts"], len(points)) or not len(points))
    if right:
        later = np.diff(times) > 0
        later[arrays["starts"][1:-1] - 1] = True
        right = bool(later.all()) and all(np.isfinite(a).all() for a in (times, positions, points))
    if not right:
        raise RecordingError(f"{path}: its arrays do not fit together")


def _divides(starts: IntArray, rows: int) -> bool:
    """Whether parts that begin there are two rows or more, all together."""
    ends = len(starts) > 1 and starts[0] == 0 and starts[-1] == rows
    return bool(ends and (np.diff(starts) > 1).all())
