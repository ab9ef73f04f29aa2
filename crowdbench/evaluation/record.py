"""The published record: rows and commands of all tables' episodes, compressed and read-only.

One cell, an agent with its options in a scenario, is up to three files, named as its rows say::

    rows/<scenario>/<agent>.csv.gz       one row per episode and robot
    actions/<scenario>/<agent>.npz       commands of seeds 0-99
    rest/<scenario>/<agent>.npz          commands of the other seeds, in the repository alone

``rows`` and ``actions`` are installed with crowdbench and found wherever it is. All rows of a cell
are one measurement: they agree in what identifies an episode (see ``results``). Rows whose
commands were not kept are allowed.
"""

from __future__ import annotations

import gzip
import io
import json
import os
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.evaluation.measured import NOT_COMPUTED, lacking
from crowdbench.evaluation.results import Cell, ResultsError, slug
from crowdbench.messages import brief, short
from crowdbench.scenario import ScenarioError, load_scenario
from crowdbench.simulation import WORLD_VERSION

if TYPE_CHECKING:
    import pandas as pd

Key = tuple[int, str]
"""Seed and robot."""

INSTALLED_SEEDS = range(100)
"""Seeds whose commands are installed with crowdbench."""
VERSIONS = ("architecture", "version", "pymunk", "numpy", "torch")
"""What an episode ran on, beside the machine; empty or "0.1.0" in rows that 0.1.0 has stored."""
FIRST_WORLD = "0.1"
"""The world of rows that do not name one, as 0.1.0 has stored them."""
_IDENTITY = tuple(field.name for field in fields(Cell))
_LAST = ("steps", "error", "diagnostics", "machine", *VERSIONS, "timestamp")
_FACTS = ("robot", "outcome", *_LAST[1:])
_FIRST = (*_IDENTITY, "seed", "robot", "outcome")
_ADDED = ("source", NOT_COMPUTED)
"""Columns that rows have once they are read; no file has them."""
_ARRAYS = ("seeds", "robots", "lengths", "commands", "inference")
_DAMAGE = (
    OSError, EOFError, ValueError, KeyError, OverflowError, RuntimeError, zlib.error,
    zipfile.BadZipFile,
)  # fmt: skip


class Published(NamedTuple):
    """Rows of the record.

    Attributes:
        rows: as ``load_results`` gives them, with ``source`` "published".
        outdated: by scenario and agent why the rows of other cells do not count any more.
    """

    rows: pd.DataFrame
    outdated: dict[tuple[str, str], str]


class Commands:
    """What the robots of one cell were told, episode by episode."""

    def __init__(self, arrays: Mapping[str, NDArray[np.generic]] | None = None) -> None:
        """Take the arrays of a file; none is a cell without commands.

        Raises:
            ValueError, KeyError: arrays that do not belong together.
        """
        self._where: dict[int, dict[str, slice]] = {}
        if arrays is None:
            return
        self._commands = np.asarray(arrays["commands"], dtype=np.float64)
        self._inference = np.asarray(arrays["inference"], dtype=np.float64)
        seeds, robots = arrays["seeds"], arrays["robots"]
        lengths = np.asarray(arrays["lengths"], dtype=np.int64)
        if not len(seeds) == len(robots) == len(lengths) or (lengths < 0).any():
            raise ValueError("seeds, robots and lengths do not fit each other")
        total = int(lengths.sum())
        if self._commands.shape != (total, 2) or self._inference.shape != (total,):
            raise ValueError("commands and times are not as many as the lengths say")
        if not np.isfinite(self._commands).all():
            raise ValueError("commands that are no finite numbers")
        ends = np.cumsum(lengths)
        for seed, robot, end, length in zip(seeds, robots, ends, lengths, strict=True):
            place = slice(int(end - length), int(end))
            self._where.setdefault(int(seed), {})[str(robot)] = place

    @property
    def seeds(self) -> set[int]:
        """Episodes whose commands there are."""
        return set(self._where)

    def of(self, seed: int) -> dict[str, NDArray[np.float64]]:
        """For each robot (T, 2) as in ``Episode.commands``; nothing if they were not kept."""
        places = self._where.get(seed, {})
        return {robot: self._commands[place] for robot, place in places.items()}

    def times(self, seed: int) -> dict[str, NDArray[np.float64]]:
        """For each robot (T,) seconds spent in ``act``, NaN where that was not noted."""
        places = self._where.get(seed, {})
        return {robot: self._inference[place] for robot, place in places.items()}


def record_folder() -> Path:
    """Where the installed record is; in a checkout ``results/record``."""
    return Path(str(resources.files("crowdbench_results"))) / "record"


def load_record(
    scenario: str | None = None, agent: str | None = None, folder: Path | None = None
) -> pd.DataFrame:
    """The rows of ``read_record``, those of scenarios and the world as they are today."""
    return read_record(scenario, agent, folder).rows


def read_record(
    scenario: str | None = None, agent: str | None = None, folder: Path | None = None
) -> Published:
    """Read published rows, sorted by scenario, agent, seed and robot.

    Args:
        scenario: only this one.
        agent: only this one, with its options.
        folder: of the record, by default the installed one.

    Raises:
        ResultsError: a file that is damaged; the message names it.
    """
    import pandas as pd

    folder = folder or record_folder()
    tables, outdated = [], dict[tuple[str, str], str]()
    digests: dict[str, str | None] = {}
    for path in _row_files(folder, scenario, agent):
        rows = _read_rows(path)
        cell = Cell(*(str(rows[key].iloc[0]) for key in _IDENTITY))
        if cell.scenario not in digests:
            digests[cell.scenario] = _digest_today(cell.scenario)
        if cell.world != WORLD_VERSION:
            outdated[cell.scenario, cell.agent] = (
                f"of world {short(cell.world)}, and this crowdbench simulates world {WORLD_VERSION}"
            )
        elif cell.scenario_digest != digests[cell.scenario]:
            outdated[cell.scenario, cell.agent] = "of a scenario that is defined otherwise by now"
        else:
            tables.append(rows)
    if not tables:
        return Published(pd.DataFrame(columns=[*_FIRST, *_LAST, *_ADDED]), outdated)
    found = pd.concat(tables, ignore_index=True)
    found["source"] = "published"
    order = ["scenario", "agent", "seed", "robot"]
    return Published(found.sort_values(order, ignore_index=True), outdated)


def load_commands(cell: Cell, folder: Path | None = None) -> Commands:
    """Read the published commands of a cell, those of seeds 0-99 where the rest is not there.

    Raises:
        ResultsError: a file that is damaged; the message names it.
    """
    folder = folder or record_folder()
    parts = [_read_arrays(path, cell) for path in _command_files(folder, cell)]
    there = [part for part in parts if part is not None]
    if not there:
        return Commands()
    return Commands({name: np.concatenate([part[name] for part in there]) for name in there[0]})


def write_cell(
    folder: Path,
    cell: Cell,
    rows: pd.DataFrame,
    commands: Mapping[Key, NDArray[np.float64]],
    inference: Mapping[Key, NDArray[np.floating]] | None = None,
) -> None:
    """Write all that the record has of a cell, in place of what it had.

    Each file is replaced at once; stopped between two files, the same call mends it.

    Args:
        folder: of the record.
        cell: identifies the episodes.
        rows: one per episode and robot, with the columns of ``load_results``; those of the
            identity may be missing, and those of ``VERSIONS``.
        commands: for each seed and robot whose commands were kept (T, 2), T the row's ``steps``.
        inference: likewise (T,) seconds.

    Raises:
        ResultsError: rows or commands that do not belong together or to the cell, or a folder
            that cannot be written to.
    """
    where = f"{cell.agent} in {cell.scenario}"
    table = _normal(cell, rows, where)
    steps = dict(zip(zip(table["seed"], table["robot"], strict=True), table["steps"], strict=True))
    for (seed, robot), given in commands.items():
        if np.shape(given) != (steps.get((seed, robot), -1), 2) or not np.isfinite(given).all():
            expected = steps.get((seed, robot), "no such row")
            raise ResultsError(
                f"{where}, seed {seed}, {robot}: commands of shape {np.shape(given)}, expected one "
                f"finite pair for each of the row's steps ({expected})"
            )
    kept = sorted(commands)
    installed = [key for key in kept if key[0] in INSTALLED_SEEDS]
    rest = [key for key in kept if key[0] not in INSTALLED_SEEDS]
    text = table.to_csv(index=False, lineterminator="\n")
    try:
        for path, keys in zip(_command_files(folder, cell), (installed, rest), strict=True):
            if keys:
                _replace(path, _packed(cell, keys, commands, inference or {}))
            else:
                path.unlink(missing_ok=True)
        _replace(_row_file(folder, cell), gzip.compress(text.encode(), 9, mtime=0))
    except OSError as error:
        reason = error.strerror or str(error)
        raise ResultsError(f"{folder}: the record cannot be written ({reason})") from error


def _row_file(folder: Path, cell: Cell) -> Path:
    return folder / "rows" / slug(cell.scenario) / f"{slug(cell.agent)}.csv.gz"


def _command_files(folder: Path, cell: Cell) -> tuple[Path, Path]:
    """The installed file and the rest."""
    name = Path(slug(cell.scenario)) / f"{slug(cell.agent)}.npz"
    return folder / "actions" / name, folder / "rest" / name


def _row_files(folder: Path, scenario: str | None, agent: str | None) -> list[Path]:
    place = "*" if scenario is None else slug(scenario)
    who = "*" if agent is None else slug(agent)
    return sorted((folder / "rows").glob(f"{place}/{who}.csv.gz"))


def _digest_today(scenario: str) -> str | None:
    try:
        return load_scenario(scenario).digest
    except ScenarioError:
        return None


def _read_rows(path: Path) -> pd.DataFrame:
    """The rows of one file, floats exactly as they were written."""
    import pandas as pd

    from crowdbench.evaluation.rows import check_rows

    # From 3.1 on, pandas always reads floats exactly, and warns of the option.
    version = tuple(int(part) for part in pd.__version__.split(".")[:2])
    exact = {} if version >= (3, 1) else {"float_precision": "round_trip"}
    try:
        text = gzip.decompress(path.read_bytes())
        names = text.partition(b"\n")[0].decode().split(",")
        words = dict.fromkeys((*_IDENTITY, *_FACTS), str)
        numbers = {name: float for name in names if name not in words} | {"seed": int, "steps": int}
        rows = pd.read_csv(
            io.BytesIO(text),
            dtype=words | numbers,
            keep_default_na=False,
            na_values={key: ["", "nan"] for key in numbers},
            **exact,
        )
        rows["world"] = rows.get("world", FIRST_WORLD)
        missing = [name for name in (*_FIRST, *_LAST) if name not in rows]
        if missing or rows.empty:
            raise ValueError(f"without {', '.join(missing) or 'rows'}")
        _require_one_cell(rows, path)
    except _DAMAGE as error:
        raise ResultsError(f"{path}: not rows of the record ({brief(error)})") from error
    check_rows(rows, path)
    return rows.assign(**{NOT_COMPUTED: lacking(names)})


def _require_one_cell(rows: pd.DataFrame, path: Path) -> None:
    """Refuse rows that would be counted twice, or as somebody else's."""
    found = rows[list(_IDENTITY)].drop_duplicates().itertuples(index=False)
    first, *others = (Cell(*values) for values in found)
    if path != _row_file(path.parents[2], first):
        raise ValueError(f"they are of {first.agent} in {first.scenario}")
    if any(other.identity != first.identity for other in others):
        raise ValueError("they are of more than one measurement")
    twice = rows[rows.duplicated(["seed", "robot"])]
    if len(twice):
        raise ValueError(f"seed {twice['seed'].iloc[0]}, {twice['robot'].iloc[0]} is there twice")


def _read_arrays(path: Path, cell: Cell) -> dict[str, NDArray[np.generic]] | None:
    """The arrays of one file; None if it is not there or, with a warning, another's."""
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            if json.loads(str(file["identity"])) != list(cell.identity):
                warnings.warn(
                    f"{path}: commands of another measurement than the rows, left out (other "
                    "weights, code, world or scenario); publishing the cell anew replaces them",
                    stacklevel=4,
                )
                return None
            arrays = {name: file[name] for name in _ARRAYS}
        Commands(arrays)
    except _DAMAGE as error:
        raise ResultsError(f"{path}: not commands of the record ({brief(error)})") from error
    return arrays


def _normal(cell: Cell, rows: pd.DataFrame, where: str) -> pd.DataFrame:
    """Rows with all columns in the record's order, sorted by seed and robot."""
    older = [set(text.split()) for text in set(rows.get(NOT_COMPUTED, default=[""]))]
    # A column says that all rows were measured with a metric.
    absent = set.intersection(*older) if older else set()
    table = rows.drop(columns=[*_ADDED, *absent], errors="ignore").copy()
    for name, value in asdict(cell).items():
        table[name] = table.get(name, value)
    for name in VERSIONS:
        table[name] = table.get(name, "")
    missing = [name for name in (*_FIRST, *_LAST) if name not in table]
    if missing or table.empty:
        raise ResultsError(f"{where}: rows without {', '.join(missing) or 'a single one'}")
    names = list(_IDENTITY)
    for values in table[names].drop_duplicates().itertuples(index=False):
        other = Cell(*values)
        if other.identity != cell.identity:
            raise ResultsError(f"{where}: a row of another measurement: {other.identity}")
    twice = table[table.duplicated(["seed", "robot"])]
    if len(twice):
        first = twice.iloc[0]
        raise ResultsError(f"{where}: seed {first['seed']}, {first['robot']} is there twice")
    metrics = [name for name in table if name not in (*_FIRST, *_LAST)]
    table = table[[*_FIRST, *metrics, *_LAST]]
    return table.sort_values(["seed", "robot"], ignore_index=True)


def _packed(
    cell: Cell,
    keys: Iterable[Key],
    commands: Mapping[Key, NDArray[np.float64]],
    inference: Mapping[Key, NDArray[np.floating]],
) -> bytes:
    keys = list(keys)
    lengths = [len(commands[key]) for key in keys]
    unknown = [np.full(length, np.nan) for length in lengths]
    times = [inference.get(key, empty) for key, empty in zip(keys, unknown, strict=True)]
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        identity=np.array(json.dumps(cell.identity)),
        seeds=np.array([seed for seed, _ in keys], dtype=np.int64),
        robots=np.array([robot for _, robot in keys], dtype=str),
        lengths=np.array(lengths, dtype=np.int64),
        commands=np.concatenate([np.reshape(commands[key], (-1, 2)) for key in keys]).astype("<f8"),
        inference=np.concatenate(times).astype("<f4"),
    )
    return buffer.getvalue()


def _replace(path: Path, content: bytes) -> None:
    """Write a file beside its place and move it there, so that no half of it is ever seen."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
