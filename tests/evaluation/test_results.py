from __future__ import annotations

import json
import math
import os
import random
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench import load_scenario
from crowdbench.evaluation.appending import require_writable
from crowdbench.evaluation.metrics import METRICS, metrics
from crowdbench.evaluation.results import (
    Cell,
    ResultsError,
    ResultsStore,
    load_results,
    make_row,
    metric_columns,
    scenario_label,
    slug,
)

CELL = Cell(
    scenario="by_hand",
    scenario_digest="0123456789ab",
    agent="planner:gain=2",
    options='{"gain": 2}',
    version="0.1.0",
    weights_sha256="",
    code="a file",
)


def row(seed, cell=CELL, robot="robot_0", **values):
    """A row as short as a row can be."""
    facts = {"seed": str(seed), "robot": robot, "outcome": "success", "success": "1.0"}
    rest = {"steps": "3", "error": "", "diagnostics": "{}", "machine": "m", "timestamp": "t"}
    return {**vars(cell), **facts, **rest, **values}


@pytest.fixture
def store(tmp_path):
    return ResultsStore(tmp_path)


@pytest.fixture
def file(store):
    return store.path(CELL)


def test_a_row_says_everything_about_its_episode(store, make_episode):
    episode = make_episode(
        [[0, 0, 0], [0.1, 0, 0]], seed=7, error="it\nbroke\x1b[31m", diagnostics={"fails": 2.0}
    )
    store.append(CELL, [make_row(CELL, episode, metrics(episode), "a machine, 2 cores")])
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


@given(st.dictionaries(st.sampled_from(list(METRICS)), st.floats(), min_size=3))
def test_floats_come_back_exactly(tmp_path_factory, make_episode, values):
    store = ResultsStore(tmp_path_factory.mktemp("results"))
    store.append(CELL, [make_row(CELL, make_episode([[0, 0, 0]]), values, "m")])
    (stored,) = store.rows(CELL).to_dict("records")
    for name, value in values.items():
        same = math.isnan(stored[name]) if math.isnan(value) else stored[name] == value
        assert same, (name, value)


def test_the_same_episode_is_stored_once(store, file):
    assert store.append(CELL, [row(0)]) == 1
    assert store.append(CELL, [row(0, outcome="collision")]) == 0
    assert ResultsStore(store.folder).append(CELL, [row(0), row(1)]) == 1
    assert list(store.rows(CELL)["seed"]) == [0, 1]
    assert file.read_text().count("scenario,") == 1


def test_two_stores_see_each_others_rows(store):
    other = ResultsStore(store.folder)
    for seed in range(6):
        (store if seed % 2 else other).append(CELL, [row(seed)])
    assert store.stored(CELL) == other.stored(CELL) == {seed: {"robot_0"} for seed in range(6)}


def test_robots_of_one_episode_are_told_apart(store):
    store.append(CELL, [row(0), row(0, robot="robot_1")])
    assert store.stored(CELL) == {0: {"robot_0", "robot_1"}}


@pytest.mark.parametrize(
    "change",
    [
        {"scenario_digest": "ba9876543210"},
        {"weights_sha256": "f" * 64},
        {"code": "another file"},
        {"version": "0.2.0"},
    ],
)
def test_what_is_measured_with_something_else_is_another_measurement(store, change):
    other = replace(CELL, **change)
    store.append(CELL, [row(0), row(1)])
    assert store.stored(other) == {}
    store.append(other, [row(0, other)])
    assert list(load_results(store.folder)["seed"]) == [0], "the rows before are superseded"
    assert list(store.rows(CELL)["seed"]) == [0, 1], "but still there"


def test_a_patch_release_goes_on_with_the_rows_of_the_one_before(store):
    store.append(CELL, [row(0)])
    assert store.stored(replace(CELL, version="0.1.7")) == {0: {"robot_0"}}


def test_rows_are_found_by_scenario_and_agent(store):
    other = replace(CELL, agent="other")
    store.append(CELL, [row(0)])
    store.append(other, [row(5, other)])
    assert list(load_results(store.folder, agent="other")["seed"]) == [5]
    assert list(load_results(store.folder, scenario="by_hand")["seed"]) == [5, 0]
    empty = load_results(store.folder, scenario="elsewhere")
    assert empty.empty
    assert {"scenario", "agent", "seed"} <= set(empty.columns)


def test_a_row_cut_off_anywhere_is_dropped_and_nothing_else(store, file):
    for seed in range(3):
        store.append(CELL, [row(seed)])
    whole = file.read_bytes()
    for cut in range(0, len(whole), 5):
        file.write_bytes(whole[:cut])
        complete = max(0, whole[:cut].count(b"\n") - 1)
        assert len(load_results(store.folder)) == complete, "readers skip it"
        fresh = ResultsStore(store.folder)
        assert set(fresh.stored(CELL)) == set(range(complete))
        for seed in range(3):
            fresh.append(CELL, [row(seed)])
        assert file.read_bytes() == whole


def test_a_writer_that_stays_open_repairs_what_another_has_torn(store, file):
    store.append(CELL, [row(0)])
    with file.open("ab") as torn:
        torn.write(b"by_hand,0123")
    store.append(CELL, [row(1)])
    assert list(store.rows(CELL)["seed"]) == [0, 1]


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("a,b", "expected 16 fields, got 2"),
        ("", "expected 16 fields, got 0"),
        (",".join(row("x").values()), "invalid literal for int"),
        (",".join(row(1, success="many").values()), "could not convert string to float"),
        ('"' + ",".join(row(1, options="").values()), "unexpected end of data"),
        ("\ud800".encode("utf-8", "surrogatepass"), "can't decode"),
    ],
)
def test_a_row_that_is_none_is_reported_with_file_and_line(store, file, line, told):
    store.append(CELL, [row(0, options="{}")])
    with file.open("ab") as written:
        written.write((line if isinstance(line, bytes) else line.encode()) + b"\n")
    with pytest.raises(ResultsError) as caught:
        load_results(store.folder)
    assert str(caught.value).startswith(f"{file}, line 3: not a row of results (")
    assert told in str(caught.value)
    with pytest.raises(ResultsError, match="line 3"):
        store.append(CELL, [row(5)])


WRITER = """
import json, resource, sys
from pathlib import Path
from crowdbench.evaluation.results import Cell, ResultsStore
folder, first, last, room, cell = sys.argv[1:]
store, cell = ResultsStore(Path(folder)), Cell(**json.loads(cell))
if int(room):
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(room), int(room)))
print("ready", flush=True)
sys.stdin.readline()
for seed in range(int(first), int(last)):
    facts = {"seed": str(seed), "robot": "robot_0", "outcome": "success", "success": "1.0"}
    rest = {"steps": "3", "error": "e" * 900, "diagnostics": "{}", "machine": "m", "timestamp": "t"}
    store.append(cell, [{**vars(cell), **facts, **rest}])
"""


def writer(folder, first, last, room=0):
    """A process that waits for a line and then stores episodes, in files of ``room`` bytes."""
    numbers = map(str, (first, last, room))
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


def test_a_writer_killed_at_random_moments_loses_and_doubles_nothing(tmp_path):
    rng, seeds, kept = random.Random(0), 3000, 0
    for _ in range(4):
        process = writer(tmp_path, 0, seeds)
        begin(process)
        time.sleep(rng.uniform(0.005, 0.05))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        stored = load_results(tmp_path)
        assert list(stored["seed"]) == list(range(len(stored))), "a gap or a row twice"
        assert len(stored) >= kept
        kept = len(stored)
    assert 0 < kept < seeds, "the kills came too early or too late to say anything"
    process = writer(tmp_path, 0, kept + 50)
    process.communicate("\n")
    assert list(load_results(tmp_path)["seed"]) == list(range(kept + 50))


def test_two_processes_may_write_the_same_results_at_once(tmp_path):
    both = [writer(tmp_path, 0, 300), writer(tmp_path, 100, 400)]
    for process in both:
        begin(process)
    for process in both:
        assert process.communicate()[1] == ""
    assert sorted(load_results(tmp_path)["seed"]) == list(range(400))
    (path,) = tmp_path.glob("episodes/*/*.csv")
    assert path.read_text().count("scenario,scenario_digest") == 1


def test_a_full_disk_leaves_no_half_row_and_is_named(store, file):
    store.append(CELL, [row(0)])
    before = file.read_bytes()
    process = writer(store.folder, 1, 2, room=len(before) + 20)
    _, errors = process.communicate("\n")
    assert f"ResultsError: {file}: cannot be written (File too large)" in errors
    assert file.read_bytes() == before
    store.append(CELL, [row(1)])
    assert list(store.rows(CELL)["seed"]) == [0, 1]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_no_space_left_is_named(store, file):
    file.parent.mkdir(parents=True)
    file.symlink_to("/dev/full")
    with pytest.raises(ResultsError, match=re.escape(f"{file}: cannot be written (No space left")):
        store.append(CELL, [row(0)])


def test_a_folder_that_cannot_be_written_to_is_found_out_at_once(tmp_path):
    (tmp_path / "file").write_text("in the way")
    for folder in (tmp_path / "file", tmp_path / "file" / "results"):
        with pytest.raises(ResultsError, match=re.escape(str(folder))):
            require_writable(folder)
    require_writable(tmp_path / "new" / "results")
    assert list((tmp_path / "new" / "results").iterdir()) == [], "the probe leaves nothing behind"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_found_out_at_once(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(ResultsError, match="Permission denied"):
        require_writable(tmp_path / "results")


def test_rows_with_other_columns_are_not_mixed_in(store, file):
    store.append(CELL, [row(0)])
    with pytest.raises(ResultsError, match=re.escape(f"{file}: written with other columns (spl)")):
        store.append(CELL, [row(1, spl="0.5")])
    assert list(store.rows(CELL)["seed"]) == [0]


def test_a_file_that_is_no_results_file_is_refused(store, file):
    file.parent.mkdir(parents=True)
    file.write_text("a,b\n1,2\n")
    with pytest.raises(ResultsError, match=r"line 1: .*the header lacks scenario"):
        load_results(store.folder)


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
    assert store.path(cell).parent != store.path(replace(cell, scenario="multimodal_fast")).parent
    for _ in range(2):
        store.describe_scenario(cell, changed)
    text = (store.path(cell).parent / "scenario.json").read_text()
    assert type(plain).model_validate_json(text) == changed
