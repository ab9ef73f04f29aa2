"""Metrics of the published record from its commands: new ones filled in, the others checked.

Its rows do not say how a metric was defined. One that the file of a cell has must come out the
same, whether it is a number or not defined; one that the file lacks is filled in. A cell of which
an episode came out otherwise stays as it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from crowdbench.evaluation.joined import cells_of
from crowdbench.evaluation.measured import NOT_COMPUTED
from crowdbench.evaluation.record import (
    Commands,
    Key,
    load_commands,
    load_record,
    read_record,
    write_cell,
)
from crowdbench.evaluation.recordings import published_driven
from crowdbench.evaluation.remeasure import (
    CHUNK,
    Piece,
    Recomputed,
    StoredCell,
    StoredRobot,
    remeasure,
)
from crowdbench.evaluation.results import Cell, ResultsError
from crowdbench.evaluation.rows import metric_columns
from crowdbench.scenario import load_scenario

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class _Cell(StoredCell):
    """With all that the record has of it."""

    cell: Cell
    rows: pd.DataFrame
    commands: Commands


def recompute_record(
    folder: Path,
    jobs: int = 1,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Recomputed:
    """Simulate all published episodes that have commands; fill in and check their metrics.

    Args:
        folder: of the record.
        jobs: processes.
        on_progress: told how many episodes are done, and of how many.

    Raises:
        ResultsError: nothing is published here, or a file cannot be read or written.
    """
    found = Recomputed()
    cells = _cells(folder, found)
    total = sum(len(load_commands(cell, folder).seeds) for cell in cells)
    on_progress(0, total)
    work = remeasure(_pieces(cells, folder), jobs)
    for stored, group in groupby(work, lambda pair: pair[0].cell):
        values: dict[Key, dict[str, float]] = {}
        disagreements = []
        for piece, news in group:
            for (seed, robots), new in zip(piece.seeds, news, strict=True):
                if isinstance(new, str):
                    disagreements.append(new)
                else:
                    names = (robot.driven.robot for robot in robots)
                    values |= {(seed, name): more for name, more in zip(names, new, strict=True)}
            found.episodes += len(piece.seeds)
            on_progress(found.episodes, total)
        found.disagreements += disagreements
        if not disagreements and any(values.values()):
            _fill_in(stored, values, folder, found)
    return found


def _cells(folder: Path, found: Recomputed) -> list[Cell]:
    """Those that have commands; rows that cannot be simulated are noted."""
    published = read_record(folder=folder)
    if published.rows.empty and not published.outdated:
        raise ResultsError(f"{folder}: no episodes are published here")
    cells = []
    for cell in cells_of(published.rows).values():
        rows = load_record(cell.scenario, cell.agent, folder)
        commands = load_commands(cell, folder)
        lacking = sum(
            robot not in commands.of(seed)
            for seed, robot in zip(rows["seed"], rows["robot"], strict=True)
        )
        if lacking:
            found.without_commands.append(
                f"{cell.agent} in {cell.scenario}: {lacking} of {len(rows)} rows without commands"
            )
        if lacking < len(rows):
            cells.append(cell)
    found.without_commands += [
        f"{agent} in {scenario}: rows {reason}"
        for (scenario, agent), reason in published.outdated.items()
    ]
    return cells


def _pieces(cells: Sequence[Cell], folder: Path) -> Iterator[Piece[_Cell, StoredRobot]]:
    """What to simulate, read as it is needed."""
    for cell in cells:
        rows = load_record(cell.scenario, cell.agent, folder)
        commands = load_commands(cell, folder)
        scenario = load_scenario(cell.scenario)
        stored = _Cell(cell.scenario, cell.agent, scenario, cell, rows, commands)
        seeds = [
            (int(seed), _robots(stored, int(seed), group, folder))
            for seed, group in rows[rows["seed"].isin(commands.seeds)].groupby("seed")
        ]
        for first in range(0, len(seeds), CHUNK):
            yield Piece(stored, seeds[first : first + CHUNK])


def _robots(stored: _Cell, seed: int, rows: pd.DataFrame, folder: Path) -> list[StoredRobot]:
    names = [name for name in metric_columns(rows.columns) if name != "source"]
    by_robot = {row["robot"]: row for row in rows.to_dict("records")}
    robots = []
    for driven in published_driven(by_robot.values(), stored.commands, seed):
        row = by_robot[driven.robot]
        if len(driven.commands) != row["steps"]:
            raise ResultsError(
                f"{folder}: {stored.name}, seed {seed}, {driven.robot}: {len(driven.commands)} "
                f"commands, expected one for each of the row's {row['steps']} steps"
            )
        robots.append(StoredRobot(driven, {name: row[name] for name in names}))
    return robots


def _fill_in(
    stored: _Cell, values: Mapping[Key, Mapping[str, float]], folder: Path, found: Recomputed
) -> None:
    """Write a cell with what is new of its rows, if there are commands for all of them.

    A file says by its columns what all of its rows were measured with.
    """
    rows, commands = stored.rows.drop(columns=NOT_COMPUTED), stored.commands
    keys = list(zip(rows["seed"], rows["robot"], strict=True))
    if not values.keys() >= set(keys):
        return
    for name in dict.fromkeys(name for new in values.values() for name in new):
        rows[name] = [values[key].get(name, math.nan) for key in keys]
    told: dict[Key, NDArray[np.float64]] = {}
    took: dict[Key, NDArray[np.floating]] = {}
    for seed in commands.seeds:
        told |= {(seed, robot): asked for robot, asked in commands.of(seed).items()}
        took |= {(seed, robot): times for robot, times in commands.times(seed).items()}
    write_cell(folder, stored.cell, rows, told, took)
    for new in values.values():
        found.filled.update(new.keys())
