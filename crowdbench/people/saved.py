"""A cleaned recording as a file of its own: NPZ, compressed, without pickle."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.people.errors import RecordingError
from crowdbench.people.recording import CrowdRecording
from crowdbench.people.stated import Stated, settle

_ARRAYS = {"people": "i", "starts": "i", "times": "f", "frames": "i", "positions": "f"}
_ARRAYS |= {"interpolated": "b", "name": "U", "kind": "U"}
_ARRAYS |= {"period": "f", "wall_points": "f", "wall_starts": "i"}
"""What is in the file, and of which kind each is."""


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
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load(path: Path, given: Stated) -> CrowdRecording:
    """Read what ``save`` has written.

    Raises:
        RecordingError: the file is damaged, of something else, or not what the user says.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in _ARRAYS}
    except (ValueError, EOFError, KeyError, OSError, zipfile.BadZipFile, zlib.error) as error:
        told = " ".join(str(error).split())
        raise RecordingError(
            f"{path}: damaged, or not from `crowdbench people --save` ({told})"
        ) from error
    wall_points, wall_starts = arrays.pop("wall_points"), arrays.pop("wall_starts")
    if any(array.dtype.kind != _ARRAYS[name] for name, array in arrays.items()):
        raise RecordingError(f"{path}: not from `crowdbench people --save`")
    recording = CrowdRecording(
        name=str(arrays.pop("name")),
        kind=str(arrays.pop("kind")),
        period=float(arrays.pop("period")),
        walls=tuple(np.split(wall_points, wall_starts[1:-1])) if len(wall_points) else (),
        **arrays,
    )
    _require_consistent(path, recording)
    settle(path, Stated("m", 1 / recording.period), given)
    return recording


def _require_consistent(path: Path, recording: CrowdRecording) -> None:
    rows, tracks = len(recording.times), len(recording.people)
    shapes = [
        recording.starts.shape == (tracks + 1,),
        recording.positions.shape == (rows, 2),
        recording.frames.shape == recording.interpolated.shape == recording.times.shape == (rows,),
    ]
    right = all(shapes) and tracks > 0 and recording.period > 0
    if right:
        starts = recording.starts
        right = starts[0] == 0 and starts[-1] == rows and bool((np.diff(starts) > 1).all())
    if right:
        later = np.diff(recording.times) > 0
        later[recording.starts[1:-1] - 1] = True
        right = bool(later.all()) and bool(np.isfinite(recording.positions).all())
    if not right:
        raise RecordingError(f"{path}: its arrays do not fit together")
