"""Whole episodes on disk: one compressed file per cell, appended to and never rewritten.

``FOLDER/trajectories/<scenario>/<agent>.jsonl.gz`` is an ordinary gzip file (``zcat`` prints one
JSON document per line), made of one gzip member per episode. Each member names its own length and
episode in the extra field of its header (RFC 1952, section 2.3.1.1), so that an episode is found
without decompressing those before it, and a member cut off by a kill is recognised and dropped.
"""

from __future__ import annotations

import dataclasses
import json
import os
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from crowdbench.evaluation.appending import ResultsError, append, locked
from crowdbench.evaluation.episode import Episode
from crowdbench.evaluation.results import Cell
from crowdbench.simulation.contact import Contact

_FIXED = struct.Struct("<4sLBBH")  # magic, method and flags; time; extra flags; system; XLEN
_MAGIC = b"\x1f\x8b\x08\x04"  # deflate, with an extra field
_SUBFIELD = struct.Struct("<2sHQ")  # identifier, length of what follows, length of the member
_TAIL = struct.Struct("<LL")  # CRC-32 and length of the document
_IDENTIFIER = b"CB"
_DTYPES = ("float64", "float32", "int64", "int32", "bool")


class Entry(NamedTuple):
    """Where one episode is in a trajectory file."""

    seed: int
    robot: str
    identity: tuple[str, ...]
    offset: int
    size: int


class TrajectoryStore:
    """Appends episodes to the files of cells; any number of processes may do so at once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, cell: Cell) -> Path:
        """Where the episodes of a cell are."""
        return cell.path(self.folder, "trajectories", ".jsonl.gz")

    def stored(self, cell: Cell) -> dict[int, set[str]]:
        """The robots whose episodes are stored, for each seed."""
        seeds: dict[int, set[str]] = {}
        for entry in trajectory_index(self.path(cell)):
            if entry.identity == cell.identity:
                seeds.setdefault(entry.seed, set()).add(entry.robot)
        return seeds

    def append(self, cell: Cell, members: Sequence[bytes]) -> None:
        """Store members made by ``encode_episode``, except episodes that are there already.

        Raises:
            ResultsError: the disk is full or the file is not writable.
        """
        with locked(self.path(cell)) as descriptor:
            entries = list(_members(self.path(cell), descriptor))
            end = entries[-1].offset + entries[-1].size if entries else 0
            os.ftruncate(descriptor, end)
            known = {entry[:3] for entry in entries}
            new = [member for member in members if _describe(member, 0)[:3] not in known]
            append(descriptor, b"".join(new))


def encode_episode(cell: Cell, episode: Episode) -> bytes:
    """One episode as a gzip member that can be appended to a trajectory file."""
    fields = {field.name: getattr(episode, field.name) for field in dataclasses.fields(Episode)}
    plain = {name: _plain(value) for name, value in fields.items()}
    document = json.dumps(plain, allow_nan=False, separators=(",", ":")).encode() + b"\n"
    name = json.dumps([episode.seed, episode.robot, cell.identity]).encode()
    packer = zlib.compressobj(wbits=-zlib.MAX_WBITS)
    body = packer.compress(document) + packer.flush()
    extra = _SUBFIELD.size + len(name)
    size = _FIXED.size + extra + len(body) + _TAIL.size
    return b"".join(
        [
            _FIXED.pack(_MAGIC, 0, 0, 255, extra),
            _SUBFIELD.pack(_IDENTIFIER, extra - 4, size),
            name,
            body,
            _TAIL.pack(zlib.crc32(document), len(document) & 0xFFFFFFFF),
        ]
    )


def trajectory_index(path: str | Path) -> list[Entry]:
    """What a trajectory file holds, oldest first; an incomplete last episode is left out."""
    try:
        with Path(path).open("rb") as file:
            return list(_members(path, file.fileno()))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise ResultsError(f"{path}: cannot be read ({error.strerror})") from error


def load_episode(path: str | Path, seed: int, robot: str = "robot_0") -> Episode:
    """Read one episode; when it was recorded more than once, the latest.

    Raises:
        ResultsError: it is not there, or the file is damaged.
    """
    entries = [entry for entry in trajectory_index(path) if entry[:2] == (seed, robot)]
    if not entries:
        raise ResultsError(f"{path}: no episode with seed {seed} of {robot}")
    return read_episode(path, entries[-1])


def read_episode(path: str | Path, entry: Entry) -> Episode:
    """Read the episode of an entry of ``trajectory_index``.

    Raises:
        ResultsError: the file is damaged.
    """
    with Path(path).open("rb") as file:
        member = os.pread(file.fileno(), entry.size, entry.offset)
    try:
        document = json.loads(zlib.decompress(member, wbits=zlib.MAX_WBITS | 16))
        values = {name: _restored(value) for name, value in document.items()}
        contact = values["contact"] and Contact(**values["contact"])
        footprint = tuple(values["footprint"])
        return Episode(**{**values, "contact": contact, "footprint": footprint})
    except (zlib.error, ValueError, TypeError, KeyError) as error:
        where = f"{path}: the episode at byte {entry.offset}"
        raise ResultsError(f"{where} cannot be read ({error})") from error


def _members(path: str | Path, descriptor: int) -> Iterator[Entry]:
    """Hop from member to member, up to the first that is incomplete."""
    offset, end = 0, os.fstat(descriptor).st_size
    while offset + _FIXED.size <= end:
        fixed = os.pread(descriptor, _FIXED.size, offset)
        head = fixed + os.pread(descriptor, _FIXED.unpack(fixed)[-1], offset + _FIXED.size)
        try:
            entry = _describe(head, offset)
        except IndexError:
            return
        except (ValueError, struct.error) as error:
            raise ResultsError(f"{path}, byte {offset}: not a trajectory file") from error
        if offset + entry.size > end:
            return
        yield entry
        offset += entry.size


def _describe(member: bytes, offset: int) -> Entry:
    magic, *_, length = _FIXED.unpack_from(member)
    if magic != _MAGIC:
        raise ValueError("no gzip member of crowdbench's")
    if len(member) < _FIXED.size + length:
        raise IndexError("the header is cut off")
    identifier, _, size = _SUBFIELD.unpack_from(member, _FIXED.size)
    if identifier != _IDENTIFIER:
        raise ValueError("no gzip member of crowdbench's")
    name = member[_FIXED.size + _SUBFIELD.size : _FIXED.size + length]
    seed, robot, identity = json.loads(name)
    return Entry(int(seed), robot, tuple(identity), offset, size)


def _plain(value: Any) -> Any:
    """As JSON can say it: arrays with dtype and shape, non-finite numbers as words."""
    if isinstance(value, np.ndarray):
        data = [_plain(number) for number in value.ravel().tolist()]
        return {"dtype": value.dtype.name, "shape": value.shape, "data": data}
    if isinstance(value, float) and not np.isfinite(value):
        return repr(value)
    if isinstance(value, Contact):
        return _plain(dataclasses.asdict(value))
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return value


def _restored(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    if value.keys() != {"dtype", "shape", "data"}:
        return {k: float(v) if v in ("nan", "inf", "-inf") else v for k, v in value.items()}
    if value["dtype"] not in _DTYPES:
        raise ValueError(f"unknown dtype {value['dtype']!r}")
    numbers = [float(v) if isinstance(v, str) else v for v in value["data"]]
    return np.array(numbers, dtype=value["dtype"]).reshape(value["shape"])
