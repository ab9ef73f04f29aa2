"""Metrics of stored episodes from their commands: new ones filled in, the others checked.

No agent runs. What an episode was measured with is stored with it, definition by definition: a
metric that it has not, or that is defined otherwise by now, is filled in; one that it has must
come out the same to the last bit. ``inference_s`` is what was timed and stays.
"""

from __future__ import annotations

import contextlib
import json
import math
import multiprocessing
import signal
import sqlite3
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from crowdbench.evaluation.database import (
    FILE,
    ResultsError,
    open_for_writing,
    reported,
    transaction,
)
from crowdbench.evaluation.driven import Driven, simulate, unpacked
from crowdbench.evaluation.measured import definitions, metric_set, quoted, write_metrics
from crowdbench.evaluation.resimulate import ResimulationError
from crowdbench.evaluation.stored import defined_scenario
from crowdbench.scenario import Scenario

_TIMED = "inference_s"
_CHUNK = 50
"""Episodes that a process gets at a time."""


@dataclass
class Recomputed:
    """What was found.

    Attributes:
        episodes: simulated again, one per seed.
        filled: in how many rows each metric was filled in.
        disagreements: a line for each episode that came out otherwise; it stays as it was.
        without_commands: a line for each cell with episodes that cannot be simulated again.
    """

    episodes: int = 0
    filled: Counter[str] = field(default_factory=Counter)
    disagreements: list[str] = field(default_factory=list)
    without_commands: list[str] = field(default_factory=list)


class _Robot(NamedTuple):
    """A stored row: its number, what the robot did, its metrics and their definitions."""

    episode: int
    driven: Driven
    values: dict[str, float]
    defined: dict[str, str]


class _Cell(NamedTuple):
    number: int
    label: str
    agent: str
    scenario: Scenario

    @property
    def name(self) -> str:
        return f"{self.agent} in {self.label}"


Seeds = list[tuple[int, list[_Robot]]]
Values = list[dict[str, float]] | str
"""The metrics of each robot, or why there are none."""


def recompute(
    folder: str | Path,
    jobs: int = 1,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Recomputed:
    """Simulate all stored episodes that have commands; fill in and check their metrics.

    Args:
        folder: results folder.
        jobs: processes.
        on_progress: told how many episodes are done, and of how many.

    Raises:
        ResultsError: nothing is stored, or the file cannot be read or written.
    """
    folder, found = Path(folder), Recomputed()
    path = folder / FILE
    if not path.exists():
        raise ResultsError(f"{folder}: no episodes are stored here; crowdbench run stores some")
    with contextlib.closing(open_for_writing(folder)) as connection, reported(path):
        cells = _cells(connection, found)
        total = sum(len(_seeds(connection, cell)) for cell in cells)
        on_progress(0, total)
        work = _work(connection, cells, path)
        for (cell, seeds), measured in _measured(work, jobs):
            with transaction(connection):
                for (seed, robots), values in zip(seeds, measured, strict=True):
                    _compare(connection, cell, seed, robots, values, found)
            found.episodes += len(seeds)
            on_progress(found.episodes, total)
    return found


def _cells(connection: sqlite3.Connection, found: Recomputed) -> list[_Cell]:
    """Those whose episodes can be simulated; the others are noted."""
    query = """
        SELECT cells.id, scenario, agent, scenario_digest, definition, count(*), count(commands)
        FROM cells JOIN episodes ON cell = cells.id LEFT JOIN actions ON episode = episodes.id
        GROUP BY cells.id ORDER BY scenario, agent, cells.id"""
    cells = []
    for number, label, agent, digest, definition, rows, kept in connection.execute(query):
        scenario = defined_scenario(label, digest, definition)
        name = f"{agent} in {label}"
        if kept and scenario is None:
            found.without_commands.append(
                f"{name}: {rows} rows of a scenario that is not known as it was (digest {digest})"
            )
            continue
        if kept < rows:
            found.without_commands.append(f"{name}: {rows - kept} of {rows} rows without commands")
        if kept and scenario is not None:
            cells.append(_Cell(number, label, agent, scenario))
    return cells


def _seeds(connection: sqlite3.Connection, cell: _Cell) -> list[int]:
    query = """
        SELECT DISTINCT seed FROM episodes JOIN actions ON episode = episodes.id
        WHERE cell = ? ORDER BY seed"""
    return [seed for (seed,) in connection.execute(query, (cell.number,))]


def _work(
    connection: sqlite3.Connection, cells: Sequence[_Cell], path: Path
) -> Iterator[tuple[_Cell, Seeds]]:
    """What to simulate, read as it is needed."""
    for cell in cells:
        seeds = _seeds(connection, cell)
        for first in range(0, len(seeds), _CHUNK):
            chunk = seeds[first : first + _CHUNK]
            yield cell, _read(connection, cell, chunk[0], chunk[-1], path)


def _read(connection: sqlite3.Connection, cell: _Cell, first: int, last: int, path: Path) -> Seeds:
    names = [row[1] for row in connection.execute("PRAGMA table_info(metrics)")][1:]
    columns = "".join(f", metrics.{quoted(name)}" for name in names)
    query = f"""
        SELECT e.id, e.seed, definitions, e.robot, e.outcome, e.error, e.diagnostics, e.steps,
            actions.commands, actions.inference_s {columns}
        FROM episodes AS e JOIN actions ON actions.episode = e.id
        JOIN metrics ON metrics.episode = e.id
        JOIN metric_sets ON metric_sets.id = metric_set
        WHERE e.cell = ? AND e.seed BETWEEN ? AND ? ORDER BY e.seed, length(e.robot), e.robot"""
    rows = []
    for number, seed, defined, *facts in connection.execute(query, (cell.number, first, last)):
        try:
            driven = unpacked(*facts[:7])
        except ValueError as error:
            raise ResultsError(
                f"{path}: {cell.name}, seed {seed}: damaged commands ({error})"
            ) from error
        values = [math.nan if value is None else value for value in facts[7:]]
        stored = dict(zip(names, values, strict=True))
        rows.append((seed, _Robot(number, driven, stored, json.loads(defined))))
    return [
        (seed, [robot for _, robot in group]) for seed, group in groupby(rows, lambda row: row[0])
    ]


def _measured(
    work: Iterator[tuple[_Cell, Seeds]], jobs: int
) -> Iterator[tuple[tuple[_Cell, Seeds], list[Values]]]:
    """Each piece of work with the metrics of its episodes, computed in processes."""
    if jobs == 1:
        for cell, seeds in work:
            yield (cell, seeds), _measure(cell, _driven(seeds))
        return
    waiting: deque[tuple[tuple[_Cell, Seeds], Future[list[Values]]]] = deque()
    with ProcessPoolExecutor(
        jobs,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),  # Ctrl-C is for the process that writes
    ) as pool:
        for cell, seeds in work:
            waiting.append(((cell, seeds), pool.submit(_measure, cell, _driven(seeds))))
            if len(waiting) > 2 * jobs:
                piece, future = waiting.popleft()
                yield piece, future.result()
        for piece, future in waiting:
            yield piece, future.result()


def _driven(seeds: Seeds) -> list[tuple[int, list[Driven]]]:
    return [(seed, [robot.driven for robot in robots]) for seed, robots in seeds]


def _measure(cell: _Cell, seeds: Sequence[tuple[int, list[Driven]]]) -> list[Values]:
    """Simulate episodes and compute every metric of each robot."""
    from crowdbench.evaluation.metrics import metrics
    from crowdbench.simulation.env import CrowdEnv

    env, found = CrowdEnv(cell.scenario), list[Values]()
    for seed, driven in seeds:
        try:
            episodes = simulate(env, seed, driven, label=cell.agent)
        except ResimulationError as error:
            found.append(str(error))
        else:
            found.append([metrics(episode) for episode in episodes])
    return found


def _compare(
    connection: sqlite3.Connection,
    cell: _Cell,
    seed: int,
    robots: Sequence[_Robot],
    values: Values,
    found: Recomputed,
) -> None:
    """Fill in what is new of one episode, or note that it came out otherwise."""
    if isinstance(values, str):
        found.disagreements.append(f"{cell.label}: {values}")
        return
    news = []
    for robot, computed in zip(robots, values, strict=True):
        current = definitions(computed)
        known = {name for name in computed if robot.defined.get(name) == current[name]}
        for name in sorted(known - {_TIMED}):
            if not _same(robot.values[name], computed[name]):
                found.disagreements.append(
                    f"{cell.name}, seed {seed}, {robot.driven.robot}: {name} is "
                    f"{computed[name]!r}, stored as {robot.values[name]!r}"
                )
                return
        news.append({name: value for name, value in computed.items() if name not in known})
    for robot, new in zip(robots, news, strict=True):
        if new:
            _write(connection, robot, new)
            found.filled.update(new.keys())


def _write(connection: sqlite3.Connection, robot: _Robot, new: Mapping[str, float]) -> None:
    write_metrics(connection, robot.episode, new)
    number = metric_set(connection, {**robot.defined, **definitions(new)})
    connection.execute("UPDATE episodes SET metric_set = ? WHERE id = ?", (number, robot.episode))


def _same(one: float, other: float) -> bool:
    return one == other or (math.isnan(one) and math.isnan(other))
