"""Several results folders into one: nothing twice, nothing that disagrees, nothing unsaid."""

from __future__ import annotations

import shutil
import sqlite3

import pytest
from stored_episodes import Episodes

from crowdbench.evaluation.database import FILE, SCHEMA, ResultsError
from crowdbench.evaluation.merge import SAME_WITHIN, merge
from crowdbench.evaluation.results import load_commands, load_results
from crowdbench.evaluation.stored import find_cells, find_scenario

SCENARIO = "unimodal_slow"
LATER = {"timestamp": "2026-01-01T00:00:00+00:00", "machine": "another machine"}


@pytest.fixture
def local(tmp_path):
    """A results folder of a name."""
    return lambda name: Episodes(tmp_path / name)


def add(store, seeds, agent="orca", fixed=None, **values):
    for seed in seeds:
        store.add(agent, SCENARIO, seed, fixed=fixed, **(values or {"spl": [seed / 100]}))


def rows_of(folder):
    """Stored rows, what is not defined as None."""
    rows = load_results(folder)
    return rows.astype(object).where(rows.notna(), None).to_dict("records")


def test_shards_become_what_one_run_stores(tmp_path, make_whole):
    parts = [make_whole(tmp_path / name) for name in "abc"]
    for part, seeds in zip(parts, [(0, 2), (1, 3), (0, 1, 2, 3)], strict=True):
        for seed in seeds:
            part.run(SCENARIO, "straight_line", seed)
    first, second, everything = (part.folder for part in parts)
    merged = merge([first, second], tmp_path / "into")
    assert (merged.added, merged.there, merged.repeated, merged.missing) == (4, 0, 0, [])
    changing = ["timestamp", "inference_s", "diagnostics"]
    one, other = (load_results(f).drop(columns=changing) for f in (tmp_path / "into", everything))
    assert one.equals(other)
    (cell,) = find_cells(tmp_path / "into")
    assert find_scenario(tmp_path / "into", cell).digest == cell.scenario_digest
    for seed in range(4):
        (mine,), (theirs,) = (load_commands(f, cell, seed) for f in (tmp_path / "into", everything))
        assert (mine == theirs).all()


def test_merging_again_adds_nothing(local):
    a, b, into = local("a"), local("b"), local("into")
    add(a, [0, 2])
    add(b, [1])
    merge([a.folder, b.folder, a.folder], into.folder)
    before = rows_of(into.folder)
    merged = merge([b.folder, a.folder], into.folder)
    assert (merged.added, merged.there, merged.repeated) == (0, 3, 0)
    assert rows_of(into.folder) == before
    assert [row["seed"] for row in before] == [0, 1, 2]


def test_of_an_episode_that_was_run_twice_the_first_run_stays(local):
    a, b, into = local("a"), local("b"), local("into")
    add(a, [0], spl=[0.5], inference_s=[0.1])
    add(b, [0], fixed=LATER, spl=[0.5 * (1 + SAME_WITHIN / 2)], inference_s=[0.2])
    merged = merge([a.folder, b.folder], into.folder)
    assert (merged.added, merged.there, merged.repeated) == (1, 0, 1)
    (row,) = rows_of(into.folder)
    assert (row["spl"], row["inference_s"], row["machine"]) == (0.5, 0.1, "a machine")


@pytest.mark.parametrize(
    ("other", "told"),
    [
        ({"spl": [0.5 * (1 + 2 * SAME_WITHIN)]}, r"robot_0: spl 0\.5 before, 0\.50001"),
        ({"spl": [float("nan")]}, r"robot_0: spl 0\.5 before, None"),
        (
            {"spl": [0.5], "fixed": {"outcome": "timeout", "steps": 50}},
            "robot_0: success at step 40 before, timeout at step 50",
        ),
        ({"spl": [0.5], "robot": "robot_1"}, "robots: robot_0 before, robot_1"),
    ],
)
def test_where_an_episode_came_out_otherwise_nothing_is_merged(local, other, told):
    a, b, into = local("a"), local("b"), local("into")
    add(into, [0, 1], spl=[0.5])
    add(a, [7])
    b.add("orca", SCENARIO, 1, **other)
    before = rows_of(into.folder)
    with pytest.raises(
        ResultsError, match=f"nothing is merged.*orca in .*, seed 1, {told}.* in .*b"
    ):
        merge([a.folder, b.folder], into.folder)
    assert rows_of(into.folder) == before


def test_a_new_folder_that_nothing_is_merged_into_stays_empty(local):
    a, b, into = local("a"), local("b"), local("into")
    add(a, [0], spl=[0.5])
    add(b, [0], spl=[0.6])
    with pytest.raises(ResultsError, match="nothing is merged"):
        merge([a.folder, b.folder], into.folder)
    assert list(into.folder.iterdir()) == []
    merge([a.folder], into.folder)
    assert [path.name for path in into.folder.iterdir()] == [FILE]
    assert rows_of(into.folder) == rows_of(a.folder)


def test_a_metric_of_another_definition_or_never_measured_is_not_compared(local):
    a, b, into = local("a"), local("b"), local("into")
    add(a, [0, 1], spl=[0.5], jerk=[1.0])
    b.add("orca", SCENARIO, 0, spl=[0.5], older=["jerk"])
    b.add("orca", SCENARIO, 1, spl=[0.6], jerk=[1.0])
    with sqlite3.connect(b.folder / FILE) as connection:
        changed = 'replace(definitions, \'"spl": "\', \'"spl": "formerly \')'
        connection.execute(f"UPDATE metric_sets SET definitions = {changed}")
    connection.close()
    merged = merge([b.folder, a.folder], into.folder)
    assert merged.there == 2
    assert [row["not_computed"] for row in rows_of(into.folder)] == ["jerk", ""]


@pytest.mark.parametrize(
    ("fixed", "told"),
    [
        ({"weights_sha256": "abc"}, "have other weights ('', 'abc')"),
        ({"code": "123"}, "have other code ('crowdbench-nav 0.1.0', '123')"),
        ({"scenario_digest": "0" * 12}, "have other definitions of the scenario"),
    ],
)
@pytest.mark.parametrize("target", ["new", "old"])
def test_other_measurements_of_the_same_cell_are_refused(local, fixed, told, target):
    a, b, into = local("a"), local("b"), local("into")
    add(a if target == "new" else into, [0])
    add(b, [1], fixed={**LATER, **fixed})
    if target == "old":
        add(a, [5], agent="informed")
    with pytest.raises(ResultsError) as caught:
        merge([a.folder, b.folder], into.folder)
    assert told in str(caught.value)
    assert str(caught.value).startswith(f"orca in {SCENARIO}: ")


def test_rows_of_another_world_are_refused(local, tmp_path):
    a = local("a")
    add(a, [0], fixed={"world": "of tomorrow"})
    with pytest.raises(
        ResultsError, match="rows of world 'of tomorrow'; this crowdbench simulates"
    ):
        merge([a.folder], tmp_path / "into")


def test_seeds_between_the_first_and_the_last_that_are_missing_are_listed(local, tmp_path):
    a = local("a")
    add(a, [10, 11, 14, 16, 17, 18])
    add(a, range(3), agent="informed")
    merged = merge([a.folder], tmp_path / "into")
    (line,) = merged.missing
    assert line == f"orca in {SCENARIO}: 3 of 9 seeds are missing: 12-13, 15"


def test_seeds_may_be_far_apart(local, tmp_path):
    a = local("a")
    add(a, [0, 2**62])
    (line,) = merge([a.folder], tmp_path / "into").missing
    assert line.endswith(f"{2**62 - 1} of {2**62 + 1} seeds are missing: 1-{2**62 - 1}")


def test_a_long_list_of_missing_seeds_is_cut_short(local, tmp_path):
    a = local("a")
    add(a, range(0, 60, 2))
    (line,) = merge([a.folder], tmp_path / "into").missing
    assert line.endswith(", 37, 39 and 9 more")


def test_what_is_no_results_folder_is_refused_before_anything_is_written(local, tmp_path):
    a = local("a")
    add(a, [0])
    (tmp_path / "file.txt").write_text("no results")
    newer = tmp_path / "newer"
    shutil.copytree(a.folder, newer)
    with sqlite3.connect(newer / FILE) as connection:
        connection.execute(f"PRAGMA user_version = {SCHEMA + 1}")
    connection.close()
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd" / FILE).write_text("not a database" * 100)
    into = tmp_path / "into"
    for source, told in [
        (tmp_path / "nowhere", "nowhere: no results here"),
        (tmp_path / "file.txt", "file.txt: no results here"),
        (a.folder / FILE, "merge takes results folders"),
        (newer, "written by a newer crowdbench"),
        (tmp_path / "odd", "not a database"),
    ]:
        with pytest.raises(ResultsError, match=told):
            merge([a.folder, source], into)
    assert not into.exists()
    with pytest.raises(ResultsError, match="cannot be merged into itself"):
        merge([a.folder], tmp_path / "." / "a")


@pytest.mark.parametrize(
    ("damaged", "text"), [("a", "{"), ("a", "[]"), ("into", '"spl"'), ("into", '{"spl": 3}')]
)
def test_metrics_that_say_something_else_than_definitions_are_refused(local, damaged, text):
    a, into = local("a"), local("into")
    add(a, [0])
    add(into, [1])
    with sqlite3.connect(local(damaged).folder / FILE) as connection:
        connection.execute("UPDATE metric_sets SET definitions = ?", (text,))
    connection.close()
    with pytest.raises(ResultsError, match=rf"/{damaged}/{FILE}: damaged metrics \("):
        merge([a.folder], into.folder)


def test_rows_that_hold_what_cannot_be_are_refused(local, tmp_path):
    a = local("a")
    add(a, [0], success=[7.0])
    with pytest.raises(ResultsError, match="success is 7"):
        merge([a.folder], tmp_path / "into")
