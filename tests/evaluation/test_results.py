from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from short_episodes import CELL, row

from crowdbench import load_scenario
from crowdbench.evaluation.metrics import METRICS, metrics
from crowdbench.evaluation.results import (
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
