"""Metrics of published episodes from their commands, against those of the run."""

from __future__ import annotations

import shutil

import pytest

from crowdbench.cli import main
from crowdbench.evaluation import metrics
from crowdbench.evaluation.joined import cells_of
from crowdbench.evaluation.publish import publish
from crowdbench.evaluation.recompute_record import recompute_record
from crowdbench.evaluation.record import load_commands, load_record, write_cell
from crowdbench.evaluation.results import ResultsError

SCENARIO, AGENT = "unimodal_slow", "straight_line"
SEEDS = (0, 1, 100)
NAME = f"{AGENT} in {SCENARIO}"


@pytest.fixture(scope="module")
def published(tmp_path_factory, make_whole):
    """A record of three episodes, one of them of those whose commands are not installed."""
    folder = tmp_path_factory.mktemp("published")
    whole = make_whole(folder / "results")
    for seed in SEEDS:
        whole.run(SCENARIO, AGENT, seed)
    publish([(SCENARIO, AGENT, 101)], whole.folder, folder / "record")
    return folder / "record"


@pytest.fixture
def record(published, tmp_path):
    return shutil.copytree(published, tmp_path / "record")


def change(record, rows=lambda rows: rows, keep=lambda seed: True):
    """Write the cell again with other rows, or with the commands of some seeds only."""
    old = load_record(folder=record)
    (cell,) = cells_of(old).values()
    commands = load_commands(cell, record)
    kept = [seed for seed in commands.seeds if keep(seed)]
    told = {(seed, name): of for seed in kept for name, of in commands.of(seed).items()}
    write_cell(record, cell, rows(old), told)


def content(record):
    return {path: path.read_bytes() for path in record.rglob("*") if path.is_file()}


@pytest.fixture
def steps_metric(monkeypatch):
    """A metric that the record lacks, not defined for seed 1."""
    new = metrics.Metric(
        lambda episode: float("nan") if episode.seed == 1 else float(episode.steps),
        "steps", "lower", "number of steps", "count",
    )  # fmt: skip
    monkeypatch.setitem(metrics.METRICS._known, "length", new)


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_was_published_comes_out_the_same_and_nothing_is_written(record, jobs):
    before, seen = content(record), []
    found = recompute_record(record, jobs, lambda *progress: seen.append(progress))
    assert (found.episodes, found.filled, found.disagreements) == (len(SEEDS), {}, [])
    assert found.without_commands == []
    assert (seen[0], seen[-1]) == ((0, 3), (3, 3))
    assert content(record) == before


def test_a_metric_that_the_file_lacks_is_filled_in_once(record, steps_metric):
    before = load_record(folder=record)
    commands = {path: data for path, data in content(record).items() if path.suffix == ".npz"}
    assert len(commands) == 2
    found = recompute_record(record)
    assert (found.filled, found.disagreements) == ({"length": len(SEEDS)}, [])
    rows = load_record(folder=record)
    assert rows["length"].isna().tolist() == [False, True, False]
    assert rows["length"].dropna().tolist() == before["steps"][[0, 2]].tolist()
    assert set(before["not_computed"]) == {"length"} and set(rows["not_computed"]) == {""}
    assert rows.drop(columns="length").equals(before.assign(not_computed=""))
    assert commands.items() <= content(record).items(), "what the robots did stays as it was"
    again = content(record)
    assert recompute_record(record).filled == {}, "what is not defined is not missing"
    assert content(record) == again


def test_a_cell_that_comes_out_otherwise_is_named_and_stays_as_it_was(record, steps_metric):
    change(record, lambda rows: rows.assign(path_length=rows["path_length"] * [1, 2, 1]))
    before = content(record)
    found = recompute_record(record)
    (line,) = found.disagreements
    assert line.startswith(f"{NAME}, seed 1, robot_0: path_length is ")
    assert (found.filled, content(record)) == ({}, before)


@pytest.mark.parametrize(("name", "value"), [("min_dist", float("nan")), ("robot_at_fault", 1.0)])
def test_a_value_and_none_are_not_the_same(record, name, value):
    old = load_record(folder=record)[name]
    change(record, lambda rows: rows.assign(**{name: value}))
    lines = recompute_record(record).disagreements
    assert len(lines) == (old.notna() if value != value else old.isna()).sum() > 0


def test_another_outcome_than_published_disagrees(record):
    change(record, lambda rows: rows.assign(outcome="timeout"))
    lines = recompute_record(record).disagreements
    assert len(lines) == len(SEEDS)
    assert all("said to end with timeout" in line for line in lines)


def test_rows_without_commands_are_listed_and_their_cell_gets_no_new_metric(record, steps_metric):
    change(record, keep=lambda seed: seed == 100)
    found = recompute_record(record)
    assert found.without_commands == [f"{NAME}: 2 of 3 rows without commands"]
    assert (found.episodes, found.filled) == (1, {})
    assert "length" not in load_record(folder=record)
    change(record, keep=lambda seed: False)
    found = recompute_record(record)
    assert found.without_commands == [f"{NAME}: 3 of 3 rows without commands"]
    assert found.episodes == 0


def test_rows_of_a_scenario_as_it_was_are_listed(record, monkeypatch):
    monkeypatch.setattr("crowdbench.evaluation.record._digest_today", lambda scenario: "another")
    found = recompute_record(record)
    assert found.without_commands == [
        f"{NAME}: rows of a scenario that is defined otherwise by now"
    ]
    assert found.episodes == 0


def test_times_stay_as_they_were_measured(record):
    change(record, lambda rows: rows.assign(inference_s=99.0))
    assert recompute_record(record).disagreements == []


def test_rows_and_commands_that_do_not_belong_together_end_it_by_name(record, tmp_path):
    longer = shutil.copytree(record, tmp_path / "longer")
    change(longer, lambda rows: rows.assign(steps=rows["steps"] + 1), keep=lambda seed: False)
    shutil.copytree(longer / "rows", record / "rows", dirs_exist_ok=True)
    with pytest.raises(ResultsError, match=rf"{NAME}, seed 0, robot_0: \d+ commands, expected one"):
        recompute_record(record)


def test_damage_ends_it_with_the_file_s_name(record):
    (path,) = (record / "actions").rglob("*.npz")
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(ResultsError, match=r"straight_line\.npz: not commands of the record"):
        recompute_record(record)


def test_the_command_says_what_it_found(record, capsys):
    arguments = ["recompute", "--record", str(record), "--jobs", "1"]
    assert main(arguments) == 0
    told = "3 episodes simulated again; filled in: nothing; everything else came out the same\n"
    assert capsys.readouterr().out == told
    change(record, lambda rows: rows.assign(jerk=1.5))
    before = content(record)
    assert main(arguments) == 1
    captured = capsys.readouterr()
    assert captured.err.count("jerk is") == len(SEEDS)
    assert "3 came out otherwise and stay as they were" in captured.out
    assert content(record) == before


def test_the_command_needs_a_record_that_can_be_kept(record, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for arguments, told in (
        (["--record", "nowhere"], "nowhere: no episodes are published here"),
        (["--record", "/"], "/: no episodes are published here"),
        (["--record", "results/record"], "recompute in a checkout of crowdbench"),
        (["--record", "record", "--results", "mine"], "expected one of them"),
    ):
        assert main(["recompute", *arguments]) == 2
        captured = capsys.readouterr().err
        assert told in captured and captured.count("\n") == 1
    monkeypatch.setattr("crowdbench.evaluation.record.record_folder", lambda: record)
    assert main(["recompute", "--record", str(record)]) == 2
    assert "installed with crowdbench is read-only; recompute in" in capsys.readouterr().err
