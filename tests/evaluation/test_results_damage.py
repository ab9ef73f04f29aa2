"""Rows of what cannot be, in a file that somebody else has changed."""

import contextlib
import sqlite3

import numpy as np
import pytest
from short_episodes import CELL, row

from crowdbench.evaluation.results import ResultsError, ResultsStore, load_commands, load_results


@pytest.fixture
def store(tmp_path):
    return ResultsStore(tmp_path)


def alter(store, statement):
    """Change the file as somebody else could, its own checks left out."""
    with contextlib.closing(sqlite3.connect(store.path)) as database, database:
        database.execute("PRAGMA ignore_check_constraints = ON")
        database.execute(statement)


@pytest.mark.parametrize(
    ("statement", "told"),
    [
        (
            "UPDATE metrics SET success = 7 WHERE episode = 2",
            "success is 7.0, expected 0, 1 or nothing",
        ),
        ("UPDATE metrics SET success = -1e-9 WHERE episode = 2", "success is -1e-09"),
        ("UPDATE episodes SET steps = -5 WHERE seed = 1", "steps is -5, expected 0 or more"),
        ("UPDATE episodes SET outcome = 'draw' WHERE seed = 1", "outcome is draw, expected succ"),
    ],
)
def test_a_row_of_what_cannot_be_is_refused_and_never_counted(store, statement, told):
    store.append(CELL, [row(0), row(1)])
    alter(store, statement)
    with pytest.raises(ResultsError) as caught:
        load_results(store.folder)
    where = f"{store.path}: planner:gain=2 in by_hand, seed 1, robot_0: "
    assert str(caught.value).startswith(where + told)


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE metrics SET success = 'many'",
        "UPDATE episodes SET steps = 'some'",
        "UPDATE episodes SET seed = NULL",
    ],
)
def test_the_file_takes_nothing_but_numbers_for_numbers(store, statement):
    store.append(CELL, [row(0)])
    with pytest.raises(sqlite3.IntegrityError):
        alter(store, statement)


LAX = (
    "PRAGMA writable_schema = ON",
    "UPDATE sqlite_schema SET sql = replace(sql, ') STRICT', ')')",
)
"""What a damaged disk needs no permission for: anything in any column."""


@pytest.mark.parametrize(
    ("statement", "told"),
    [
        ("UPDATE cells SET options = x'78'", "damaged (options of a cell is b'x')"),
        ("UPDATE metrics SET success = x'78'", "a row holds something else than numbers ("),
        ("UPDATE episodes SET steps = 'some'", "a row holds something else than numbers ("),
    ],
)
def test_values_of_another_kind_are_damage(store, statement, told):
    store.append(CELL, [row(0)])
    with contextlib.closing(sqlite3.connect(store.path)) as database, database:
        for change in LAX:
            database.execute(change)
    alter(store, statement)
    with pytest.raises(ResultsError) as caught:
        load_results(store.folder)
    assert str(caught.value).startswith(f"{store.path}: {told}")


def test_commands_that_were_damaged_are_refused_by_name(store):
    store.append(CELL, [row(4, commands=np.ones((3, 2)), inference_s=np.ones(3))])
    for change in ("commands = x'00'", "inference_s = x'0000'", "commands = x''"):
        alter(store, f"UPDATE actions SET {change}")
        with pytest.raises(ResultsError, match=r"planner:gain=2 in by_hand, seed 4: damaged comm"):
            load_commands(store.folder, CELL, 4)
