from __future__ import annotations

from collections import Counter

import pytest
from crowdbench_studies.paper import STUDY
from stored_episodes import Episodes

from crowdbench.evaluation.machine import core_count
from crowdbench.evaluation.results import load_results
from crowdbench.registry import UnknownNameError
from crowdbench.study import execution
from crowdbench.study.execution import OVERHEAD, Forecast, Outlook, look, run_missing
from crowdbench.study.model import Cell, Study
from crowdbench.study.sessions import load_sessions

cells = STUDY.cells


def row(agent, steps, inference_s):
    return {"agent": agent, "steps": str(steps), "inference_s": str(inference_s)}


# Forecast


def test_what_is_left_follows_from_earlier_episodes():
    # fast: 50 steps of 1 ms; slow: 100 steps of 200 ms; and 1 ms per step for the simulation
    known = [("fast", 50, 0.001), ("slow", 100, 0.2)]
    forecast = Forecast({"fast": 10, "slow": 3}, known, jobs=2)
    fast, slow = 50 * (0.001 + OVERHEAD), 100 * (0.2 + OVERHEAD)
    assert forecast.seconds_left() == pytest.approx((10 * fast + 3 * slow) / 2)
    assert forecast.unknown == []
    assert forecast.seconds_for([Cell("unimodal_slow", "slow", 4)]) == pytest.approx(4 * slow / 2)


def test_time_outside_the_agents_is_measured_as_the_run_goes_on():
    forecast = Forecast({"slow": 3}, [], jobs=2)
    assert forecast.seconds_left() == 0
    assert forecast.unknown == ["slow"]
    forecast.finished(row("slow", 100, 0.2), seconds=12.0)
    # 2 processes x 12 s less 20 s of planning: 4 s for 100 steps.
    assert forecast.seconds_left() == pytest.approx(2 * (100 * 0.2 + 100 * 0.04) / 2)
    assert forecast.unknown == []


def test_an_episode_without_a_step_costs_nothing_and_breaks_nothing():
    forecast = Forecast({"broken": 2}, [("broken", 0, float("nan"))], jobs=1)
    forecast.finished(row("broken", 0, float("nan")), seconds=1.0)
    assert forecast.seconds_left() == 0


def test_more_episodes_than_expected_are_no_debt():
    forecast = Forecast({"fast": 1}, [], jobs=1)
    for seconds in (1.0, 2.0, 3.0):
        forecast.finished(row("fast", 10, 0.01), seconds)
    assert forecast.seconds_left() == 0


# The plan as tasks


def test_tasks_cover_the_plan_once_and_time_every_agent_first():
    tasks = execution._tasks(cells())
    seeds = Counter(
        (task.scenario.name, str(task.agent), seed) for task in tasks for seed in task.seeds
    )
    assert set(seeds.values()) == {1}
    assert len(seeds) == sum(cell.episodes for cell in cells())
    first = tasks[: len(cells())]
    assert {str(task.agent) for task in first} == {cell.agent for cell in cells()}
    assert all(list(task.seeds) == [0] for task in first)


def test_no_cell_gets_its_second_fifty_episodes_before_all_have_their_first():
    tasks = execution._tasks(cells())
    late = next(i for i, task in enumerate(tasks) if max(task.seeds) >= 50)
    assert sum(len(task.seeds) for task in tasks[:late]) == 50 * len(cells())


def test_agents_that_cannot_be_made_are_named_and_left_out():
    outlook = look([Cell("unimodal_slow", "straight_line", 1), Cell("unimodal_slow", "nobody", 1)])
    assert outlook.weights == {"straight_line": ""}
    assert list(outlook.broken) == ["nobody"]
    assert "unknown agent 'nobody'" in outlook.broken["nobody"]


# Running


def test_what_is_missing_is_run_once(tmp_path):
    """A plan of two cells, one of which is half there; run twice."""
    plan = [
        Cell("unimodal_slow", "straight_line", 2),
        Cell("corridor_sparse", "straight_line", 1),
        Cell("corridor_sparse", "nobody", 1),
    ]
    outlook, told = Outlook({"straight_line": ""}, {"nobody": "unknown"}), []

    def progress(done, total, forecast):
        told.append((done, total))

    first = Study("mine", "Mine", (), more=tuple(plan[:1]))
    run_missing(tmp_path, first, outlook, 1, progress)
    assert told[-1] == (2, 2)
    told.clear()
    whole = Study("mine", "Mine", (), more=tuple(plan))
    with pytest.raises(UnknownNameError, match="unknown executor 'nowhere'"):
        run_missing(tmp_path, whole, outlook, 1, progress, executor="nowhere")
    forecast = run_missing(tmp_path, whole, outlook, None, progress)
    assert forecast.jobs == core_count()
    assert (told[0], told[-1]) == ((2, 3), (3, 3))
    assert forecast.seconds_left() == 0 < forecast.seconds_for(plan)
    rows = load_results(tmp_path)
    assert Counter(rows["scenario"]) == {"unimodal_slow": 2, "corridor_sparse": 1}
    assert sum(session.episodes for session in load_sessions(tmp_path, "mine")) == 3


def test_what_is_published_is_not_run_again(tmp_path):
    """Unless it is of other weights."""
    record = Episodes(tmp_path / "theirs")
    record.add("straight_line", spl=[0.5, 0.5])
    outlook = Outlook({"straight_line": ""}, {})
    study = Study("mine", "Mine", (), more=(Cell("unimodal_slow", "straight_line", 3),))
    told = []

    def progress(done, total, forecast):
        told.append((done, total))

    published = load_results(record.folder)
    run_missing(tmp_path / "mine", study, outlook, 1, progress, published)
    assert (told[0], told[-1]) == ((2, 3), (3, 3))
    assert list(load_results(tmp_path / "mine")["seed"]) == [2]
    published["weights_sha256"] = "others"
    run_missing(tmp_path / "mine", study, outlook, 1, progress, published)
    assert list(load_results(tmp_path / "mine")["seed"]) == [0, 1, 2]
