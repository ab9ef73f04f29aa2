"""The results store: one CSV row per episode and robot, appended and never rewritten.

Layout: ``FOLDER/episodes/<scenario>/<agent>.csv``. A scenario that is not, field by field, one of
crowdbench's own (overridden, or from a file) is stored as ``<scenario>@<digest>`` with its
definition beside its rows, so that it is never mixed up with the plain one.

An episode counts as stored when scenario digest, agent string, weights hash, code and seed are
the same and the crowdbench version agrees in its first two numbers: a release that changes what
an episode gives changes one of those two.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench.evaluation.appending import ResultsError, append, locked, read_from
from crowdbench.scenario import Scenario, ScenarioError, load_scenario

if TYPE_CHECKING:
    import pandas as pd

    from crowdbench.evaluation.episode import Episode

__all__ = ["Cell", "ResultsError", "ResultsStore", "load_results", "scenario_label", "slug"]

Row = Mapping[str, str]
_INTEGERS = ("seed", "steps")
_LAST = ("steps", "error", "diagnostics", "machine", "timestamp")


@dataclass(frozen=True)
class Cell:
    """One agent in one scenario: what the episodes of one cell of a table have in common.

    Attributes:
        scenario: label of the scenario, see ``scenario_label``.
        scenario_digest: ``Scenario.digest``.
        agent: the agent with its options, e.g. ``NAME:horizon=2``.
        options: the options alone, JSON.
        version: of crowdbench.
        weights_sha256: hash of the agent's weights, empty without.
        code: hash of the agent's file (``file.py:Class``), or the distribution it comes with.
    """

    scenario: str
    scenario_digest: str
    agent: str
    options: str
    version: str
    weights_sha256: str
    code: str

    @property
    def identity(self) -> tuple[str, ...]:
        """What has to be equal for two episodes of one seed to be the same measurement."""
        return _identity(asdict(self))

    def path(self, folder: Path, kind: str, suffix: str) -> Path:
        """The file of this cell, e.g. ``FOLDER/episodes/multimodal_fast/AGENT.csv``."""
        return folder / kind / slug(self.scenario) / (slug(self.agent) + suffix)


def scenario_label(scenario: Scenario) -> str:
    """The scenario's name if it is one of crowdbench's own, unchanged; else ``name@digest``."""
    try:
        own = load_scenario(scenario.name).digest == scenario.digest
    except ScenarioError:
        own = False
    return scenario.name if own else f"{scenario.name}@{scenario.digest}"


def slug(text: str) -> str:
    """A file name for any text; when characters were replaced, a hash keeps it unique."""
    safe = re.sub(r"[^A-Za-z0-9_.,=@+-]+", "-", text).strip(".-")[:80]
    if safe and safe == text:
        return safe
    return f"{safe}-{hashlib.sha256(text.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"


def make_row(
    cell: Cell, episode: Episode, metrics: Mapping[str, float], machine: str
) -> dict[str, str]:
    """One row of the store; floats are written so that reading gives them back exactly."""
    facts = {
        "seed": str(episode.seed),
        "robot": episode.robot,
        "outcome": episode.outcome,
        **{name: repr(float(value)) for name, value in metrics.items()},
        "steps": str(episode.steps),
        "error": _one_line(episode.error or ""),
        "diagnostics": json.dumps(dict(episode.diagnostics), sort_keys=True),
        "machine": _one_line(machine),
        "timestamp": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    return {**asdict(cell), **facts}


class ResultsStore:
    """Appends rows to the files of cells; any number of processes may do so at once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[Path, _Known] = {}

    def path(self, cell: Cell) -> Path:
        """Where the rows of a cell are."""
        return cell.path(self.folder, "episodes", ".csv")

    def stored(self, cell: Cell) -> dict[int, set[str]]:
        """The robots whose rows are stored, for each seed.

        Raises:
            ResultsError: the file cannot be opened or has rows that cannot be read.
        """
        path = self.path(cell)
        if not path.exists():
            return {}
        with locked(path) as descriptor:
            known = self._update(path, descriptor)
        seeds: dict[int, set[str]] = {}
        for *identity, seed, robot in known.keys:
            if tuple(identity) == cell.identity:
                seeds.setdefault(int(seed), set()).add(robot)
        return seeds

    def append(self, cell: Cell, rows: Sequence[Row]) -> int:
        """Store the rows of one episode, except those that are there; returns how many are new.

        Raises:
            ResultsError: the disk is full, the file is not writable, or it has other columns.
        """
        path = self.path(cell)
        with locked(path) as descriptor:
            known = self._update(path, descriptor)
            columns = known.columns or list(rows[0])
            if set(columns) != set(rows[0]):
                different = ", ".join(sorted(set(columns) ^ set(rows[0])))
                raise ResultsError(
                    f"{path}: written with other columns ({different}); move it away or choose "
                    "another folder with --results"
                )
            new = [row for row in rows if _key(row) not in known.keys]
            if new:
                lines = [_line([row[name] for name in columns]) for row in new]
                append(descriptor, b"".join(lines if known.columns else [_line(columns), *lines]))
        return len(new)

    def rows(self, cell: Cell) -> pd.DataFrame:
        """The stored rows of a cell, sorted by seed and robot."""
        path = self.path(cell)
        rows = [row for row in _read(path) if _identity(row) == cell.identity]
        return _frame(rows).sort_values(["seed", "robot"], ignore_index=True)

    def describe_scenario(self, cell: Cell, scenario: Scenario) -> None:
        """Write the definition of a scenario that is not crowdbench's own beside its rows."""
        if "@" not in cell.scenario:
            return
        with locked(self.path(cell).parent / "scenario.json") as descriptor:
            if os.fstat(descriptor).st_size == 0:
                append(descriptor, (scenario.model_dump_json(indent=2) + "\n").encode())

    def _update(self, path: Path, descriptor: int) -> _Known:
        """Cut off an incomplete last line and take note of what others have appended."""
        status = os.fstat(descriptor)
        known = self._known.get(path)
        if known is None or known.inode != status.st_ino or status.st_size < known.end:
            known = self._known[path] = _Known(status.st_ino)
        data = read_from(descriptor, known.end)
        complete = data.rfind(b"\n") + 1
        if complete < len(data):
            os.ftruncate(descriptor, known.end + complete)
        known.take(path, data[:complete])
        return known


class _Known:
    """What is known of one file: its columns, the keys of its rows, and how far it was read."""

    def __init__(self, inode: int) -> None:
        self.inode = inode
        self.end = 0
        self.lines = 0
        self.columns: list[str] = []
        self.keys: set[tuple[str, ...]] = set()

    def take(self, path: Path, data: bytes) -> None:
        """Read complete lines that follow those read before."""
        columns, rows = _parse(path, data, self.columns, self.lines)
        self.columns = columns
        self.keys |= {_key(row) for row in rows}
        self.end += len(data)
        self.lines += data.count(b"\n")


def load_results(
    folder: str | Path, scenario: str | None = None, agent: str | None = None
) -> pd.DataFrame:
    """Read stored episodes, one row each, sorted by scenario, agent, seed and robot.

    Rows of a cell that have been superseded (the scenario's definition, the weights, the agent's
    code or the version changed since) are left out: only those that agree with the cell's latest
    row are returned.

    Args:
        folder: the results folder.
        scenario: only this label, e.g. ``multimodal_fast`` or ``multimodal_fast@1a2b3c4d5e6f``.
        agent: only this agent, with its options.

    Raises:
        ResultsError: rows that cannot be read; the message gives file and line.
    """
    chosen: list[dict[str, str]] = []
    for path in sorted(Path(folder).glob("episodes/*/*.csv")):
        rows = _read(path)
        latest = {(row["scenario"], row["agent"]): _identity(row) for row in rows}
        chosen += [
            row
            for row in rows
            if latest[row["scenario"], row["agent"]] == _identity(row)
            and scenario in (None, row["scenario"])
            and agent in (None, row["agent"])
        ]
    return _frame(chosen).sort_values(["scenario", "agent", "seed", "robot"], ignore_index=True)


def metric_columns(columns: Iterable[str]) -> list[str]:
    """Those columns that hold metrics, in the order of the store."""
    fixed = {field.name for field in fields(Cell)} | {"seed", "robot", "outcome", *_LAST}
    return [name for name in columns if name not in fixed]


def _identity(row: Mapping[str, str]) -> tuple[str, ...]:
    version = ".".join(row["version"].split(".")[:2])
    names = ("scenario", "scenario_digest", "agent", "weights_sha256", "code")
    return (*(row[name] for name in names), version)


def _key(row: Row) -> tuple[str, ...]:
    return (*_identity(row), row["seed"], row["robot"])


def _read(path: Path) -> list[dict[str, str]]:
    """All complete rows; a row that is being written at this moment is not there yet."""
    try:
        with path.open("rb") as file:
            data = read_from(file.fileno(), 0)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise ResultsError(f"{path}: cannot be read ({error.strerror})") from error
    return _parse(path, data[: data.rfind(b"\n") + 1], columns=[], before=0)[1]


def _parse(
    path: Path, data: bytes, columns: list[str], before: int
) -> tuple[list[str], list[dict[str, str]]]:
    """Split complete lines into columns and rows; ``before`` lines precede them in the file."""
    rows = []
    for number, line in enumerate(data.split(b"\n")[:-1], start=before + 1):
        try:
            values = next(csv.reader([line.decode().rstrip("\r")], strict=True), [])
            if not columns:
                columns = _checked_header(values)
                continue
            if len(values) != len(columns):
                raise ValueError(f"expected {len(columns)} fields, got {len(values)}")
            row = dict(zip(columns, values, strict=True))
            for name in _INTEGERS:
                int(row[name])
            for name in metric_columns(columns):
                float(row[name])
        except (ValueError, csv.Error) as error:
            raise ResultsError(f"{path}, line {number}: not a row of results ({error})") from error
        rows.append(row)
    return columns, rows


def _checked_header(names: list[str]) -> list[str]:
    required = [field.name for field in fields(Cell)] + ["seed", "robot", "outcome", *_LAST]
    missing = [name for name in required if name not in names]
    if missing:
        raise ValueError(f"the header lacks {', '.join(missing)}")
    return names


def _frame(rows: list[dict[str, str]]) -> pd.DataFrame:
    import pandas as pd

    names = list(dict.fromkeys(name for row in rows for name in row))
    names = names or [field.name for field in fields(Cell)] + ["seed", "robot", "outcome", *_LAST]
    table: dict[str, Any] = {name: [row.get(name, "") for row in rows] for name in names}
    for name in _INTEGERS:
        table[name] = [int(value) for value in table[name]]
    for name in metric_columns(names):
        table[name] = [float(value) if value else math.nan for value in table[name]]
    return pd.DataFrame(table, columns=names)


def _line(values: Iterable[str]) -> bytes:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(values)
    return buffer.getvalue().encode()


def _one_line(text: str) -> str:
    """Text as one line of printable characters, at most 1000."""
    printable = "".join(c if c.isprintable() else " " for c in text)
    return " ".join(printable.split())[:1000]
