"""What is believed of the ways of people in streams agrees with where they walk."""

from __future__ import annotations

import numpy as np
import pytest
from believed import drawn, futures
from crowdbench_agents.informed.agent import Informed
from crowdbench_agents.informed.goals import Goals
from shapely import LineString, MultiLineString

import crowdbench

SEED = 900_002
WEST, EAST, DOOR = [-9, -5, -8, 5], [8, -5, 9, 5], [-0.5, -1, 0.5, 1]
REGIONS = {"west": WEST, "east": EAST, "door": DOOR, "robot": [-1, -5.5, 1, -4.5]}
WALL = [[0, -3, 0, -1], [0, 1, 0, 6]]
"""Across the middle, with a gap of 2 m."""


def world_of(
    count=1, streams=({"start": "west", "goal": "east"},), walls=(), start="robot", **given
):
    """A square with streams, in which people see no robot."""
    arena = {"kind": "map", "length": 20, "width": 12, "walls": list(walls), "regions": REGIONS}
    people = {"count": count, "reactive": 0, "goals": "unimodal", "speed": (1.0, 1.4)}
    env = crowdbench.parallel_env(
        "unimodal_fast",
        arena=arena,
        robots={"start": start, "goal": "east"},
        pedestrians={**people, "streams": list(streams), **given},
        time_limit=100.0,
    )
    env.reset(seed=SEED)
    return env


def watch(env, steps=0, futures=40, seen=True, until=lambda state: False):
    """Goals after some steps in which the robot stands, and the state then."""
    mask = np.full(env.scenario.pedestrians.count, seen)
    rng = np.random.default_rng(1)
    state = env.state()
    goals = Goals(state, 0.2, env.robot_spec().radius, futures, rng)
    goals.update(state, mask)
    for _ in range(steps):
        if until(state):
            break
        env.step({"robot_0": (0.0, 0.0)})
        state = env.state()
        goals.update(state, mask)
    return goals, state


def within(points, region, by=1e-9):
    x, y = points[..., 0], points[..., 1]
    inside = (region[0] - by <= x) & (x <= region[2] + by)
    return inside & (region[1] - by <= y) & (y <= region[3] + by)


def test_a_way_leads_to_the_exit_but_whereto_in_it_nobody_knows():
    goals, state = watch(world_of(count=6))
    believed, true = drawn(goals, state, "pedestrian_goal"), state["pedestrian_goal"]
    assert within(believed, EAST).all()
    assert np.median(np.linalg.norm(believed - true, axis=2)) > 0.5
    np.testing.assert_array_equal(drawn(goals, state, "pedestrian_way")[:, :, -1], believed)
    assert np.isinf(drawn(goals, state, "pedestrian_switch_time")).all()


def test_who_is_not_seen_leaves_anywhere_in_the_exit():
    """Places are drawn evenly from what is 0.25 m or more from the border of the region's room."""
    goals, state = watch(world_of(), seen=False, futures=400)
    believed = drawn(goals, state, "pedestrian_goal")[:, 0]
    assert believed[:, 1].mean() == pytest.approx(0.0, abs=0.1)
    assert believed[:, 1].std() == pytest.approx(10 / np.sqrt(12), rel=0.1)


def test_belief_gathers_where_the_person_walks():
    """Its direction tells: after 4 s places beside the straight line have been ruled out."""
    env = world_of()
    off = []
    for goals, state in (watch(env, steps) for steps in (0, 20)):
        way = state["pedestrian_goal"][0] - state["pedestrian_position"][0]
        ahead = drawn(goals, state, "pedestrian_goal")[:, 0] - state["pedestrian_position"][0]
        off.append(np.abs(np.arctan2(ahead[:, 1], ahead[:, 0]) - np.arctan2(way[1], way[0])))
    assert off[1].max() < 0.05
    assert off[1].mean() < 0.5 * off[0].mean()


def test_ways_pass_walls():
    env = world_of(count=8, walls=WALL)
    goals, state = watch(env, 3)
    walls = MultiLineString([[wall[:2], wall[2:]] for wall in WALL])
    assert (state["pedestrian_position"][:, 0] < -1).any()
    for future in goals.draw(state):
        for place, way in zip(state["pedestrian_position"], future["pedestrian_way"], strict=True):
            assert not LineString([place, *way]).crosses(walls)


def test_who_waits_to_enter_stands_and_then_may_go_anywhere():
    """The robot stands where the stream begins, and nobody enters within 20 m of it."""
    env = world_of(start="west", spawn_clearance=4.0)
    goals, state = watch(env, 200, until=lambda state: state["pedestrian_stage"][0] < 0)
    assert state["pedestrian_stage"][0] < 0
    for future in goals.draw(state):
        walk = crowdbench.walk_ahead(future, 0.2, np.full((9, 1, 4), np.nan), 0.25)
        assert np.ptp(walk.position[:, 0], axis=0).max() < 1e-9


def test_who_enters_anew_is_believed_to_leave_where_it_comes_walking_to():
    env = world_of()
    goals, state = watch(env, 200, until=lambda state: state["pedestrian_position"][0, 0] > 7.0)
    before = drawn(goals, state, "pedestrian_goal")[:, 0, 1]
    while state["pedestrian_position"][0, 0] > 0.0:
        env.step({"robot_0": (0.0, 0.0)})
        state = env.state()
        goals.update(state, np.ones(1, dtype=bool))
    after, true = drawn(goals, state, "pedestrian_goal")[:, 0, 1], state["pedestrian_goal"][0, 1]
    assert np.ptp(after) > 1.0 > np.ptp(before)
    assert after.min() < true < after.max()
    assert after.mean() == pytest.approx(true, abs=0.7)


def test_regions_on_the_way_come_first():
    """Who has the door ahead goes to a place in it, who has passed it to the exit."""
    env = world_of(count=10, streams=({"start": "west", "via": ["door"], "goal": "east"},))
    goals, state = watch(env, 2)
    ends = drawn(goals, state, "pedestrian_way")[:, :, -1]
    passed = state["pedestrian_stage"] == 1
    assert passed.any() and not passed.all()
    assert within(ends[:, passed], EAST).all()
    assert within(ends[:, ~passed], DOOR).all()
    assert within(drawn(goals, state, "pedestrian_goal"), EAST).all()


def test_legs_are_believed_to_be_interrupted_as_often_as_they_are():
    """Half of all legs are, evenly over their time: of one in its middle a quarter has been."""
    env = world_of(goals="multimodal", switch_probability=0.5)
    goals, state = watch(env, seen=False, futures=1000)
    ahead = np.linalg.norm(state["pedestrian_goal"] - state["pedestrian_position"], axis=1)
    lasts = (ahead / state["pedestrian_speed"])[0]
    mask, place = np.zeros(1, dtype=bool), state["pedestrian_position"].copy()
    for k in range(1, round(lasts / 0.4) + 1):
        state = {**state, "time": np.array(0.2 * k), "pedestrian_position": place}
        goals.update(state, mask)
    believed = drawn(goals, state, "pedestrian_goal")[:, 0]
    back = within(believed, WEST)
    # Half return to the start; without another stream the others divert to the same exit.
    assert back.mean() == pytest.approx(0.125, abs=0.02)
    switches = np.isfinite(drawn(goals, state, "pedestrian_switch_time")[:, 0])
    assert not switches[back].any()
    assert switches.mean() == pytest.approx(0.25, abs=0.03)
    later = drawn(goals, state, "pedestrian_next_goal")[switches, 0]
    assert within(later, WEST).mean() == pytest.approx(0.5, abs=0.1)


def test_who_has_turned_back_is_believed_to_have():
    env = world_of(count=12, goals="multimodal", switch_probability=1.0)
    state = env.state()
    first = np.argmin(
        np.where(state["pedestrian_intent"] == 1, state["pedestrian_switch_time"], 99)
    )
    steps = int(state["pedestrian_switch_time"][first] / 0.2) + 8
    goals, state = watch(env, steps)
    assert state["pedestrian_velocity"][first, 0] < -0.5
    assert within(drawn(goals, state, "pedestrian_goal")[:, first], WEST).mean() > 0.9


def test_nothing_hidden_has_any_influence():
    def told(hidden=None):
        return futures(world_of(count=6, goals="multimodal"), "pedestrian_way", hidden)

    names = ("pedestrian_goal", "pedestrian_next_goal", "pedestrian_way")
    np.testing.assert_array_equal(told(), told(dict(zip(names, (1.0, -1.0, 1.0), strict=True))))


def test_commands_differ_from_those_of_who_knows_all_ways():
    def drive(**options):
        env = crowdbench.parallel_env("hard_two_streams")
        observations, _ = env.reset(seed=900_010)
        agent = Informed(**options)
        agent.reset(env.robot_spec(), 0)
        actions = []
        for _ in range(6):
            seen = crowdbench.Observation(**observations["robot_0"], state=env.state())
            actions.append(agent.act(seen))
            observations, *_ = env.step({"robot_0": actions[-1]})
        return np.array(actions)

    assert (drive() != drive(intent="sampled", futures=2)).any()


def test_where_nothing_is_left_to_be_believed_belief_begins_anew():
    """The only square believed in is one where the person stands who has not arrived."""
    goals, state = watch(world_of())
    squares = goals._streams._aims[0].place
    goals._streams._weights[0] = (np.arange(len(squares)) == 7).astype(float)
    for _ in range(2):
        state = {**state, "pedestrian_position": squares[7:8] + 0.05}
        goals.update(state, np.ones(1, dtype=bool))
    assert np.ptp(drawn(goals, state, "pedestrian_goal")[:, 0, 1]) > 5.0
