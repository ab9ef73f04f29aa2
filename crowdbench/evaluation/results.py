"""The results store: one row per episode and robot, with what the robot did.

Layout: one SQLite file, ``FOLDER/results.sqlite`` (``database`` has the schema). An episode is
added in one transaction, with its metrics and commands, and stays as it is; ``recompute`` alone
fills in metrics that are new. A scenario that is not, field by field, one of crowdbench's own
(overridden, or from a file) has the label ``<scenario>@<digest>``, so that it is never mixed up
with the plain one.

An episode counts as stored when scenario digest, agent string, weights hash, code, seed and the
world's version (``crowdbench.simulation.WORLD_VERSION``) are the same. Episodes of another world
stay in the file and are not read.
"""

from __future__ import annotations

import hashlib
import platform
import re
import sqlite3
import warnings
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench.evaluation.database import (
    CELL_IS,
    FILE,
    ResultsError,
    Writer,
    open_for_writing,
    opened_for_reading,
    reported,
    transaction,
)
from crowdbench.evaluation.driven import Driven, unpacked
from crowdbench.evaluation.inserts import cell_number, counters, forget_error, insert
from crowdbench.messages import short
from crowdbench.scenario import Scenario, ScenarioError, load_scenario
from crowdbench.simulation import WORLD_VERSION

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    from numpy.typing import NDArray

    from crowdbench.evaluation.episode import Episode

__all__ = [
    "Cell",
    "Origin",
    "Result",
    "ResultsError",
    "ResultsStore",
    "load_commands",
    "load_driven",
    "load_results",
    "require_episodes",
    "scenario_label",
    "slug",
]


@dataclass(frozen=True)
class Cell:
    """One agent in one scenario: what the episodes of one cell of a table have in common.

    Attributes:
        scenario: label of the scenario, see ``scenario_label``.
        scenario_digest: ``Scenario.digest``.
        agent: the agent with its options, e.g. ``NAME:horizon=2``.
        options: the options alone, JSON.
        world: version of the world, ``crowdbench.simulation.WORLD_VERSION``.
        weights_sha256: hash of the agent's weights, empty without.
        code: hash of the agent's file (``file.py:Class``), or the distribution it comes with and
            its version.
    """

    scenario: str
    scenario_digest: str
    agent: str
    options: str
    world: str
    weights_sha256: str
    code: str

    @property
    def identity(self) -> tuple[str, ...]:
        """What has to be equal for two episodes of one seed to be the same measurement."""
        names = ("scenario", "scenario_digest", "agent", "weights_sha256", "code", "world")
        return tuple(getattr(self, name) for name in names)


@dataclass(frozen=True)
class Origin:
    """Where and when an episode was run; empty where that was not noted.

    Attributes:
        machine: the processor, its cores, and how many threads an agent had.
        architecture: of the processor, e.g. ``x86_64``.
        version: of crowdbench.
        pymunk, numpy, torch: versions of what an episode depends on.
        timestamp: UTC, ISO 8601.
    """

    machine: str = ""
    architecture: str = ""
    version: str = ""
    pymunk: str = ""
    numpy: str = ""
    torch: str = ""
    timestamp: str = ""

    @classmethod
    def of(cls, machine: str) -> Origin:
        """This process, which runs on a machine of this name, at no particular time."""
        libraries = {name: version(name) for name in ("pymunk", "numpy", "torch")}
        own = version("crowdbench-nav")
        return cls(machine, platform.machine(), own, **libraries)

    def now(self) -> Origin:
        """The same place with the time that it is."""
        return replace(self, timestamp=datetime.now(UTC).isoformat(timespec="seconds"))


@dataclass(frozen=True)
class Result:
    """One robot's episode as it is stored.

    Attributes:
        seed: episode seed.
        robot: name of the robot in the environment.
        outcome: how it ended.
        steps: T, the number of control steps.
        metrics: values by name, NaN where one is not defined.
        error: the agent's message, one line.
        diagnostics: the agent's own counters.
        origin: where it was run.
        commands: (T, 2), as in ``Episode.commands``; None where they were not kept.
        inference_s: (T,) wall-clock seconds spent in ``act``; None without commands.
    """

    seed: int
    robot: str
    outcome: str
    steps: int
    metrics: Mapping[str, float]
    error: str = ""
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    origin: Origin = field(default_factory=Origin)
    commands: NDArray[np.float64] | None = None
    inference_s: NDArray[np.float64] | None = None

    @classmethod
    def of(cls, episode: Episode, metrics: Mapping[str, float], origin: Origin) -> Result:
        """An episode that was just run or simulated."""
        return cls(
            episode.seed,
            episode.robot,
            episode.outcome,
            episode.steps,
            metrics,
            one_line(episode.error or ""),
            episode.diagnostics,
            Origin(**{**asdict(origin), "machine": one_line(origin.machine)}),
            episode.commands,
            episode.inference_s,
        )

    def row(self, cell: Cell) -> dict[str, Any]:
        """What ``load_results`` will say of it."""
        facts = {"seed": self.seed, "robot": self.robot, "outcome": self.outcome}
        rest = {"steps": self.steps, "error": self.error, "diagnostics": counters(self.diagnostics)}
        return {**asdict(cell), **facts, **self.metrics, **rest, **asdict(self.origin)}


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


def one_line(text: str) -> str:
    """Text as one line of printable characters, at most 1000."""
    printable = "".join(c if c.isprintable() else " " for c in text)
    return " ".join(printable.split())[:1000]


class ResultsStore:
    """Adds episodes to the database of a folder; any number of processes may do so at once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.path = folder / FILE
        self._connection: Writer | None = None

    def stored(self, cell: Cell, *, errors: bool = True) -> dict[int, set[str]]:
        """The robots whose episodes are stored, for each seed.

        Args:
            cell: whose episodes.
            errors: those that ended with ``agent_error`` included.

        Raises:
            ResultsError: the file cannot be read.
        """
        seeds: dict[int, set[str]] = {}
        with opened_for_reading(self.folder) as connection:
            if connection is not None:
                query = f"SELECT seed, robot FROM episodes JOIN cells ON cell = cells.id {CELL_IS}"
                query += "" if errors else " AND outcome != 'agent_error'"
                for seed, robot in connection.execute(query, cell.identity):
                    seeds.setdefault(seed, set()).add(robot)
        return seeds

    def append(
        self,
        cell: Cell,
        results: Sequence[Result],
        scenario: Scenario | None = None,
        *,
        replace_errors: bool = False,
    ) -> int:
        """Store episodes in one transaction, except those that are there.

        Args:
            cell: to which they belong.
            results: for each robot and seed one.
            scenario: the definition, without which they cannot be simulated again.
            replace_errors: in place of an episode in which a robot had an ``agent_error``.

        Returns:
            How many are new.

        Raises:
            ResultsError: the disk is full, or the file is locked, damaged, not writable or gone.
        """
        connection = self._writer()
        with reported(self.path), transaction(connection):
            number = cell_number(connection, cell, scenario)
            if replace_errors:
                for seed in {result.seed for result in results}:
                    forget_error(connection, number, seed)
            return sum(insert(connection, number, result) for result in results)

    def rows(self, cell: Cell) -> pd.DataFrame:
        """The stored rows of a cell, sorted by seed and robot."""
        from crowdbench.evaluation.rows import empty_frame, read_frame

        with opened_for_reading(self.folder) as connection:
            if connection is None:
                return empty_frame()
            found = connection.execute(f"SELECT id FROM cells {CELL_IS}", cell.identity)
            return read_frame(connection, [number for (number,) in found], self.path)

    def _writer(self) -> Writer:
        if self._connection is None:
            self._connection = open_for_writing(self.folder)
            weakref.finalize(self, self._connection.close)
        return self._connection


def load_results(
    folder: str | Path, scenario: str | None = None, agent: str | None = None
) -> pd.DataFrame:
    """Read stored episodes, one row each, sorted by scenario, agent, seed and robot.

    Rows of a cell that have been superseded (the scenario's definition, the weights or the agent's
    code changed since) are left out: only those that agree with the cell's latest row are returned.
    So are rows of another world, with a warning.

    Args:
        folder: the results folder.
        scenario: only this label, e.g. ``multimodal_fast`` or ``multimodal_fast@1a2b3c4d5e6f``.
        agent: only this agent, with its options.

    Raises:
        ResultsError: the file cannot be read, or a row holds what cannot be.
    """
    from crowdbench.evaluation.rows import empty_frame, read_frame

    with opened_for_reading(Path(folder)) as connection:
        if connection is None:
            return empty_frame()
        _warn_of_other_worlds(connection, Path(folder))
        cells = [
            number
            for number, label, name in latest_cells(connection)
            if scenario in (None, label) and agent in (None, name)
        ]
        return read_frame(connection, cells, Path(folder) / FILE)


def require_episodes(folder: Path) -> None:
    """Refuse a results folder in which ``load_results`` finds nothing, or that is none.

    Raises:
        ResultsError: no episode of this world is stored there, or the file cannot be read.
    """
    with opened_for_reading(folder) as connection:
        if connection is not None:
            if latest_cells(connection):
                return
            _warn_of_other_worlds(connection, folder)
    raise ResultsError(f"{folder}: no episodes are stored here; crowdbench run stores some")


def load_driven(folder: str | Path, cell: Cell, seed: int) -> list[Driven] | None:
    """What the robots of a stored episode did, in their order.

    Returns:
        None if the episode is not stored, or not its commands.

    Raises:
        ResultsError: it cannot be read.
    """
    path = Path(folder) / FILE
    with opened_for_reading(Path(folder)) as connection:
        if connection is None:
            return None
        query = f"""
            SELECT robot, outcome, error, diagnostics, steps, commands, inference_s FROM episodes
            JOIN cells ON cell = cells.id LEFT JOIN actions ON episode = episodes.id
            {CELL_IS} AND seed = ? ORDER BY length(robot), robot"""
        rows = connection.execute(query, (*cell.identity, seed)).fetchall()
    if not rows or any(row[-1] is None for row in rows):
        return None
    where = f"{path}: {cell.agent} in {cell.scenario}, seed {seed}"
    try:
        return [unpacked(*row) for row in rows]
    except ValueError as error:
        raise ResultsError(f"{where}: damaged commands ({error})") from error


def load_commands(folder: str | Path, cell: Cell, seed: int) -> list[NDArray[np.float64]] | None:
    """The commands (T, 2) of each robot of a stored episode; as ``load_driven``."""
    driven = load_driven(folder, cell, seed)
    return None if driven is None else [one.commands for one in driven]


def latest_cells(connection: sqlite3.Connection) -> list[tuple[int, str, str]]:
    """Number, scenario and agent of the cells of this world that no later one supersedes."""
    query = """
        SELECT cells.id, scenario, agent FROM cells JOIN episodes ON cell = cells.id
        WHERE series = ? GROUP BY cells.id ORDER BY max(timestamp), max(episodes.id)"""
    found = connection.execute(query, (WORLD_VERSION,))
    latest = {(label, name): number for number, label, name in found}
    return [(number, *key) for key, number in latest.items()]


def _warn_of_other_worlds(connection: sqlite3.Connection, folder: Path) -> None:
    query = """
        SELECT series, count(*) FROM cells JOIN episodes ON cell = cells.id
        WHERE series != ? GROUP BY series ORDER BY series"""
    for world, count in connection.execute(query, (WORLD_VERSION,)):
        warnings.warn(
            f"{folder}: {count:,} rows are of world {short(world)} and left out; this crowdbench "
            f"simulates world {WORLD_VERSION}, where the same actions come to other episodes",
            stacklevel=3,
        )
