"""Twins with and without the robot, against what a watch by the door would say."""

from __future__ import annotations

import numpy as np
import pytest
from crossings import crossing, walking
from crowdbench_agents.straight_line import StraightLine

from crowdbench import load_scenario
from crowdbench.evaluation.disturbance import (
    DisturbanceError,
    _shift,
    _simulate,
    _Walks,
    disturbance,
)
from crowdbench.evaluation.metrics import metrics
from crowdbench.evaluation.rollout import run_episode
from crowdbench.people import read_recording
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


def twin_of(scenario, seed, commands):
    return _simulate(scenario, seed, commands)[0]


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


def test_who_waits_at_a_door_in_a_map_is_late_by_the_wait():
    # The robot stands in a gap of a metre between two halls until it leaves after 16 s.
    world = load_scenario(
        "open",
        arena={
            "kind": "map", "length": 20, "width": 6,
            "walls": [[0, -3, 0, -0.5], [0, 0.5, 0, 3]],
            "regions": {"west": [-9.5, -1, -8.5, 1], "east": [8.5, -1, 9.5, 1]},
        },
        robots={"start": [0, 0], "goal": [6, 0]},
        pedestrians={
            "count": 1, "speed": (0.8, 0.8), "responsibility": 1.0, "field_of_view": 360,
            "streams": [{"start": "west", "goal": "east"}],
        },
    )  # fmt: skip
    seed = next(
        s for s in range(900_000, 900_050) if -9 < World(world, s).pedestrians.position[0, 0] < -6
    )
    x = World(world, seed).pedestrians.position[0, 0]
    wait = 16.0 - (-x - 0.5) / 0.8
    assert wait > 5.0
    found = disturbance(world, seed, standing(16.0)).by_robot
    assert found.delay == pytest.approx(wait, abs=0.4)
    assert found.displacement == pytest.approx(0.8 * wait, abs=0.4)
    assert 0.0 <= found.detour < 1.0  # it steps aside in front of the door


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


@pytest.mark.parametrize("name", ["hard_two_streams", "hard_corridor_groups", "situation_doorway"])
def test_who_does_not_enter_beside_a_robot_has_lost_nothing(name):
    world = load_scenario(name, pedestrians={"reactive": 0.0})
    for seed in (900_700, 900_703):
        begun, untouched = World(world, seed), 0
        while untouched < 100 and not begun.contacts:
            begun.step(np.zeros((1, 2)))
            untouched += not begun.contacts
        found = disturbance(world, seed, standing(PERIOD * untouched))
        assert found.by_robot == ZERO


def test_the_noise_floor_begins_at_a_millimetre_and_does_not_know_the_robot():
    world = crowd("unimodal_slow")
    found = [disturbance(world, 900_000, standing(time)).noise_floor for time in (0.0, 8.0)]
    assert found[0] == found[1]
    assert found[0].displacement >= 1e-3 - 1e-9


def walks(*places, goals=None, speed=1.0):
    """One person in states 0.2 s apart; its goal is the last place, unless others are given."""
    position = np.array(places, float)[:, None]
    goal = np.array([places[-1]] * len(places) if goals is None else goals, float)[:, None]
    return _Walks.of_states(position, goal, np.array([speed]), np.zeros((1, 2)), 0.2)


def test_a_shift_by_hand():
    """Held up for two of five steps, and a step aside for another."""
    without = walks((0, 0), (0.2, 0), (0.4, 0), (0.6, 0), (0.8, 0), (1, 0))
    held_up = walks(
        (0, 0), (0.2, 0), (0.2, 0), (0.2, 0), (0.2, 0.2), (0.4, 0.2), goals=[(1, 0)] * 6
    )
    found = _shift(held_up, without)
    assert found.delay == pytest.approx(0.6)
    assert found.detour == pytest.approx(0.2)
    assert found.displacement == pytest.approx(np.hypot(0.6, 0.2))
    # The other way round somebody is early, by the same.
    assert _shift(without, held_up)[:2] == pytest.approx((-0.6, -0.2))


def test_who_has_entered_anew_has_not_walked_there():
    """From 1 m to the goal at 1.4 m, and on from 9 m away: 0.8 m are ahead of 0.2 m."""
    goals = [(1.4, 0)] * 3 + [(9.6, 0)] * 3
    anew = walks((1, 0), (1.2, 0), (1.4, 0), (9.0, 0), (9.2, 0), (9.4, 0), goals=goals)
    late = walks((1, 0), (1, 0), (1, 0), (1, 0), (1, 0), (1.2, 0), goals=[(1.4, 0)] * 6)
    found = _shift(late, anew)
    assert found.delay == pytest.approx(0.6)
    assert found.detour == pytest.approx(0.0)
    assert found.displacement == pytest.approx(0.4)


def test_who_gets_another_goal_is_left_out():
    one, other = walks((0, 0), (0.2, 0)), walks((0, 0), (0, 0.2))
    assert _shift(one, other)[2:] == pytest.approx((np.hypot(0.2, 0.2), 0.0))
    assert np.isnan(_shift(one, other)[:2]).all()


AWAY = (np.nan, np.nan)
RECORDED = [AWAY, (0, 0), (0.2, 0), (0.4, 0), (0.6, 0), (0.8, 0), AWAY]
"""Comes after one step and leaves after six."""


@pytest.mark.parametrize(
    ("places", "delay", "detour", "displacement"),
    [
        # Held back twice, it appears 0.4 m on; until then it waits where it would have begun.
        ([AWAY, AWAY, AWAY, (0.4, 0), (0.6, 0), (0.8, 0), AWAY], 0.4, 0.0, 0.2),
        # Held back for as long as it is recorded.
        ([AWAY] * 7, 0.8, 0.0, 0.8),
        # It evades by 0.2 m for a step of 0.4 m, and is 0.2 m short when it leaves.
        ([AWAY, (0, 0), (0.2, 0), (0.2, 0.4), (0.4, 0.4), (0.6, 0.4), AWAY], 0.2, 0.4,
         np.hypot(0.2, 0.4)),
        # Held back once, then it waits for two steps and catches up one of them.
        ([AWAY, AWAY, (0.2, 0), (0.2, 0), (0.2, 0), (0.6, 0), AWAY], 0.2 + 0.2, 0.0, 0.4),
    ],
)  # fmt: skip
def test_people_who_come_and_go_are_compared_while_they_are_there(
    places, delay, detour, displacement
):
    goals = [(0.8, 0)] * 7
    found = _shift(walks(*places, goals=goals), walks(*RECORDED, goals=goals))
    assert found == pytest.approx((delay, detour, displacement, 1.0))


def test_who_is_never_there_is_nobody():
    goals = [(0.8, 0)] * 7
    assert np.isnan(_shift(*[walks(*[AWAY] * 7, goals=goals)] * 2)).all()


def test_who_stands_is_displaced_but_never_late():
    stays = walks((0, 0), (0, 0), (0, 0), speed=0.0)
    pushed = walks((0, 0), (0, 0.3), (0, 0), speed=0.0)
    found = _shift(pushed, stays)
    assert np.isnan(found.delay)
    assert found[1:] == pytest.approx((0.6, 0.3, 1.0))


@pytest.mark.parametrize("speed", [0.05, 0.15])
def test_recorded_people_below_a_tenth_of_a_metre_a_second_stand(recording, speed):
    rows = [f"{p},{t},{5 * p + t * speed},{p}\n" for p in range(3) for t in range(60)]
    recording.write_text("id,time,x_m,y_m\n" + "".join(rows))
    scenario = crossing(recording, **{"robots.start": [0.0, 3.0], "robots.goal": [0.0, -3.0]})
    paces = twin_of(scenario, 3, standing(0.0)).speed
    assert paces == pytest.approx(np.full(3, 0.0 if speed < 0.1 else speed))


def test_commands_out_of_range_are_followed_as_far_as_the_drive_goes():
    world = crowd("multimodal_fast")
    one, other = ([np.tile([v, 0.0], (30, 1))] for v in (1.0, 7.0))
    assert disturbance(world, 900_001, one) == disturbance(world, 900_001, other)


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "walk.csv"
    path.write_text(walking(persons=8))
    return path


def test_without_a_robot_reactive_people_walk_as_recorded(recording):
    scenario = crossing(recording, **{"pedestrians.reactive": 1.0})
    twin = twin_of(scenario, 3, standing(0.0))
    tracks = World(scenario, 3).layout.tracks
    expected = np.array([tracks.at(k) for k in range(101)])
    np.testing.assert_allclose(twin.position, expected, atol=1e-9)


def test_nobody_who_is_recorded_and_not_reactive_loses_anything(recording):
    scenario = crossing(recording, **{"pedestrians.reactive": 0.0})
    found = disturbance(scenario, 3, standing(20.0))
    assert found.by_robot == ZERO
    # After a push of a millimetre they are back on their ways at once.
    assert 0.0 < found.noise_floor.displacement <= 1e-3 + 1e-9
    assert found.noise_floor.delay == pytest.approx(0.0, abs=1e-3)
    seeing = crossing(recording, **{"pedestrians.reactive": 1.0})
    driven = [np.tile([1.0, 0.0], (40, 1))]
    assert disturbance(seeing, 1, driven).by_robot.displacement > 0.01


def test_a_robot_at_the_entrance_holds_people_back_until_it_leaves(recording):
    # All people enter 0.6 m from each other, in two rows; it stands on the beginning of one.
    x, y = read_recording(recording).positions[0] - sum(read_recording(recording).extent) / 2
    scenario = crossing(
        recording,
        **{"pedestrians.reactive": 0.0, "robots.start": [x, y], "robots.goal": [5.0, 0.0]},
    )
    twin = twin_of(scenario, 3, standing(20.0))
    there, recorded = twin.there, twin_of(scenario, 3, standing(0.0)).there
    held = (recorded & ~there).sum(axis=0)
    known = recorded.any(axis=0)
    assert (held > 0).any() and set(held.tolist()) <= {0, 2, 3}  # 0.5 m at 1 m/s
    found = disturbance(scenario, 3, standing(20.0)).by_robot
    assert found.delay == pytest.approx(held[known].mean() * PERIOD, rel=0.02)
    assert found.detour == pytest.approx(0.0, abs=1e-9)


def test_goals_that_nobody_is_pushed_off_are_the_same_in_both_twins():
    world = crowd("multimodal_fast")
    driven = [np.tile([1.0, 0.0], (40, 1))]
    with_robot, without = (twin_of(world, 900_001, told) for told in (driven, standing(0.0)))
    assert not np.array_equal(with_robot.position, without.position)
    for p in range(len(without.speed)):
        goals = [twin.of(p).goals for twin in (with_robot, without)]
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
    twin = twin_of(world, 900_002, [episode.commands])
    assert 10 < episode.steps < 100 == len(twin.position) - 1
    there = slice(episode.steps + 1)
    np.testing.assert_array_equal(twin.position[there], episode.pedestrian_position)
    np.testing.assert_array_equal(twin.goal[there], episode.pedestrian_goal)


def test_nobody_around_is_undefined():
    world = load_scenario("multimodal_fast", pedestrians={"count": 0})
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
