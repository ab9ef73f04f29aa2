"""Twins with and without the robot, against what a watch by the door would say."""

from __future__ import annotations

import numpy as np
import pytest
from crowdbench_agents.straight_line import StraightLine

from crowdbench import load_scenario
from crowdbench.evaluation.disturbance import DisturbanceError, _legs, _simulate, disturbance
from crowdbench.evaluation.metrics import metrics
from crowdbench.evaluation.rollout import run_episode
from crowdbench.simulation.world import World

PERIOD = 0.2
ZERO = (0.0, 0.0, 0.0, 1.0)


def doorway(length, leg, speed, on_arrival):
    """A corridor of a metre: nobody gets past a robot that stands in it, or touches it."""
    return load_scenario(
        "corridor_sparse",
        arena={"length": length, "width": 1.0},
        robots={"travel": 4},
        obstacles={"count": 0},
        pedestrians={
            "count": 1, "speed": (speed, speed), "responsibility": 1.0, "field_of_view": 360,
            "leg": leg, "leg_from": "goal", "on_arrival": on_arrival,
        },
    )  # fmt: skip


def crowd(name, **people):
    """A scenario in which nobody's goals depend on the robot."""
    return load_scenario(name, pedestrians={"leg_from": "goal", **people})


def standing(seconds):
    return [np.zeros((round(seconds / PERIOD), 2))]


def reaches_the_robot(world, seed):
    """When the only pedestrian is half a metre from the robot's start, where circles touch."""
    begun = World(world, seed)
    people, (x, *_) = begun.pedestrians, begun.pose[0]
    start, goal = people.position[0, 0], people.goal[0, 0]
    assert (start - x) * (goal - x) < 0, "the robot is in the way"
    return (abs(start - x) - 0.5) / people.speed[0]


@pytest.mark.parametrize("seed", [900_003, 900_007])
def test_who_waits_at_a_blocked_doorway_is_late_by_the_wait(seed):
    world = doorway(50, 20, 0.8, "stop")
    wait = 12.0 - reaches_the_robot(world, seed)
    assert wait > 3.0
    found = disturbance(world, seed, standing(12.0)).by_robot
    assert found.delay == pytest.approx(wait, abs=0.1)
    assert found.displacement == pytest.approx(0.8 * wait, abs=0.1)
    assert found.detour == pytest.approx(0.0, abs=0.02)
    assert found.compared == 1.0


@pytest.mark.parametrize("seed", [900_000, 900_003, 900_005, 900_016])
def test_who_was_held_up_stays_late_on_the_ways_that_follow(seed):
    world = doorway(16, 7, 1.0, "new_goal")
    reached = reaches_the_robot(world, seed)
    leaves = round((reached + 3.0) / PERIOD) * PERIOD
    found = disturbance(world, seed, standing(leaves)).by_robot
    # A goal counts as reached from 0.3 m away, on either side.
    assert found.delay == pytest.approx(leaves - reached, abs=0.3)
    assert found.compared == 1.0


def test_a_robot_that_is_never_there_costs_nothing():
    world = crowd("multimodal_fast")
    assert disturbance(world, 900_000, standing(0.0)).by_robot == ZERO


def test_a_robot_far_from_everybody_costs_nothing():
    world = load_scenario(
        "multimodal_fast",
        arena={"length": 150, "width": 150},
        robots={"travel": 140},
        pedestrians={"count": 3, "leg": 3, "leg_from": "goal", "spawn_clearance": 30},
    )
    assert disturbance(world, 900_000, standing(20.0)).by_robot == ZERO


@pytest.mark.parametrize("seed", [900_000, 900_001, 900_002])
def test_people_who_do_not_see_the_robot_and_are_not_touched_lose_nothing(seed):
    # A metre away from everybody at first, it is gone before anybody gets there.
    blind, seeing = crowd("multimodal_fast_nonreactive"), crowd("multimodal_fast")
    assert disturbance(blind, seed, standing(1.0)).by_robot == ZERO
    driven = [np.tile([1.0, 0.0], (40, 1))]
    assert disturbance(seeing, seed, driven).by_robot.displacement > 0.0


def test_the_noise_floor_begins_at_a_millimetre_and_does_not_know_the_robot():
    world = crowd("unimodal_slow")
    found = [disturbance(world, 900_000, standing(time)).noise_floor for time in (0.0, 8.0)]
    assert found[0] == found[1]
    assert found[0].displacement >= 1e-3 - 1e-9


def test_who_has_turned_to_another_goal_in_one_twin_only_is_left_out():
    # Somebody who is held up for a while begins later legs late, and turns back later.
    world = doorway(16, 7, 1.0, "new_goal")
    world = world.override(
        {"pedestrians.goals": "multimodal", "pedestrians.switch_probability": 1.0}
    )
    found = [disturbance(world, seed, standing(6.0)).by_robot for seed in range(900_000, 900_012)]
    assert {shift.compared for shift in found} == {0.0, 1.0}
    assert all(np.isnan(shift.delay) == (shift.compared == 0.0) for shift in found)


def test_goals_that_nobody_is_pushed_off_are_the_same_in_both_twins():
    world = crowd("multimodal_fast")
    driven = [np.tile([1.0, 0.0], (40, 1))]
    with_robot, without = (_simulate(world, 900_001, told) for told in (driven, standing(0.0)))
    assert not np.array_equal(with_robot.position, without.position)
    for p in range(len(without.speed)):
        goals = [np.array([leg.goal for leg in _legs(twin, p)]) for twin in (with_robot, without)]
        shared = min(map(len, goals))
        np.testing.assert_array_equal(goals[0][:shared], goals[1][:shared])


def test_a_robot_that_touches_something_leaves():
    # It drives into the wall at once, and is no obstacle in the door after that.
    world = doorway(50, 20, 0.8, "stop")
    turn, forward = np.tile([0.0, 1.5], (5, 1)), np.tile([1.0, 0.0], (55, 1))
    found = disturbance(world, 900_003, [np.vstack([turn, forward])]).by_robot
    assert found.delay < 0.2


def test_people_walk_as_in_the_episode_until_it_ends():
    world = crowd("multimodal_fast")
    (episode,) = run_episode(world, "straight_line", seed=900_002)
    twin = _simulate(world, 900_002, [episode.commands])
    assert 10 < episode.steps < 100 == len(twin.position) - 1
    there = slice(episode.steps + 1)
    np.testing.assert_array_equal(twin.position[there], episode.pedestrian_position)
    np.testing.assert_array_equal(twin.goal[there], episode.pedestrian_goal)


def test_nobody_around_is_undefined():
    world = crowd("multimodal_fast", count=0)
    assert np.isnan(disturbance(world, 900_000, standing(1.0))).all()


@pytest.mark.parametrize(
    ("commands", "told"),
    [
        ([], "commands: 0 robots, expected 1"),
        ([np.zeros((3, 3))], r"commands of robot_0: expected finite numbers of shape \(T, 2\)"),
        ([np.full((2, 2), np.nan)], "commands of robot_0: expected finite numbers"),
    ],
)
def test_commands_that_are_none_are_refused(commands, told):
    with pytest.raises(DisturbanceError, match=told):
        disturbance(crowd("unimodal_slow"), 900_000, commands)


@pytest.mark.parametrize(
    ("people", "told"),
    [
        ({"leg_from": "position"}, "pedestrians.leg_from: 'position': .*; allowed: 'goal'"),
        ({"control": "agents"}, "pedestrians.control: 'agents': .*; allowed: 'scripted'"),
    ],
)
def test_a_scenario_whose_twins_cannot_be_compared_is_refused_with_the_reason(people, told):
    world = crowd("unimodal_slow", **people)
    with pytest.raises(DisturbanceError, match=f"^scenario 'unimodal_slow': {told}$"):
        disturbance(world, 900_000, standing(1.0))


def test_the_metrics_are_what_the_twins_say():
    world = crowd("multimodal_fast")
    (episode,) = run_episode(world, "straight_line", seed=900_002)
    found, values = disturbance(world, 900_002, [episode.commands]), metrics(episode)
    for name in ("delay", "detour", "displacement"):
        assert values[name] == getattr(found.by_robot, name) != 0.0
        assert values[f"{name}_by_chance"] == getattr(found.noise_floor, name)


def test_robots_of_one_episode_cost_people_the_same_together():
    world = crowd("multimodal_fast").override({"robots.count": 2})
    one, other = run_episode(world, [StraightLine(), StraightLine()], seed=900_002)
    assert metrics(one)["delay"] == metrics(other)["delay"] != 0.0


def test_the_metrics_are_undefined_where_twins_cannot_be_compared():
    (episode,) = run_episode("multimodal_fast", "straight_line", seed=900_002)
    values = metrics(episode)
    assert np.isnan([values["delay"], values["displacement_by_chance"]]).all()
