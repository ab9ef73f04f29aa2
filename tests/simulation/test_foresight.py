"""Foresight: people of a state walk on as they would in the world."""

import numpy as np
import pytest

import crowdbench

PERIOD = 0.2
RADIUS = 0.25


def state_of(steps=0, **people):
    env = crowdbench.parallel_env("unimodal_fast", pedestrians=people)
    env.reset(seed=900_000)
    for _ in range(steps):
        env.step({"robot_0": (0.0, 0.0)})
    return env, env.state()


def nobody(periods):
    return np.full((periods, 1, 4), np.nan)


def test_one_person_walks_straight_to_its_goal_and_then_nobody_knows():
    _, state = state_of(count=1)
    start, goal = state["pedestrian_position"][0], state["pedestrian_goal"][0]
    speed, way = state["pedestrian_speed"][0], np.linalg.norm(goal - start)
    periods = int(way / speed / PERIOD) + 2
    walk = crowdbench.walk_ahead(state, PERIOD, nobody(periods), RADIUS)
    walked = speed * PERIOD * np.arange(periods - 3)
    expected = start + walked[:, None] * (goal - start) / way
    np.testing.assert_allclose(walk.position[: periods - 3, 0], expected, atol=1e-9)
    # On arrival 0.3 m are left.
    assert walk.arrived[0] == pytest.approx((way - 0.3) / speed, abs=PERIOD)
    assert not walk.leaves[0]


def test_further_goals_are_walked_to_one_after_another():
    _, state = state_of(count=1)
    place, goal = state["pedestrian_position"][0], state["pedestrian_goal"][0]
    state["pedestrian_further"] = np.array([[place, goal]])
    walk = crowdbench.walk_ahead(state, PERIOD, nobody(200), RADIUS)
    way = np.linalg.norm(goal - place)
    back = np.linalg.norm(walk.position[:, 0] - place, axis=1)
    turn = np.argmax(np.linalg.norm(walk.position[:, 0] - goal, axis=1) < 0.3)
    assert back[turn:].min() < 0.3
    assert walk.arrived[0] == pytest.approx(3 * way / state["pedestrian_speed"][0], rel=0.1)


def test_who_stands_in_line_steps_forward_when_the_first_has_been_served():
    line = {"head": [3, 3], "direction": 0, "count": 3, "service": [1, 1], "spacing": 0.8}
    env, state = state_of(steps=1, count=4, reactive=0, queues=[line])
    served = state["pedestrian_served_time"].min()
    walk = crowdbench.walk_ahead(state, PERIOD, nobody(9), RADIUS)
    behind = state["pedestrian_place"] > 0
    for _ in range(9):
        env.step({"robot_0": (0.0, 0.0)})
    steps = (walk.position[-1] - walk.position[0])[behind]
    assert served < state["time"] + 5 * PERIOD
    assert (np.linalg.norm(steps, axis=1) > 0.6).all()
    # Where the served one goes, whom the others evade, is not known.
    np.testing.assert_allclose(
        walk.position[-1][behind], env.state()["pedestrian_position"][behind], atol=0.3
    )


def test_robots_are_evaded_by_those_who_see_them_until_they_leave():
    _, state = state_of(count=1, reactive=1, field_of_view=180)
    place, velocity = state["pedestrian_position"][0], state["pedestrian_velocity"][0]
    ahead = velocity / np.linalg.norm(velocity)

    def walked(offset, gone=20, reactive=True):
        robots = np.tile([*(place + offset), 0.0, 0.0], (20, 1, 1))
        robots[gone:] = np.nan
        told = {**state, "pedestrian_reactive": np.array([reactive])}
        return crowdbench.walk_ahead(told, PERIOD, robots, RADIUS).position[:, 0]

    alone = walked(1.5 * ahead, gone=0)
    assert np.abs(walked(1.5 * ahead) - alone).max() > 0.05
    np.testing.assert_array_equal(walked(-1.5 * ahead), alone)
    np.testing.assert_array_equal(walked(1.5 * ahead, reactive=False), alone)
    np.testing.assert_array_equal(walked(1.5 * ahead, gone=1)[:1], alone[:1])
    assert (walked(1.5 * ahead, gone=4)[:5] == walked(1.5 * ahead)[:5]).all()
