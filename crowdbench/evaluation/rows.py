"""Stored episodes as a table, read column by column and checked."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from crowdbench.evaluation.database import ResultsError
from crowdbench.evaluation.measured import OUTCOMES, is_proportion, quoted
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.results import Cell, Origin

_CELL = tuple(field.name for field in fields(Cell))
_FIRST = (*_CELL, "seed", "robot", "outcome")
_LAST = ("steps", "error", "diagnostics", *(field.name for field in fields(Origin)))
_INTEGERS = ("seed", "steps")
_TEXTS = ("version", "robot", "outcome", "error", "diagnostics", *_LAST[3:])
_CHUNK = 4096


def empty_frame() -> pd.DataFrame:
    """No rows, with the columns that a file of this version has."""
    kinds = dict.fromkeys((*_FIRST, *_LAST), "str") | dict.fromkeys(_INTEGERS, "int64")
    kinds |= dict.fromkeys(METRICS, "float64")
    names = (*_FIRST, *METRICS, *_LAST)
    return pd.DataFrame({name: pd.Series(dtype=kinds[name]) for name in names})


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
    columns = [f"episodes.{name}" for name in ("cell", *_INTEGERS, *_TEXTS)]
    columns += [f"metrics.{quoted(name)}" for name in metrics]
    query = f"""
        SELECT {", ".join(columns)} FROM episodes JOIN metrics ON metrics.episode = episodes.id
        WHERE episodes.cell IN ({", ".join(map(str, cells))})"""
    integers: list[NDArray[np.int64]] = []
    texts: list[list[str]] = [[] for _ in _TEXTS]
    numbers: list[NDArray[np.float64]] = []
    shared: dict[str, str] = {}
    try:
        for chunk in _chunks(connection.execute(query)):
            integers.append(np.array(chunk[:3], dtype=np.int64))
            for column, values in zip(texts, chunk[3 : 3 + len(_TEXTS)], strict=True):
                column.extend(shared.setdefault(str(value), str(value)) for value in values)
            numbers.append(np.array(chunk[3 + len(_TEXTS) :], dtype=float))
    except (ValueError, TypeError) as error:
        raise ResultsError(f"{path}: a row holds something else than numbers ({error})") from error
    if not integers:
        return empty_frame()
    cell, *whole = np.concatenate(integers, axis=1)
    table = {**_cell_columns(connection, cell), **dict(zip(_INTEGERS, whole, strict=True))}
    table |= dict(zip(_TEXTS, texts, strict=True))
    table |= dict(zip(metrics, np.concatenate(numbers, axis=1), strict=True))
    frame = pd.DataFrame({name: table[name] for name in (*_FIRST, *metrics, *_LAST)})
    _check(frame, metrics, path)
    return frame.sort_values(["scenario", "agent", "seed", "robot"], ignore_index=True)


def _chunks(cursor: sqlite3.Cursor) -> Iterator[list[tuple[object, ...]]]:
    """A number of rows at a time, as columns."""
    while rows := cursor.fetchmany(_CHUNK):
        yield list(zip(*rows, strict=True))


def _cell_columns(
    connection: sqlite3.Connection, cell: NDArray[np.int64]
) -> dict[str, NDArray[np.object_]]:
    """What all rows of a cell share, for every row."""
    names = [name for name in _CELL if name != "version"]
    known = {
        row[0]: row[1:] for row in connection.execute(f"SELECT id, {', '.join(names)} FROM cells")
    }
    present, index = np.unique(cell, return_inverse=True)
    return {
        name: np.array([known[number][i] for number in present], dtype=object)[index]
        for i, name in enumerate(names)
    }


def _check(frame: pd.DataFrame, metrics: Sequence[str], path: Path) -> None:
    wrong: dict[str, tuple[NDArray[np.bool_], str]] = {
        "outcome": (~frame["outcome"].isin(OUTCOMES).to_numpy(), ", ".join(OUTCOMES)),
        "steps": (frame["steps"].to_numpy() < 0, "0 or more"),
        "seed": (frame["seed"].to_numpy() < 0, "0 or more"),
    }
    for name in metrics:
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
