"""The dynamic window agent: limits, admissible arcs, and what it drives past."""

from dataclasses import replace

import numpy as np
import pytest
from crowdbench_agents.dynamic_window import GAP, DynamicWindow, _free_time
from hypothesis import given, settings
from hypothesis import strategies as st

FAR = np.array([9.0, 0.0])
NO_POINTS, NO_DISCS = np.empty((0, 2)), np.empty((0, 5))


def test_with_nothing_around_it_drives_straight_at_full_speed(world):
    path, outcome = world.drive(DynamicWindow(), goal=(4.0, 0.0))
    assert outcome == "success"
    np.testing.assert_allclose(path[:, 1], 0.0, atol=1e-6)
    np.testing.assert_allclose(np.diff(path[:, 0]), 0.2, atol=1e-6)


def test_the_free_time_towards_a_point_by_hand():
    """The front of the robot, 0.2 m ahead, comes within GAP of x = 1 m at (0.8 - GAP) / 1 s."""
    free, gap = _free_time(1.0, 0.0, FAR, 0.2, 0.15, np.array([[1.0, 0.0]]), NO_DISCS)
    assert free == pytest.approx(0.7)
    assert gap < GAP


def test_the_free_time_until_somebody_arrives_by_hand():
    """Standing still; a disc from 2 m ahead at 1 m/s: 2 - 0.25 - 0.2 - GAP = 1.49 s."""
    free, _ = _free_time(0.0, 0.0, FAR, 0.2, 0.15, NO_POINTS, np.array([[2.0, 0, -1.0, 0, 0.25]]))
    assert free == pytest.approx(1.4)


def test_an_arc_past_the_goal_is_free():
    goal = np.array([0.5, 0.0])
    free, _ = _free_time(1.0, 0.0, goal, 0.2, 0.15, np.array([[1.2, 0.0]]), NO_DISCS)
    assert free > 2.0


@pytest.mark.parametrize("offset", [-0.2, 0.1, 0.3])
def test_it_evades_somebody_who_does_not(world, offset):
    walker = {"discs": [(5.0, offset, 0.25)], "velocities": [(-0.8, 0.0)]}
    path, outcome = world.drive(DynamicWindow(), goal=(5.0, 0.0), **walker)
    assert outcome == "success"
    assert np.abs(path[:, 1]).max() > 0.1


def test_it_passes_an_obstacle_between_walls(world):
    walls = [(-3.0, -1.2, 9.0, -1.2), (-3.0, 1.2, 9.0, 1.2)]
    path, outcome = world.drive(
        DynamicWindow(), goal=(5.0, 0.0), discs=[(2.5, -0.2, 0.35)], walls=walls
    )
    assert outcome == "success"
    assert path[:, 1].max() > 0.25


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_commands_stay_in_the_window_that_acceleration_permits(world, seed):
    limited = replace(world.spec, acceleration=(0.5, 2.0))
    agent = DynamicWindow()
    agent.reset(limited, 0)
    seen = world.random_observation(np.random.default_rng(seed))
    v, w = agent.act(seen)
    assert abs(v - seen.velocity[0]) <= 0.5 * 0.2 + 1e-6
    assert abs(w - seen.velocity[1]) <= 2.0 * 0.2 + 1e-6


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_mirrored_world_is_answered_with_the_mirrored_action(world, seed):
    seen = world.random_observation(np.random.default_rng(seed))
    actions = []
    for observation in (seen, world.mirrored(seen)):
        agent = DynamicWindow()
        agent.reset(world.spec, 0)
        actions.append(agent.act(observation))
    np.testing.assert_allclose(actions[1], np.array(actions[0]) * [1, -1], atol=1e-6)


def test_weights_decide(world):
    """With heading alone it turns on the spot; the weight of speed makes it drive."""
    seen = world.observe((0, 0, 0), (), goal=(0.0, 3.0))
    speeds = []
    for weight in (0.0, 3.0):
        agent = DynamicWindow(heading=1.0, clearance=0.0, speed=weight)
        agent.reset(world.spec, 0)
        speeds.append(agent.act(seen)[0])
    assert speeds[0] < 0.2 < speeds[1]
