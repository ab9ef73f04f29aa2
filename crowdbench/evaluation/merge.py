"""Several results folders into one, such as the shards of a run on many machines.

An episode that is there already is not added again. Of two runs of the same episode the first
stays, provided that it came out the same (``docs/metrics.md``, "The same episode on another
machine"); else nothing is merged at all, since one of the two is wrong.
"""

from __future__ import annotations

import contextlib
import math
import sqlite3
import tempfile
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, fields
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

from crowdbench.evaluation.database import (
    CELL_IS,
    FILE,
    ResultsError,
    Writer,
    open_for_writing,
    opened_for_reading,
    reported,
    require_writable,
    transaction,
)
from crowdbench.evaluation.measured import described, metric_set, quoted, write_metrics
from crowdbench.evaluation.results import Origin, latest_cells, load_results
from crowdbench.messages import short
from crowdbench.simulation import WORLD_VERSION

SAME_WITHIN = 1e-5
"""Relative difference of a metric up to which an episode came out the same."""
_TIMED = "inference_s"
_SHOWN = 3
"""Disagreements that a message names."""
_RANGES = 20
"""Gaps among the seeds of a cell that a line names."""
_IDENTITY = ("scenario", "scenario_digest", "agent", "weights_sha256", "code", "series")
_CALLED = {"scenario_digest": "definitions of the scenario", "weights_sha256": "weights"}
_FACTS = (
    *("seed", "robot", "outcome", "steps", "error", "diagnostics"),
    *(one.name for one in fields(Origin)),
)
_Key = tuple[str, str]
"""Scenario and agent."""


@dataclass
class Merged:
    """What merging has come to, in episodes.

    Attributes:
        added: that are new.
        there: that were there, from the same run.
        repeated: that were there, from another run that took other times.
        missing: a line for each cell that lacks seeds between its first and its last.
    """

    added: int = 0
    there: int = 0
    repeated: int = 0
    missing: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _Row:
    """One robot's episode.

    Attributes:
        facts: columns of the table of episodes.
        metrics: values by name, None where one is not defined.
        defined: what each metric is said to measure.
        actions: commands and times as they are stored, if they are.
    """

    facts: Mapping[str, Any]
    metrics: Mapping[str, float | None]
    defined: Mapping[str, str]
    actions: tuple[bytes, bytes] | None


_Robots = dict[str, _Row]


def merge(sources: Sequence[Path], target: Path) -> Merged:
    """Add the episodes of results folders to those of another, all of them or none.

    Raises:
        ResultsError: a source has no results, is the target, holds rows of another world or what
            cannot be; or two folders disagree, in what a cell is or in how an episode came out.
    """
    for source in sources:
        _require_source(source, target)
    require_writable(target)
    _require_one_measurement([target, *sources])
    if (target / FILE).exists():
        return _merge_into(target, sources)
    # What is refused leaves no file: a new one takes its place when it is whole.
    with reported(target / FILE), tempfile.TemporaryDirectory(dir=target, prefix=".new-") as new:
        merged = _merge_into(Path(new), sources)
        try:
            (target / FILE).hardlink_to(Path(new) / FILE)
        except FileExistsError:  # another process was faster
            return _merge_into(target, sources)
    return merged


def _merge_into(target: Path, sources: Sequence[Path]) -> Merged:
    """Merge sources that have been checked."""
    merged, disagreements = Merged(), list[str]()
    with contextlib.closing(open_for_writing(target)) as connection, reported(target / FILE):
        with transaction(connection):
            touched: set[int] = set()
            for source in sources:
                with opened_for_reading(source) as other:
                    assert other is not None
                    touched |= _merge_cells(connection, other, source, merged, disagreements)
            if disagreements:
                more = len(disagreements) - _SHOWN
                told = "; ".join(disagreements[:_SHOWN]) + (f"; {more} more" if more > 0 else "")
                raise ResultsError(f"nothing is merged, since episodes came out otherwise: {told}")
        merged.missing = _missing(connection, touched)
    return merged


def _require_source(source: Path, target: Path) -> None:
    if not (source / FILE).is_file():
        raise ResultsError(f"{source}: no results here ({FILE}); merge takes results folders")
    if source.resolve() == target.resolve():
        raise ResultsError(f"{source}: cannot be merged into itself")
    with opened_for_reading(source) as connection:
        assert connection is not None
        worlds = {world for (world,) in connection.execute("SELECT series FROM cells")}
    for world in sorted(worlds - {WORLD_VERSION}):
        raise ResultsError(
            f"{source}: rows of world {short(world)}; this crowdbench simulates world "
            f"{WORLD_VERSION}, and merges no others"
        )
    load_results(source)  # refuses rows that hold what cannot be


def _require_one_measurement(folders: Sequence[Path]) -> None:
    """Refuse an agent in a scenario of which a later measurement would supersede another."""
    known: dict[_Key, tuple[Path, tuple[str, ...]]] = {}
    for folder in folders:
        with opened_for_reading(folder) as connection:
            cells = [] if connection is None else latest_cells(connection)
            for number, *key in cells:
                assert connection is not None
                query = f"SELECT {', '.join(_IDENTITY)} FROM cells WHERE id = ?"
                found = connection.execute(query, (number,)).fetchone()
                first, expected = known.setdefault((key[0], key[1]), (folder, found))
                for name, one, other in zip(_IDENTITY, expected, found, strict=True):
                    if one != other:
                        raise ResultsError(
                            f"{key[1]} in {key[0]}: {first} and {folder} have other "
                            f"{_CALLED.get(name, name)} ({short(one)}, {short(other)})"
                        )


def _merge_cells(
    connection: Writer,
    other: sqlite3.Connection,
    source: Path,
    merged: Merged,
    disagreements: list[str],
) -> set[int]:
    """Add the episodes of every cell; returns the cells' numbers."""
    other.execute("BEGIN")  # one state of the file, whoever writes meanwhile
    columns = (*_IDENTITY, "options", "definition")
    cells = set()
    for number, *facts in other.execute(f"SELECT id, {', '.join(columns)} FROM cells"):
        connection.execute(
            f"INSERT INTO cells ({', '.join(columns)}) VALUES ({_marks(columns)}) "
            "ON CONFLICT DO UPDATE SET definition = excluded.definition WHERE definition = ''",
            facts,
        )
        identity = facts[: len(_IDENTITY)]
        (cell,) = connection.execute(f"SELECT id FROM cells {CELL_IS}", identity).fetchone()
        cells.add(cell)
        name = f"{facts[2]} in {facts[0]}"
        there = dict(_episodes(connection, cell, connection.path.parent))
        for seed, robots in _episodes(other, number, source):
            if seed not in there:
                for row in robots.values():
                    _insert(connection, cell, row)
                merged.added += 1
                continue
            difference = _difference(there[seed], robots)
            if difference:
                disagreements.append(f"{name}, seed {seed}, {difference} in {source}")
            elif _same_run(there[seed], robots):
                merged.there += 1
            else:
                merged.repeated += 1
    return cells


def _episodes(
    connection: sqlite3.Connection, cell: int, folder: Path
) -> Iterator[tuple[int, _Robots]]:
    """The robots of each seed of a cell."""
    names = [row[1] for row in connection.execute("PRAGMA table_info(metrics)")][1:]
    columns = [f"e.{name}" for name in _FACTS] + ["definitions", "commands", "actions.inference_s"]
    columns += [f"metrics.{quoted(name)}" for name in names]
    query = f"""
        SELECT {", ".join(columns)} FROM episodes AS e JOIN metrics ON metrics.episode = e.id
        JOIN metric_sets ON metric_sets.id = metric_set LEFT JOIN actions ON actions.episode = e.id
        WHERE cell = ? ORDER BY seed, length(robot), robot"""
    end = len(_FACTS)
    for seed, rows in groupby(connection.execute(query, (cell,)), lambda row: row[0]):
        robots = {}
        for row in rows:
            try:
                defined = described(row[end])
            except ValueError as error:
                raise ResultsError(f"{folder / FILE}: damaged metrics ({error})") from error
            measured = dict(zip(names, row[end + 3 :], strict=True))
            robots[row[1]] = _Row(
                dict(zip(_FACTS, row[:end], strict=True)),
                {name: value for name, value in measured.items() if name in defined},
                defined,
                None if row[end + 1] is None else (row[end + 1], row[end + 2]),
            )
        yield seed, robots


def _insert(connection: sqlite3.Connection, cell: int, row: _Row) -> None:
    facts = {**row.facts, "cell": cell, "metric_set": metric_set(connection, row.defined)}
    added = connection.execute(
        f"INSERT INTO episodes ({', '.join(facts)}) VALUES ({_marks(facts)})",
        tuple(facts.values()),
    )
    episode = added.lastrowid
    connection.execute("INSERT INTO metrics (episode) VALUES (?)", (episode,))
    values = {name: math.nan if one is None else one for name, one in row.metrics.items()}
    write_metrics(connection, episode, values)
    if row.actions is not None:
        connection.execute(
            "INSERT INTO actions (episode, commands, inference_s) VALUES (?, ?, ?)",
            (episode, *row.actions),
        )


def _difference(there: _Robots, new: _Robots) -> str:
    """How an episode came out otherwise, in words; empty if it came out the same."""
    if there.keys() != new.keys():
        return f"robots: {', '.join(there)} before, {', '.join(new)}"
    for robot, row in new.items():
        before = there[robot]
        endings = [f"{one.facts['outcome']} at step {one.facts['steps']}" for one in (before, row)]
        if endings[0] != endings[1]:
            return f"{robot}: {endings[0]} before, {endings[1]}"
        for name, value in row.metrics.items():
            if name == _TIMED or before.defined.get(name) != row.defined[name]:
                continue
            if not _same(before.metrics[name], value):
                return f"{robot}: {name} {before.metrics[name]!r} before, {value!r}"
    return ""


def _same(one: float | None, other: float | None) -> bool:
    if one is None or other is None:
        return one is other
    return math.isclose(one, other, rel_tol=SAME_WITHIN)


def _same_run(there: _Robots, new: _Robots) -> bool:
    return all(
        dict(row.facts) == dict(there[robot].facts) and row.actions == there[robot].actions
        for robot, row in new.items()
    )


def _missing(connection: sqlite3.Connection, cells: Set[int]) -> list[str]:
    query = "SELECT DISTINCT seed FROM episodes WHERE cell = ? ORDER BY seed"
    lines = []
    for number, scenario, agent in latest_cells(connection):
        if number in cells:
            seeds = [seed for (seed,) in connection.execute(query, (number,))]
            gaps = [(a + 1, b - 1) for a, b in pairwise(seeds) if b - a > 1]
            if gaps:
                missing = sum(last - first + 1 for first, last in gaps)
                told = f"{missing} of {missing + len(seeds)} seeds are missing: {_ranges(gaps)}"
                lines.append(f"{agent} in {scenario}: {told}")
    return lines


def _ranges(gaps: Sequence[tuple[int, int]]) -> str:
    """First and last numbers as text: ``1, 3-5, 9``."""
    parts = [str(first) if first == last else f"{first}-{last}" for first, last in gaps]
    more = len(parts) - _RANGES
    return ", ".join(parts[:_RANGES]) + (f" and {more} more" if more > 0 else "")


def _marks(columns: Sequence[str] | Mapping[str, Any]) -> str:
    return ", ".join("?" * len(columns))
