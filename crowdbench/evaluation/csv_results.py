"""Results of crowdbench 0.1.0, read only.

Rows are in ``FOLDER/episodes/<scenario>/<agent>.csv``, beside them ``scenario.json`` where the
scenario was not one of crowdbench's own, and whole episodes in
``FOLDER/trajectories/<scenario>/<agent>.jsonl.gz``: one gzip member per episode, which names its
own length and episode in the extra field of its header.
"""

from __future__ import annotations

import csv
import json
import math
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from crowdbench.evaluation.database import ResultsError
from crowdbench.evaluation.measured import OUTCOMES, is_proportion
from crowdbench.evaluation.record import FIRST_WORLD
from crowdbench.evaluation.results import Cell, Origin, Result
from crowdbench.messages import short
from crowdbench.scenario import Scenario, ScenarioError, load_scenario

Key = tuple[tuple[str, ...], int, str]
"""Identity of a cell, seed and robot."""
Motion = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Actions (T, 2) as executed, and seconds (T,) in ``act``."""

_CELL = tuple(field.name for field in fields(Cell) if field.name != "world")
_FACTS = (
    "seed", "robot", "outcome", "steps", "error", "diagnostics", "machine", "version", "timestamp"
)  # fmt: skip
_FIXED = struct.Struct("<4sLBBH")  # magic, method and flags; time; extra flags; system; XLEN
_MAGIC = b"\x1f\x8b\x08\x04"  # deflate, with an extra field
_SUBFIELD = struct.Struct("<2sHQ")  # identifier, length of what follows, length of the member


@dataclass(frozen=True)
class CsvCell:
    """The rows of one measurement.

    Attributes:
        cell: what they have in common.
        scenario: its definition; None if it is not known any more.
        results: oldest first, with commands where the whole episode was kept.
    """

    cell: Cell
    scenario: Scenario | None
    results: list[Result]


def read_csv_cells(folder: Path) -> Iterator[CsvCell]:
    """Everything that a folder holds, file by file; a row cut off by a kill is left out.

    Raises:
        ResultsError: no such results, or something that cannot be read; the message says where.
    """
    paths = sorted(folder.glob("episodes/*/*.csv"))
    if not paths:
        raise ResultsError(f"{folder}: no results of crowdbench 0.1.0 (episodes/*/*.csv) are here")
    for path in paths:
        place = path.parent.name
        motions = _motions(folder / "trajectories" / place / f"{path.stem}.jsonl.gz")
        cells: dict[Cell, list[Result]] = {}
        for number, row in _rows(path):
            cell = Cell(**{name: row[name] for name in _CELL}, world=FIRST_WORLD)
            try:
                result = _result(cell, row, motions)
            except ValueError as error:
                raise _no_row(path, number, error) from error
            cells.setdefault(cell, []).append(result)
        for cell, results in cells.items():
            yield CsvCell(cell, _scenario(cell, path.with_name("scenario.json")), results)


def _rows(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Line number and fields of every complete row."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ResultsError(f"{path}: cannot be read ({error.strerror})") from error
    columns: list[str] = []
    for number, line in enumerate(data.split(b"\n")[:-1], start=1):
        try:
            values = next(csv.reader([line.decode().rstrip("\r")], strict=True), [])
            if not columns:
                columns = values
                missing = [name for name in (*_CELL, *_FACTS) if name not in columns]
                if missing:
                    raise ValueError(f"the header lacks {', '.join(missing)}")
                continue
            if len(values) != len(columns):
                raise ValueError(f"expected {len(columns)} fields, got {len(values)}")
        except (ValueError, csv.Error) as error:
            raise _no_row(path, number, error) from error
        yield number, dict(zip(columns, values, strict=True))


def _no_row(path: Path, number: int, error: Exception) -> ResultsError:
    return ResultsError(f"{path}, line {number}: not a row of results ({error})")


def _result(cell: Cell, row: Mapping[str, str], motions: Mapping[Key, Motion]) -> Result:
    seed = int(row["seed"])
    actions, times = motions.get((cell.identity, seed, row["robot"]), (None, None))
    names = [name for name in row if name not in (*_CELL, *_FACTS)]
    result = Result(
        seed,
        row["robot"],
        row["outcome"],
        int(row["steps"]),
        {name: float(row[name]) for name in names},
        row["error"],
        _counters(row["diagnostics"]),
        Origin(row["machine"], version=row["version"], timestamp=row["timestamp"]),
        actions,
        times,
    )
    if result.outcome not in OUTCOMES or result.steps < 0 or seed < 0:
        raise ValueError(f"outcome {result.outcome}, steps {result.steps}, seed {seed}")
    for name, value in result.metrics.items():
        if is_proportion(name) and not (value in (0, 1) or math.isnan(value)):
            raise ValueError(f"{name} is {value}, expected 0, 1 or nan")
    if actions is not None and len(actions) != result.steps:
        raise ValueError(f"{result.steps} steps, but the whole episode has {len(actions)}")
    return result


def _counters(text: str) -> dict[str, float]:
    try:
        found = json.loads(text)
    except RecursionError as error:
        raise ValueError("diagnostics are nested too deeply") from error
    if not isinstance(found, dict):
        raise ValueError(f"diagnostics {short(found)}, expected counters by name")
    return found


def _scenario(cell: Cell, beside: Path) -> Scenario | None:
    try:
        if "@" in cell.scenario:
            found = Scenario.model_validate_json(beside.read_text(encoding="utf-8"))
        else:
            found = load_scenario(cell.scenario)
    except (ScenarioError, OSError, ValueError):
        return None
    return found if found.digest == cell.scenario_digest else None


def _motions(path: Path) -> dict[Key, Motion]:
    """What the robots of whole episodes did; one cut off by a kill is left out."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise ResultsError(f"{path}: cannot be read ({error.strerror})") from error
    found: dict[Key, Motion] = {}
    offset = 0
    try:
        while offset + _FIXED.size + _SUBFIELD.size <= len(data):
            magic, *_, extra = _FIXED.unpack_from(data, offset)
            identifier, _, size = _SUBFIELD.unpack_from(data, offset + _FIXED.size)
            if (magic, identifier) != (_MAGIC, b"CB"):
                raise ValueError("not a gzip member of crowdbench's")
            if offset + size > len(data):
                break
            name = offset + _FIXED.size + _SUBFIELD.size
            seed, robot, identity = json.loads(data[name : offset + _FIXED.size + extra])
            document = json.loads(
                zlib.decompress(data[offset : offset + size], wbits=zlib.MAX_WBITS | 16)
            )
            found[tuple(identity), int(seed), robot] = (
                np.array(document["actions"]["data"], dtype=float).reshape(-1, 2),
                np.array(document["inference_s"]["data"], dtype=float),
            )
            offset += size
    except (zlib.error, struct.error, ValueError, TypeError, KeyError) as error:
        raise ResultsError(f"{path}, byte {offset}: not a whole episode ({error})") from error
    return found
