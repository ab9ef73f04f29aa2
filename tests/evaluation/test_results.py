from __future__ import annotations

import contextlib
import json
import math
import random
import re
import signal
import sqlite3
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench import load_scenario
from crowdbench.evaluation.database import FILE
from crowdbench.evaluation.metrics import METRICS, metrics
from crowdbench.evaluation.results import (
    Cell,
    Origin,
    Result,
    ResultsError,
    ResultsStore,
    load_commands,
    load_driven,
    load_results,
    scenario_label,
    slug,
)
from crowdbench.evaluation.rows import metric_columns
from crowdbench.evaluation.stored import defined_scenario, find_scenario
from crowdbench.simulation import WORLD_VERSION

CELL = Cell(
    scenario="by_hand",
    scenario_digest="0123456789ab",
    agent="planner:gain=2",
    options='{"gain": 2}',
    world=WORLD_VERSION,
    weights_sha256="",
    code="a file",
)


def row(seed, robot="robot_0", **values):
    """An episode as short as one can be."""
    facts = {"outcome": "success", "steps": 3, "metrics": {"success": 1.0}}
    return Result(seed, robot, **{**facts, **values})


@pytest.fixture
def store(tmp_path):
    return ResultsStore(tmp_path)


def test_a_row_says_everything_about_its_episode(store, make_episode):
    episode = make_episode(
        [[0, 0, 0], [0.1, 0, 0]], seed=7, error="it\nbroke\x1b[31m", diagnostics={"fails": 2.0}
    )
    origin = Origin.of("a machine, 2 cores").now()
    store.append(CELL, [Result.of(episode, metrics(episode), origin)])
    (stored,) = store.rows(CELL).to_dict("records")
    assert stored["scenario"] == "by_hand"
    assert stored["agent"] == "planner:gain=2"
    assert (stored["seed"], stored["robot"], stored["steps"]) == (7, "robot_0", 1)
    assert stored["outcome"] == "timeout"
    assert stored["error"] == "it broke [31m"
    assert stored["diagnostics"] == '{"fails": 2.0}'
    assert stored["machine"] == "a machine, 2 cores"
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", stored["timestamp"])
    assert metric_columns(stored) == list(METRICS)


def values_of(name):
    """Any number, but for what is a yes or a no."""
    answers = st.sampled_from([0.0, 1.0, math.nan])
    return answers if METRICS[name].kind == "proportion" else st.floats()


@settings(deadline=None)
@given(
    st.lists(st.sampled_from(list(METRICS)), min_size=3, unique=True).flatmap(
        lambda names: st.fixed_dictionaries({name: values_of(name) for name in names})
    )
)
def test_floats_come_back_exactly(tmp_path_factory, make_episode, values):
    store = ResultsStore(tmp_path_factory.mktemp("results"))
    store.append(CELL, [Result.of(make_episode([[0, 0, 0]]), values, Origin())])
    (stored,) = store.rows(CELL).to_dict("records")
    for name, value in values.items():
        same = math.isnan(stored[name]) if math.isnan(value) else stored[name] == value
        assert same, (name, value)


def test_what_the_robots_did_comes_back_exactly(store):
    rng = np.random.default_rng(0)
    commands = [rng.normal(size=(steps, 2)) for steps in (5, 0)]
    times = [rng.uniform(size=steps) for steps in (5, 0)]
    results = [
        row(3, robot, commands=asked, inference_s=taken, steps=len(asked), error=error)
        for robot, asked, taken, error in zip(
            ("robot_10", "robot_2"), commands, times, ("", "broke"), strict=True
        )
    ]
    store.append(CELL, results)
    later, first = load_commands(store.folder, CELL, 3)[::-1]
    np.testing.assert_array_equal(later, commands[0])
    assert first.shape == (0, 2)
    two, ten = load_driven(store.folder, CELL, 3)
    assert (two.robot, ten.robot) == ("robot_2", "robot_10"), "in the order of the robots"
    assert (two.error, ten.error) == ("broke", None)
    np.testing.assert_array_equal(ten.inference_s, times[0].astype(np.float32))


def test_an_episode_without_commands_has_none(store):
    store.append(CELL, [row(0)])
    assert load_commands(store.folder, CELL, 0) is None
    assert load_commands(store.folder, CELL, 1) is None
    assert load_commands(store.folder / "nowhere", CELL, 0) is None


def test_commands_that_were_damaged_are_refused_by_name(store):
    store.append(CELL, [row(4, commands=np.ones((3, 2)), inference_s=np.ones(3))])
    for change in ("commands = x'00'", "inference_s = x'0000'", "commands = x''"):
        alter(store, f"UPDATE actions SET {change}")
        with pytest.raises(ResultsError, match=r"planner:gain=2 in by_hand, seed 4: damaged comm"):
            load_commands(store.folder, CELL, 4)


def test_the_same_episode_is_stored_once(store):
    assert store.append(CELL, [row(0)]) == 1
    assert store.append(CELL, [row(0, outcome="collision")]) == 0
    assert ResultsStore(store.folder).append(CELL, [row(0), row(1)]) == 1
    assert list(store.rows(CELL)["seed"]) == [0, 1]
    assert set(store.rows(CELL)["outcome"]) == {"success"}


def test_two_stores_see_each_others_rows(store):
    other = ResultsStore(store.folder)
    for seed in range(6):
        (store if seed % 2 else other).append(CELL, [row(seed)])
    assert store.stored(CELL) == other.stored(CELL) == {seed: {"robot_0"} for seed in range(6)}


def test_robots_of_one_episode_are_told_apart(store):
    store.append(CELL, [row(0), row(0, robot="robot_1")])
    assert store.stored(CELL) == {0: {"robot_0", "robot_1"}}


def test_an_episode_is_stored_whole_or_not_at_all(store):
    store.append(CELL, [row(0)])
    with pytest.raises(ResultsError):
        store.append(CELL, [row(1), row(1, robot="robot_1", outcome="draw")])
    assert store.stored(CELL) == {0: {"robot_0"}}
    assert store.append(CELL, [row(1)]) == 1, "the store goes on"


@pytest.mark.parametrize(
    "change",
    [
        {"scenario_digest": "ba9876543210"},
        {"weights_sha256": "f" * 64},
        {"code": "another file"},
    ],
)
def test_what_is_measured_with_something_else_is_another_measurement(store, change):
    other = replace(CELL, **change)
    store.append(CELL, [row(0), row(1)])
    assert store.stored(other) == {}
    store.append(other, [row(0)])
    assert list(load_results(store.folder)["seed"]) == [0], "the rows before are superseded"
    assert list(store.rows(CELL)["seed"]) == [0, 1], "but still there"


def test_what_is_imported_later_does_not_supersede_what_was_measured_later(store):
    times = {"new": "2026-02-01T00:00:00+00:00", "old": "2026-01-01T00:00:00+00:00"}
    for code, timestamp in times.items():
        cell = replace(CELL, code=code)
        store.append(cell, [row(0, origin=Origin(timestamp=timestamp))])
    assert list(load_results(store.folder)["code"]) == ["new"]


def test_rows_of_another_world_stay_and_are_left_out_with_a_warning(store):
    store.append(CELL, [row(0)])
    other = replace(CELL, world="0.0")
    assert store.stored(other) == {}
    late = Origin(timestamp="2027-01-01T00:00:00+00:00")
    store.append(other, [row(1, origin=late), row(2, origin=late)])
    with pytest.warns(
        UserWarning, match=r"2 rows are of world '0.0' and left out; this crowdbench"
    ):
        found = load_results(store.folder)
    assert (list(found["seed"]), set(found["world"])) == ([0], {WORLD_VERSION})
    assert list(store.rows(other)["seed"]) == [1, 2]


def test_every_release_goes_on_with_the_rows_of_the_one_before(store):
    for seed, version in enumerate(("0.1.0", "0.2.0", "1.0.0")):
        assert len(store.stored(CELL)) == seed
        store.append(CELL, [row(seed, origin=Origin(version=version))])
    found = load_results(store.folder)
    assert list(found["version"]) == ["0.1.0", "0.2.0", "1.0.0"], "each names its own"


def test_two_versions_with_other_metrics_write_to_one_file(store):
    other = ResultsStore(store.folder)
    store.append(CELL, [row(0)])
    other.append(CELL, [row(1, metrics={"success": 0.0, 'by "me"': 2.5})])
    store.append(CELL, [row(2)])
    rows = store.rows(CELL)
    assert list(rows["success"]) == [1, 0, 1]
    assert rows['by "me"'].isna().tolist() == [True, False, True]
    assert rows['by "me"'][1] == 2.5


def test_rows_are_found_by_scenario_and_agent(store):
    other = replace(CELL, agent="other")
    store.append(CELL, [row(0)])
    store.append(other, [row(5)])
    assert list(load_results(store.folder, agent="other")["seed"]) == [5]
    assert list(load_results(store.folder, scenario="by_hand")["seed"]) == [5, 0]
    empty = load_results(store.folder, scenario="elsewhere")
    assert empty.empty
    assert {"scenario", "agent", "seed"} <= set(empty.columns)


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


WRITER = """
import json, sys
from pathlib import Path
import numpy as np
from crowdbench.evaluation import metrics
from crowdbench.evaluation.results import Cell, Result, ResultsStore
folder, first, last, cell = sys.argv[1:]
store, cell = ResultsStore(Path(folder)), Cell(**json.loads(cell))
commands, times = np.ones((60, 2)), np.ones(60)
print("ready", flush=True)
sys.stdin.readline()
for seed in range(int(first), int(last)):
    facts = {"outcome": "success", "steps": 60, "metrics": {"success": 1.0}, "error": "e" * 900}
    store.append(cell, [
        Result(seed, robot, commands=commands, inference_s=times, **facts)
        for robot in ("robot_0", "robot_1")
    ])
"""


def writer(folder, first, last):
    """A process that waits for a line and then stores episodes of two robots."""
    numbers = map(str, (first, last))
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(folder), *numbers, json.dumps(vars(CELL))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "ready\n"
    return process


def begin(process):
    process.stdin.write("\n")
    process.stdin.flush()


def assert_whole(folder, seeds):
    """Exactly these episodes, each with both robots and their commands, in a sound file."""
    stored = load_results(folder)
    assert list(stored["seed"]) == [seed for seed in seeds for _ in range(2)]
    with contextlib.closing(sqlite3.connect(folder / FILE)) as database:
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        for table in ("metrics", "actions"):
            found = database.execute(f"SELECT count(*) FROM {table}").fetchone()
            assert found == (len(stored),)


def test_a_writer_killed_at_random_moments_loses_and_doubles_nothing(tmp_path):
    rng, seeds, kept = random.Random(0), 30000, 0
    for _ in range(4):
        process = writer(tmp_path, 0, seeds)
        begin(process)
        deadline = time.monotonic() + 60
        while len(load_results(tmp_path)) // 2 <= kept:
            assert time.monotonic() < deadline, "nothing is stored"
        time.sleep(rng.uniform(0, 0.3))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        count = len(load_results(tmp_path)) // 2
        assert_whole(tmp_path, range(count))
        assert count >= kept
        kept = count
    assert 0 < kept < seeds, "the kills came too late to say anything"
    process = writer(tmp_path, 0, kept + 50)
    process.communicate("\n")
    assert_whole(tmp_path, range(kept + 50))


def test_two_processes_may_write_the_same_results_at_once(tmp_path):
    both = [writer(tmp_path, 0, 300), writer(tmp_path, 100, 400)]
    for process in both:
        begin(process)
    for process in both:
        assert process.communicate()[1] == ""
    assert_whole(tmp_path, range(400))


@pytest.mark.parametrize(
    "name",
    [
        "../../etc/passwd",
        "/abs/a.py:Class",
        "..",
        "",
        "a b",
        "é",
        "x" * 300,
        "a\nb",
        "<a>",
        "a:b=2",
    ],
)
def test_any_name_gives_a_file_name_of_its_own(name):
    safe = slug(name)
    assert re.fullmatch(r"[A-Za-z0-9_.,=@+-]{1,100}", safe)
    assert not safe.startswith(".")
    assert safe != slug(name + "!")


@settings(max_examples=300)
@given(st.text(max_size=12), st.text(max_size=12))
def test_different_names_give_different_files(one, other):
    assert (slug(one) == slug(other)) == (one == other)


def test_plain_names_stay_as_they_are():
    assert slug("multimodal_fast") == "multimodal_fast"
    assert slug("straight_line") == "straight_line"


def test_an_overridden_scenario_is_not_mixed_up_with_the_plain_one(store):
    plain = load_scenario("multimodal_fast")
    changed = plain.override({"pedestrians.count": 3})
    assert scenario_label(plain) == "multimodal_fast"
    assert scenario_label(changed) == f"multimodal_fast@{changed.digest}"
    assert scenario_label(plain.override({"name": "mine"})) == f"mine@{plain.digest}"
    cell = replace(CELL, scenario=scenario_label(changed), scenario_digest=changed.digest)
    store.append(cell, [row(0)])
    assert find_scenario(store.folder, cell) is None
    store.append(cell, [row(0)], changed)
    assert find_scenario(store.folder, cell) == changed
    store.append(cell, [row(1)], plain)
    assert find_scenario(store.folder, cell) == changed, "a definition stays"
    named = replace(cell, scenario="multimodal_fast", scenario_digest=plain.digest)
    assert store.stored(named) == {}
    assert (
        find_scenario(store.folder, named)
        == plain
        == defined_scenario("multimodal_fast", plain.digest, definition="")
    )
