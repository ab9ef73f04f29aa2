"""Metrics from stored commands: against those of the run, with somebody else's changes between."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import sqlite3

import pytest
from crossings import crossing, walking

from crowdbench import AgentSpec, load_scenario
from crowdbench.cli import main
from crowdbench.evaluation import metrics
from crowdbench.evaluation.database import FILE, ResultsError
from crowdbench.evaluation.recompute import recompute
from crowdbench.evaluation.results import load_results
from crowdbench.evaluation.runner import Task, run
from crowdbench.evaluation.stored import find_cells, find_scenario
from crowdbench.simulation import WORLD_VERSION

WORLD = load_scenario(
    "multimodal_fast",
    name="tiny",
    time_limit=2,
    arena={"length": 6, "width": 6},
    robots={"travel": 4, "count": 2},
    pedestrians={"count": 2, "leg": 2},
)
SEEDS = range(4)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The bytes of a database with four episodes of two robots."""
    folder = tmp_path_factory.mktemp("measured")
    run([Task(WORLD, AgentSpec.parse("straight_line"), SEEDS)], folder, jobs=1)
    return (folder / FILE).read_bytes()


@pytest.fixture
def folder(measured, tmp_path):
    (tmp_path / FILE).write_bytes(measured)
    return tmp_path


def alter(folder, *statements):
    with contextlib.closing(sqlite3.connect(folder / FILE)) as database, database:
        for statement in statements:
            database.execute(statement)


def answers(folder, query):
    with contextlib.closing(sqlite3.connect(folder / FILE)) as database:
        return database.execute(query).fetchall()


def same_rows(one, other):
    assert one.equals(other)


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_was_measured_comes_out_the_same(folder, jobs):
    before, seen = load_results(folder), []
    found = recompute(folder, jobs, lambda *progress: seen.append(progress))
    assert (found.episodes, found.filled, found.disagreements) == (len(SEEDS), {}, [])
    assert found.without_commands == []
    assert (seen[0], seen[-1]) == ((0, 4), (4, 4))
    same_rows(load_results(folder), before)


def test_a_new_metric_is_filled_in_and_no_agent_is_asked(folder, monkeypatch):
    before = load_results(folder)
    function = lambda episode: float(episode.steps) if episode.robot == "robot_0" else float("nan")  # noqa: E731
    new = metrics.Metric(function, "steps", "lower", "number of steps", "count")
    monkeypatch.setitem(metrics.METRICS._known, "length", new)
    found = recompute(folder)
    assert found.filled == {"length": 2 * len(SEEDS)} and not found.disagreements
    rows = load_results(folder)
    first = rows[rows["robot"] == "robot_0"]
    assert list(first["length"]) == list(first["steps"])
    assert rows[rows["robot"] == "robot_1"]["length"].isna().all()
    same_rows(rows.drop(columns="length"), before)
    assert recompute(folder).filled == {}, "what is not defined is not missing"


def test_a_metric_of_another_definition_is_replaced_and_checked_from_then_on(folder, monkeypatch):
    old = metrics.METRICS["path_length"]
    twice = lambda episode: 2 * old.function(episode)  # noqa: E731
    before = load_results(folder)
    new = dataclasses.replace(old, function=twice, definition="twice the length")
    monkeypatch.setitem(metrics.METRICS._known, "path_length", new)
    assert recompute(folder).filled == {"path_length": 2 * len(SEEDS)}
    assert list(load_results(folder)["path_length"]) == list(2 * before["path_length"])
    monkeypatch.setitem(
        metrics.METRICS._known, "path_length", dataclasses.replace(new, function=old.function)
    )
    found = recompute(folder)
    assert len(found.disagreements) == len(SEEDS)
    assert list(load_results(folder)["path_length"]) == list(2 * before["path_length"])


def test_what_came_out_otherwise_stays_and_is_named(folder, monkeypatch):
    alter(
        folder,
        "UPDATE metrics SET path_length = 1.5 WHERE episode = "
        "(SELECT id FROM episodes WHERE seed = 2 AND robot = 'robot_1')",
    )
    new = metrics.Metric(lambda episode: 1.0, "", "lower", "always one", "mean")
    monkeypatch.setitem(metrics.METRICS._known, "one", new)
    found = recompute(folder)
    (line,) = found.disagreements
    assert line.startswith(f"straight_line in tiny@{WORLD.digest}, seed 2, robot_1: path_length is")
    assert line.endswith("stored as 1.5")
    rows = load_results(folder).set_index(["seed", "robot"])
    assert rows["path_length"][2, "robot_1"] == 1.5
    assert rows["one"].isna().groupby("seed").all().tolist() == [False, False, True, False]


def test_commands_of_another_episode_disagree(folder):
    alter(
        folder,
        "UPDATE actions SET commands = (SELECT commands FROM actions JOIN episodes ON episode = id "
        "WHERE seed = 1 AND robot = 'robot_0'), inference_s = (SELECT inference_s FROM actions "
        "JOIN episodes ON episode = id WHERE seed = 1 AND robot = 'robot_0') "
        "WHERE episode = (SELECT id FROM episodes WHERE seed = 0 AND robot = 'robot_0')",
        "UPDATE episodes SET steps = (SELECT steps FROM episodes WHERE seed = 1 AND "
        "robot = 'robot_0') WHERE seed = 0 AND robot = 'robot_0'",
    )
    before = load_results(folder)
    (line,) = recompute(folder).disagreements
    assert "seed 0" in line
    same_rows(load_results(folder), before)


def test_times_stay_as_they_were_measured(folder):
    alter(folder, "UPDATE metrics SET inference_s = 99")
    assert recompute(folder).disagreements == []
    assert set(load_results(folder)["inference_s"]) == {99.0}


def test_what_cannot_be_simulated_again_is_listed(folder):
    name = f"straight_line in tiny@{WORLD.digest}"
    alter(folder, "DELETE FROM actions WHERE episode IN (SELECT id FROM episodes WHERE seed = 0)")
    found = recompute(folder)
    assert found.without_commands == [f"{name}: 2 of 8 rows without commands"]
    assert found.episodes == len(SEEDS) - 1 and not found.disagreements
    other = load_scenario("multimodal_fast").model_dump_json()
    alter(folder, f"UPDATE cells SET definition = '{other}'")
    found = recompute(folder)
    assert found.without_commands == [
        f"{name}: 8 rows of a scenario that is not known as it was (digest {WORLD.digest})"
    ]
    assert found.episodes == 0


def test_a_recording_that_is_gone_is_named(tmp_path, capsys):
    path = tmp_path / "walk.csv"
    path.write_text(walking())
    run([Task(crossing(path), AgentSpec.parse("straight_line"), [900_000])], tmp_path, jobs=1)
    (cell,) = find_cells(tmp_path)
    path.unlink()
    told = (
        f"scenario '{cell.scenario}' cannot be made again: pedestrians.recording: '{path}': "
        "No such file or directory"
    )
    assert main(["recompute", "--results", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    assert captured.err == f"straight_line in {cell.scenario}: 1 rows: {told}\n"
    assert captured.out == "no episode could be simulated again, so nothing was checked\n"
    with pytest.warns(UserWarning) as warned:
        assert find_scenario(tmp_path, cell) is None
    assert [str(one.message) for one in warned] == [told]


def test_episodes_of_another_world_are_refused_with_the_reason(folder, capsys):
    alter(folder, "UPDATE cells SET series = '0.1'")
    other = f"world '0.1'; this crowdbench simulates world {WORLD_VERSION}, where the same actions"
    found = recompute(folder)
    assert found.episodes == 0 and len(found.without_commands) == 1
    assert other in found.without_commands[0]
    left_out = f"8 rows are of {other.replace(';', ' and left out;')}"
    for arguments in (["replay", f"tiny@{WORLD.digest}:straight_line:0"], ["export"]):
        assert main([*arguments, "--results", str(folder)]) == 2
        assert left_out in " ".join(capsys.readouterr().err.split()), arguments
    with contextlib.closing(sqlite3.connect(folder / FILE)) as database:
        assert database.execute("SELECT count(*) FROM actions").fetchone() == (8,)


class _KillsTheProcess:
    def __reduce__(self):
        return os._exit, (3,)


def test_a_process_that_is_killed_ends_it_with_a_line(folder, monkeypatch, capsys):
    killer = (_KillsTheProcess(), "straight_line", [])
    monkeypatch.setattr("crowdbench.evaluation.remeasure._sent", lambda piece: killer)
    assert main(["recompute", "--results", str(folder), "--jobs", "2"]) == 2
    told = capsys.readouterr().err
    assert told.startswith("a process that simulates was killed") and told.count("\n") == 1


def test_damaged_commands_end_it_with_the_episode_s_name(folder):
    alter(folder, "UPDATE actions SET commands = x'00' WHERE episode = 3")
    with pytest.raises(ResultsError, match=r"straight_line in tiny@\w+, seed \d: damaged commands"):
        recompute(folder)


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE metrics SET spl = x'78' WHERE episode = 3",
        "UPDATE metric_sets SET definitions = '{'",
        "UPDATE metric_sets SET definitions = '[]'",
    ],
)
def test_damaged_metrics_end_it_with_the_episode_s_name(folder, statement):
    alter(
        folder,
        "PRAGMA writable_schema = ON",
        "UPDATE sqlite_schema SET sql = replace(sql, ') STRICT', ')')",
    )
    alter(folder, statement)
    with pytest.raises(ResultsError, match=r"straight_line in tiny@\w+, seed \d: damaged metrics"):
        recompute(folder)


def test_the_command_says_what_it_found(folder, capsys):
    arguments = ["recompute", "--results", str(folder), "--jobs", "1"]
    assert main(arguments) == 0
    told = "4 episodes simulated again; filled in: nothing; everything else came out the same\n"
    assert capsys.readouterr().out == told
    alter(folder, "UPDATE metrics SET jerk = 1.5")
    assert main(arguments) == 1
    captured = capsys.readouterr()
    assert captured.err.count("jerk is") == len(SEEDS)
    assert "4 came out otherwise and stay as they were" in captured.out


def test_a_folder_without_episodes_is_said_to_be_one(tmp_path, capsys):
    assert main(["recompute", "--results", str(tmp_path)]) == 2
    assert "no episodes are stored here" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_recomputing_leaves_the_commands_alone(folder):
    before = answers(folder, "SELECT commands FROM actions")
    recompute(folder)
    assert answers(folder, "SELECT commands FROM actions") == before
