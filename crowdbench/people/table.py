"""Tables of numbers as text; a line without them is named."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from crowdbench.messages import brief, short
from crowdbench.people.errors import RecordingError
from crowdbench.people.recording import IntArray

WHOLE = ("id", "frame")
"""Columns that have whole numbers."""


def lines(path: Path) -> Iterator[tuple[int, str]]:
    """Number and text of each line that is neither empty nor a comment."""
    with path.open(encoding="utf-8-sig") as file:
        for number, line in enumerate(file, 1):
            text = line.strip()
            if text and not text.startswith("#"):
                yield number, text


def count_numbers(line: str) -> int:
    """How many numbers are in a line, separated by white space; 0 if anything else is."""
    fields = line.split()
    return len(fields) if all(map(is_number, fields)) else 0


def is_number(field: str) -> bool:
    """Whether text is a number."""
    try:
        float(field)
    except ValueError:
        return False
    return True


def read_numbers(path: Path, places: Mapping[str, int], separator: str | None) -> pd.DataFrame:
    """Some columns of a table, as float64.

    Args:
        path: of the file.
        places: where each of the columns is, from 0.
        separator: None for white space, and no line with names.

    Raises:
        RecordingError: a line lacks a number, or a whole one in a column of ``WHOLE``; the first
            one is named.
    """
    names = sorted(places, key=lambda name: places[name])
    try:
        table: pd.DataFrame = pd.read_csv(
            path,
            sep=separator or r"\s+",
            comment="#",
            header=0 if separator else None,
            names=names,
            usecols=sorted(places.values()),
            index_col=False,
            dtype="float64",
            encoding="utf-8-sig",
        )
    except UnicodeDecodeError:
        raise
    except ValueError as error:
        require_numbers(path, places, separator)
        raise RecordingError(f"{path}: {brief(error)}") from error
    numbers = table[[name for name in names if name in WHOLE]].to_numpy()
    if not np.isfinite(table.to_numpy()).all() or (numbers % 1 != 0).any():
        require_numbers(path, places, separator)
    return table


def require_numbers(path: Path, places: Mapping[str, int], separator: str | None) -> None:
    """Go through a table line by line.

    Args:
        path, places, separator: as of ``read_numbers``.

    Raises:
        RecordingError: a line does not have a finite number in each of the columns, or no whole
            one in those of ``WHOLE``.
    """
    rows = lines(path)
    if separator:
        next(rows)
    for number, line in rows:
        fields = line.split("#")[0].split(separator)
        for name, place in places.items():
            field = fields[place].strip() if place < len(fields) else ""
            known = is_number(field) and math.isfinite(float(field))
            if not known or (name in WHOLE and not float(field).is_integer()):
                kind = "whole" if name in WHOLE else "finite"
                what = f"{short(field)} is no {kind} number" if field else "is missing"
                raise RecordingError(f"{path}: line {number}: {name} {what}, in {short(line)}")


def require_whole_end(path: Path) -> None:
    """Refuse a table, separated by white space, of which the last line has been cut.

    Raises:
        RecordingError: the line has fewer columns than the first.
    """
    first = next(lines(path))[1]
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 4096))
        last = file.read().decode("utf-8", errors="ignore").rstrip().rpartition("\n")[2]
    if not last.startswith("#") and len(last.split()) < len(first.split()):
        raise RecordingError(
            f"{path}: the last line, {short(last.strip())}, has fewer columns than the first: the "
            "file has been cut off"
        )


def whole(path: Path, values: pd.Series, name: str) -> IntArray:
    """A column as whole numbers.

    Raises:
        RecordingError: one of them is not.
    """
    array = values.to_numpy()
    with np.errstate(invalid="ignore"):
        numbers = array.astype(np.int64)
    wrong = numbers != array
    if wrong.any():
        raise RecordingError(
            f"{path}: {name} {array[np.argmax(wrong)]:g} is no whole number below 2^63"
        )
    return numbers
