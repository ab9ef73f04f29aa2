"""From a results folder into the record: the plan's episodes, and what that changed."""

import pytest
from stored_episodes import Episodes

from crowdbench.evaluation.joined import cells_of
from crowdbench.evaluation.publish import publish
from crowdbench.evaluation.record import load_commands, load_record

SCENARIO = "unimodal_slow"


@pytest.fixture
def local(tmp_path):
    """A results folder of a name."""
    return lambda name: Episodes(tmp_path / name)


def values(rows, name="spl"):
    return dict(zip(rows["seed"], rows[name], strict=True))


def test_only_cells_and_seeds_of_the_plan_are_published(local, record):
    mine = local("mine")
    mine.add("orca", SCENARIO, spl=[0.1, 0.2, 0.3])
    mine.add("sac", SCENARIO, spl=[0.5])
    mine.add("orca", "unimodal_fast", spl=[0.5])
    outcome = publish([(SCENARIO, "orca", 2), (SCENARIO, "neupan", 2)], mine.folder, record)
    (change,) = outcome.changes
    assert (change.cell.agent, change.added, change.replaced) == ("orca", 2, 0)
    assert outcome.refused == []
    rows = load_record()
    assert set(rows["agent"]) == {"orca"}
    assert values(rows) == {0: 0.1, 1: 0.2}


def test_a_second_run_replaces_the_first_and_the_differences_are_told(local, record):
    plan = [(SCENARIO, "orca", 100)]
    first, second = local("first"), local("second")
    first.add("orca", SCENARIO, spl=[0.5, 0.5, 0.5], cutoff=[0.0, 0.0, 0.0])
    publish(plan, first.folder, record)
    later = {"timestamp": "2026-01-01T00:00:00+00:00"}
    second.add("orca", SCENARIO, spl=[0.5], cutoff=[0.0], fixed=later)
    second.add("orca", SCENARIO, 1, spl=[0.4], cutoff=[0.0], fixed={**later, "outcome": "timeout"})
    (change,) = publish(plan, second.folder, record).changes
    assert (change.added, change.replaced, change.outcomes) == (0, 2, 1)
    assert change.differences == {"spl": pytest.approx(0.2)}
    assert values(load_record()) == {0: 0.5, 1: 0.4, 2: 0.5}
    assert values(load_record(), "timestamp")[1] == later["timestamp"]


def test_changes_are_counted_in_episodes_however_many_robots_they_have(local, record):
    for name, outcome in (("first", "success"), ("second", "timeout")):
        mine = local(name)
        for robot in ("robot_0", "robot_1"):
            fixed = {"timestamp": name, "outcome": outcome}
            mine.add("orca", SCENARIO, robot=robot, spl=[0.5, 0.5], fixed=fixed)
        (change,) = publish([(SCENARIO, "orca", 100)], mine.folder, record).changes
    assert (change.added, change.replaced, change.outcomes) == (0, 2, 2)


def test_rows_with_and_without_a_metric_are_not_published_side_by_side(local, record):
    plan = [(SCENARIO, "orca", 3)]
    old, new = local("old"), local("new")
    old.add("orca", SCENARIO, spl=[0.5, 0.5], older=["jerk"])
    assert publish(plan, old.folder, record).refused == []
    assert "jerk" not in load_record()
    new.add("orca", SCENARIO, first=2, spl=[0.5])
    outcome = publish(plan, new.folder, record)
    assert outcome.changes == []
    assert outcome.refused == [
        "orca in unimodal_slow: some rows, published or local, are older than jerk; crowdbench "
        "recompute fills it in"
    ]
    assert len(load_record()) == 2
    new.add("orca", SCENARIO, spl=[0.5, 0.5], fixed={"timestamp": "later"})
    (change,) = publish(plan, new.folder, record).changes
    assert (change.added, change.replaced, len(load_record())) == (1, 2, 3)


def test_a_metric_that_is_defined_in_one_run_only_differs_wholly(local, record):
    plan = [(SCENARIO, "orca", 100)]
    nan = float("nan")
    for name, time in (("first", nan), ("second", 8.0)):
        mine = local(name)
        mine.add("orca", SCENARIO, time_to_goal=[time], fixed={"timestamp": name})
        outcome = publish(plan, mine.folder, record)
    assert outcome.changes[0].differences == {"time_to_goal": 1.0}


@pytest.mark.parametrize("changed", [{}, {"code": "a file"}])
def test_a_smaller_plan_takes_nothing_away(local, record, changed):
    first, second = local("first"), local("second")
    first.add("orca", SCENARIO, spl=[0.5] * 6)
    publish([(SCENARIO, "orca", 6)], first.folder, record)
    later = {"timestamp": "2026-01-01T00:00:00+00:00"} | changed
    second.add("orca", SCENARIO, spl=[0.7, 0.8, 0.9], fixed=later)
    outcome = publish([(SCENARIO, "orca", 3)], second.folder, record)
    if changed:
        (reason,) = outcome.refused
        assert "3 of the 6 published seeds were not run" in reason
        assert values(load_record()) == dict.fromkeys(range(6), 0.5)
    else:
        assert outcome.changes[0].replaced == 3
        assert list(values(load_record()).values()) == [0.7, 0.8, 0.9, 0.5, 0.5, 0.5]


def test_what_is_published_already_is_left_alone(local, record):
    mine = local("mine")
    mine.add("orca", SCENARIO, spl=[0.5])
    plan = [(SCENARIO, "orca", 100)]
    assert len(publish(plan, mine.folder, record).changes) == 1
    before = {path: path.stat().st_mtime_ns for path in record.rglob("*")}
    assert publish(plan, mine.folder, record).changes == []
    assert before == {path: path.stat().st_mtime_ns for path in record.rglob("*")}


@pytest.mark.parametrize("changed", [{"weights_sha256": "ff"}, {"code": "a file"}])
def test_another_measurement_replaces_a_whole_cell_or_nothing(local, record, changed):
    plan = [(SCENARIO, "orca", 100)]
    first, second = local("first"), local("second")
    first.add("orca", SCENARIO, spl=[0.5, 0.5])
    publish(plan, first.folder, record)
    second.add("orca", SCENARIO, spl=[0.7], fixed=changed)
    outcome = publish(plan, second.folder, record)
    assert outcome.changes == []
    (reason,) = outcome.refused
    assert "1 of the 2 published seeds were not run" in reason
    assert values(load_record()) == {0: 0.5, 1: 0.5}
    second.add("orca", SCENARIO, first=1, spl=[0.8], fixed=changed)
    (change,) = publish(plan, second.folder, record).changes
    assert change.replaced == 2
    assert values(load_record()) == {0: 0.7, 1: 0.8}


def test_commands_come_along_and_those_of_other_seeds_stay(whole, make_whole, tmp_path, record):
    plan = [(SCENARIO, "straight_line", 100)]
    whole.run(SCENARIO, "straight_line", 0)
    publish(plan, whole.folder, record)
    other = make_whole(tmp_path / "other")
    run = other.run(SCENARIO, "straight_line", 1)
    publish(plan, other.folder, record)
    (cell,) = cells_of(load_record()).values()
    commands = load_commands(cell)
    assert commands.seeds == {0, 1}
    assert (commands.of(1)["robot_0"] == run.commands).all()


def test_commands_of_a_replaced_episode_are_replaced_with_it(whole, make_whole, tmp_path, record):
    plan = [(SCENARIO, "straight_line", 100)]
    first = whole.run(SCENARIO, "straight_line", 2)
    publish(plan, whole.folder, record)
    other = make_whole(tmp_path / "other")
    second = other.run(SCENARIO, "orca", 2, label="straight_line")
    assert second.steps != first.steps
    (change,) = publish(plan, other.folder, record).changes
    assert (change.added, change.replaced) == (0, 1)
    (cell,) = cells_of(load_record()).values()
    assert (load_commands(cell).of(2)["robot_0"] == second.commands).all()


def test_rows_of_a_scenario_that_is_defined_otherwise_by_now_are_not_published(local, record):
    mine = local("mine")
    mine.add("orca", SCENARIO, spl=[0.5], fixed={"scenario_digest": "0123456789ab"})
    assert publish([(SCENARIO, "orca", 100)], mine.folder, record) == ([], [])
    assert load_record().empty


def test_scenarios_that_are_not_installed_are_refused(whole, tmp_path, record):
    path = tmp_path / "mine.yaml"
    path.write_text("extends: unimodal_slow\ntime_limit: 1\n")
    whole.run(path, "straight_line", 0)
    outcome = publish([(str(path), "straight_line", 1)], whole.folder, record)
    assert outcome.changes == []
    assert "installed scenarios only" in outcome.refused[0]
