"""Stored episodes as a table, read column by column and checked.

The column ``not_computed`` tells a metric that is not defined for an episode from one that the
episode was never measured with, since it is older than the metric: both are NaN.
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from crowdbench.evaluation.database import ResultsError
from crowdbench.evaluation.measured import (
    NOT_COMPUTED,
    OUTCOMES,
    described,
    is_proportion,
    lacking,
    quoted,
)
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.results import Cell, Origin
from crowdbench.messages import short

_CELL = tuple(field.name for field in fields(Cell))
_FIRST = (*_CELL, "seed", "robot", "outcome")
_ORIGIN = tuple(field.name for field in fields(Origin))
_LAST = ("steps", "error", "diagnostics", *_ORIGIN, NOT_COMPUTED)
COLUMNS = frozenset((*_FIRST, *_LAST, "source", "episode"))
"""Names that no metric can have: of other columns, of what is joined to them, and of keys."""
_INTEGERS = ("seed", "steps")
_TEXTS = ("robot", "outcome", "error", "diagnostics", *_ORIGIN)
_SHARED = ("scenario", "agent", *(n for n in _CELL if n not in ("scenario", "agent")))
_STORED_AS = {"world": "series"}
_CHUNK = 1024


def empty_frame() -> pd.DataFrame:
    """No rows, with the columns that a file of this version has."""
    kinds = dict.fromkeys((*_FIRST, *_LAST), "str") | dict.fromkeys(_INTEGERS, "int64")
    kinds |= dict.fromkeys(METRICS, "float64")
    names = (*_FIRST, *METRICS, *_LAST)
    return pd.DataFrame({name: pd.Series(dtype=kinds[name]) for name in names})


def not_computed(rows: pd.DataFrame) -> dict[str, int]:
    """For each metric that some rows were never measured with, how many these are."""
    found: Counter[str] = Counter()
    for text, count in rows[NOT_COMPUTED].value_counts().items():
        found.update(dict.fromkeys(str(text).split(), int(count)))
    return {name: found[name] for name in METRICS if name in found}


def metric_columns(columns: Iterable[str]) -> list[str]:
    """Those columns that hold metrics, in the order of the store."""
    return [name for name in columns if name not in (*_FIRST, *_LAST)]


def read_frame(connection: sqlite3.Connection, cells: Sequence[int], path: Path) -> pd.DataFrame:
    """The episodes of some cells, sorted by scenario, agent, seed and robot.

    Raises:
        ResultsError: a row holds what cannot be; the message says which.
    """
    if not cells:
        return empty_frame()
    metrics = [row[1] for row in connection.execute("PRAGMA table_info(metrics)")][1:]
    columns = [f"episodes.{name}" for name in (*_INTEGERS, *_TEXTS)]
    columns += ["metric_set", *(f"metrics.{quoted(name)}" for name in metrics)]
    query = f"""
        SELECT {", ".join(columns)} FROM episodes JOIN metrics ON metrics.episode = episodes.id
        WHERE episodes.cell = ? ORDER BY seed, robot"""
    connection.execute("BEGIN")  # one state of the file, whoever writes meanwhile
    known = _shared_facts(connection, cells, path)
    unmeasured = _unmeasured(connection, path)
    total = _count(connection, cells)
    integers = np.empty((len(_INTEGERS), total), dtype=np.int64)
    numbers = np.empty((len(metrics), total))
    texts: dict[str, list[str]] = {name: [] for name in (*_SHARED, *_TEXTS, NOT_COMPUTED)}
    one: dict[str, str] = {}
    end, first_text, first_number = 0, len(_INTEGERS), len(_INTEGERS) + len(_TEXTS) + 1
    try:
        for number, shared in sorted(known.items(), key=lambda item: item[1]):
            for chunk in _chunks(connection.execute(query, (number,))):
                begin, end = end, end + len(chunk[0])
                integers[:, begin:end] = chunk[:first_text]
                numbers[:, begin:end] = np.array(chunk[first_number:], dtype=float)
                for name, value in zip(_SHARED, shared, strict=True):
                    texts[name].extend([value] * (end - begin))
                texts[NOT_COMPUTED].extend([unmeasured[key] for key in chunk[first_number - 1]])
                for name, values in zip(_TEXTS, chunk[first_text : first_number - 1], strict=True):
                    # The same text is one object in all rows.
                    texts[name].extend([one.setdefault(value, value) for value in values])
    except (ValueError, TypeError, OverflowError) as error:
        raise ResultsError(f"{path}: a row holds something else than numbers ({error})") from error
    connection.execute("COMMIT")
    if not end:
        return empty_frame()
    # As objects, since the same text is one object in all rows: pandas' own has each row's letters.
    table: dict[str, Any] = {name: pd.Series(each, dtype=object) for name, each in texts.items()}
    table |= zip(_INTEGERS, integers[:, :end], strict=True)
    table |= zip(metrics, numbers[:, :end], strict=True)
    # Columns as they were read, without another copy of all numbers.
    frame = pd.DataFrame({name: table[name] for name in (*_FIRST, *metrics, *_LAST)}, copy=False)
    check_rows(frame, path)
    return frame


def _chunks(cursor: sqlite3.Cursor) -> Iterator[list[tuple[Any, ...]]]:
    """A number of rows at a time, as columns."""
    while rows := cursor.fetchmany(_CHUNK):
        yield list(zip(*rows, strict=True))


def _shared_facts(
    connection: sqlite3.Connection, cells: Sequence[int], path: Path
) -> dict[int, tuple[str, ...]]:
    """What all rows of a cell share, by its number."""
    names = (_STORED_AS.get(name, name) for name in _SHARED)
    query = f"SELECT id, {', '.join(names)} FROM cells WHERE id IN ({_listed(cells)})"
    known = {row[0]: row[1:] for row in connection.execute(query)}
    for facts in known.values():
        for name, value in zip(_SHARED, facts, strict=True):
            if not isinstance(value, str):
                raise ResultsError(f"{path}: damaged ({name} of a cell is {short(value)})")
    return known


def _unmeasured(connection: sqlite3.Connection, path: Path) -> dict[int, str]:
    """What ``NOT_COMPUTED`` says of the rows of each set of metrics, by the set's number."""
    sets = connection.execute("SELECT id, definitions FROM metric_sets")
    try:
        return {number: lacking(described(text)) for number, text in sets}
    except (ValueError, TypeError) as error:
        raise ResultsError(f"{path}: damaged metrics ({error})") from error


def _count(connection: sqlite3.Connection, cells: Sequence[int]) -> int:
    query = f"SELECT count(*) FROM episodes WHERE cell IN ({_listed(cells)})"
    total: int = connection.execute(query).fetchone()[0]
    return total


def _listed(cells: Sequence[int]) -> str:
    return ", ".join(map(str, cells))


def check_rows(frame: pd.DataFrame, path: Path) -> None:
    """Refuse rows that hold what cannot be.

    Raises:
        ResultsError: names the first such row, what it holds and what is allowed.
    """
    wrong: dict[str, tuple[NDArray[np.bool_], str]] = {
        "outcome": (~frame["outcome"].isin(OUTCOMES).to_numpy(), ", ".join(OUTCOMES)),
        "steps": (frame["steps"].to_numpy() < 0, "0 or more"),
        "seed": (frame["seed"].to_numpy() < 0, "0 or more"),
    }
    for name in metric_columns(frame):
        if is_proportion(name):
            values = frame[name].to_numpy()
            wrong[name] = (~np.isin(values, (0, 1)) & ~np.isnan(values), "0, 1 or nothing")
    for name, (rows, allowed) in wrong.items():
        if rows.any():
            row = frame.iloc[int(rows.argmax())]
            raise ResultsError(
                f"{path}: {row['agent']} in {row['scenario']}, seed {row['seed']}, "
                f"{row['robot']}: {name} is {row[name]}, expected {allowed}"
            )
