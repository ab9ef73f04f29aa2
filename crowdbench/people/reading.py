"""Which kind of recording a file is, by what is in it, and how each kind is read."""

from __future__ import annotations

import codecs
import math
from pathlib import Path

from crowdbench.messages import brief
from crowdbench.people.cleaning import UNITS, clean
from crowdbench.people.errors import RecordingError
from crowdbench.people.recording import CrowdRecording
from crowdbench.people.stated import Stated
from crowdbench.people.table import count_numbers, lines

KINDS = (
    "PeTrack text, HDF5 of the Juelich archive, SQLite of JuPedSim, obsmat, TrajNet++ ndjson, "
    "CSV with a first line that names the columns id, time or frame, x, y, "
    "and NPZ of `crowdbench people --save`"
)
_HEAD = 4096
"""Of a file, by which its kind is known [bytes]."""
_UTF_16_OR_32 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, codecs.BOM_UTF32_BE)
"""How such text begins; UTF-32 of the other order begins as UTF-16 does."""


def read_recording(
    path: Path | str, unit: str | None = None, fps: float | None = None
) -> CrowdRecording:
    """Read and clean a recording of people.

    Args:
        path: of the file; its kind is known by what is in it.
        unit: of positions, ``m``, ``cm`` or ``mm``, where the file does not say it.
        fps: frames per second as the file numbers them, where it does not say it; of obsmat and
            TrajNet++, which number in steps, annotations per second.

    Raises:
        RecordingError: the file is none of the known kinds, cannot be read, does not say its unit
            or frame rate, says another than is given, or has what cannot be.
    """
    path = Path(path)
    if unit is not None and unit not in UNITS:
        raise RecordingError(f"unit {unit!r}: has to be one of {', '.join(UNITS)}")
    if fps is not None and not (math.isfinite(fps) and fps > 0):
        raise RecordingError(f"fps {fps:g}: has to be a number above 0")
    try:
        if path.exists() and not path.is_file():
            raise RecordingError(f"{path}: not a file")
        with path.open("rb") as file:
            head = file.read(_HEAD)
        return _read(path, head, Stated(unit, fps))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: not text in UTF-8 ({brief(error)})") from error


def _read(path: Path, head: bytes, given: Stated) -> CrowdRecording:
    from crowdbench.people import archive, saved, text

    if not head.strip():
        raise RecordingError(f"{path}: the file is empty")
    if head.startswith(b"PK\x03\x04"):
        return saved.load(path, given)
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        return clean(path, archive.read_hdf5(path, given))
    if head.startswith(b"SQLite format 3\0"):
        return clean(path, archive.read_jupedsim(path, given))
    if head.startswith(_UTF_16_OR_32):
        raise RecordingError(f"{path}: text in UTF-16 or UTF-32; allowed: UTF-8")
    if b"\0" in head:
        raise _unknown(path)
    _, first = next(lines(path), (0, ""))
    if not first:
        raise RecordingError(f"{path}: nothing but comments, no positions in it")
    columns = count_numbers(first)
    if first.startswith("{"):
        return clean(path, text.read_trajnet(path, given))
    # PeTrack may write as many, and says what they are.
    if columns == len(text.OBSMAT) and text.petrack_header(path) == Stated(None, None):
        return clean(path, text.read_obsmat(path, given))
    if columns >= len(text.PETRACK):
        return clean(path, text.read_petrack(path, given))
    if text.csv_separator(first):
        return clean(path, text.read_csv(path, given))
    raise _unknown(path)


def _unknown(path: Path) -> RecordingError:
    return RecordingError(f"{path}: not a recording of a known kind, which are: {KINDS}")
