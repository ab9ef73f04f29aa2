"""Metrics of stored episodes from their commands: new ones filled in, the others checked.

No agent runs. What an episode was measured with is stored with it, definition by definition: a
metric that it has not, or that is defined otherwise by now, is filled in; one that it has must
come out the same to the last bit. ``inference_s`` is what was timed and stays.
"""

from __future__ import annotations

import contextlib
import math
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from crowdbench.evaluation.database import (
    FILE,
    ResultsError,
    open_for_writing,
    reported,
    transaction,
)
from crowdbench.evaluation.driven import unpacked
from crowdbench.evaluation.measured import definitions, described, metric_set, quoted, write_metrics
from crowdbench.evaluation.remeasure import (
    CHUNK,
    Piece,
    Recomputed,
    StoredCell,
    StoredRobot,
    remeasure,
)
from crowdbench.evaluation.stored import defined_scenario
from crowdbench.messages import short
from crowdbench.scenario import ScenarioError
from crowdbench.simulation import WORLD_VERSION


@dataclass(frozen=True)
class _Robot(StoredRobot):
    """With the row's number and what all its metrics are said to measure."""

    episode: int
    defined: dict[str, str]


@dataclass(frozen=True, eq=False)
class _Cell(StoredCell):
    number: int


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
        for piece, news in remeasure(_pieces(connection, cells, path), jobs):
            with transaction(connection):
                for (_, robots), new in zip(piece.seeds, news, strict=True):
                    if isinstance(new, str):
                        found.disagreements.append(new)
                    else:
                        _fill_in(connection, robots, new, found)
            found.episodes += len(piece.seeds)
            on_progress(found.episodes, total)
    return found


def _cells(connection: sqlite3.Connection, found: Recomputed) -> list[_Cell]:
    """Those whose episodes can be simulated; the others are noted."""
    query = """
        SELECT cells.id, scenario, agent, series, scenario_digest, definition, count(*),
            count(commands)
        FROM cells JOIN episodes ON cell = cells.id LEFT JOIN actions ON episode = episodes.id
        GROUP BY cells.id ORDER BY scenario, agent, cells.id"""
    cells = []
    for number, label, agent, world, digest, definition, rows, kept in connection.execute(query):
        name = f"{agent} in {label}"
        if world != WORLD_VERSION:
            found.without_commands.append(
                f"{name}: {rows} rows of world {short(world)}; this crowdbench simulates world "
                f"{WORLD_VERSION}, where the same actions come to other episodes"
            )
            continue
        try:
            scenario = defined_scenario(label, digest, definition)
        except ScenarioError as error:
            found.without_commands.append(f"{name}: {rows} rows: {error}")
            continue
        if kept and scenario is None:
            found.without_commands.append(
                f"{name}: {rows} rows of a scenario that is not known as it was (digest {digest})"
            )
            continue
        if kept < rows:
            found.without_commands.append(f"{name}: {rows - kept} of {rows} rows without commands")
        if kept and scenario is not None:
            cells.append(_Cell(label, agent, scenario, number))
    return cells


def _seeds(connection: sqlite3.Connection, cell: _Cell) -> list[int]:
    query = """
        SELECT DISTINCT seed FROM episodes JOIN actions ON episode = episodes.id
        WHERE cell = ? ORDER BY seed"""
    return [seed for (seed,) in connection.execute(query, (cell.number,))]


def _pieces(
    connection: sqlite3.Connection, cells: Sequence[_Cell], path: Path
) -> Iterator[Piece[_Cell, _Robot]]:
    """What to simulate, read as it is needed."""
    for cell in cells:
        seeds = _seeds(connection, cell)
        for first in range(0, len(seeds), CHUNK):
            chunk = seeds[first : first + CHUNK]
            yield Piece(cell, _read(connection, cell, chunk[0], chunk[-1], path))


def _read(
    connection: sqlite3.Connection, cell: _Cell, first: int, last: int, path: Path
) -> list[tuple[int, list[_Robot]]]:
    from crowdbench.evaluation.metrics import METRICS

    current = definitions(METRICS)
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
    for number, seed, told, *facts in connection.execute(query, (cell.number, first, last)):
        where = f"{path}: {cell.name}, seed {seed}"
        try:
            driven = unpacked(*facts[:7])
        except (ValueError, TypeError) as error:
            raise ResultsError(f"{where}: damaged commands ({error})") from error
        try:
            values = [math.nan if value is None else float(value) for value in facts[7:]]
            defined = described(told)
        except (ValueError, TypeError) as error:
            raise ResultsError(f"{where}: damaged metrics ({error})") from error
        known = {
            name: value
            for name, value in zip(names, values, strict=True)
            if name in current and defined.get(name) == current[name]
        }
        rows.append((seed, _Robot(driven, known, number, defined)))
    return [
        (seed, [robot for _, robot in group]) for seed, group in groupby(rows, lambda row: row[0])
    ]


def _fill_in(
    connection: sqlite3.Connection,
    robots: Sequence[_Robot],
    news: Sequence[Mapping[str, float]],
    found: Recomputed,
) -> None:
    """Write what is new of one episode."""
    for robot, new in zip(robots, news, strict=True):
        if new:
            write_metrics(connection, robot.episode, new)
            number = metric_set(connection, {**robot.defined, **definitions(new)})
            connection.execute(
                "UPDATE episodes SET metric_set = ? WHERE id = ?", (number, robot.episode)
            )
            found.filled.update(new.keys())
