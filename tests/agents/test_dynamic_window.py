"""The dynamic window agent: limits, admissible arcs, and what it drives past."""

import numpy as np
import pytest
from crowdbench_agents.dynamic_window import GAP, TICK, DynamicWindow, _drive, _free_time
from hypothesis import given, settings
from hypothesis import strategies as st

FAR = np.array([9.0, 0.0])
NO_POINTS, NO_DISCS = np.empty((0, 2)), np.empty((0, 5))
AT_ONCE, LIMITS = np.array([np.inf, np.inf]), np.array([1.0, 3.0])


def arc(v, w, now=(0.0, 0.0), limits=AT_ONCE):
    """Poses (24, 3) of a command after every tick."""
    poses = np.empty((24, 3))
    _drive(v, w, np.array(now), limits, poses)
    return poses


def free_time(v, points=NO_POINTS, discs=NO_DISCS, goal=FAR, growth=0.0):
    """Of the default robot that drives straight on."""
    return _free_time(arc(v, 0.0), v, goal, 0.2, 0.15, points, discs, growth)


def test_with_nothing_around_it_drives_straight_at_full_speed(world):
    path, outcome = world.drive(DynamicWindow(), goal=(4.0, 0.0))
    assert outcome == "success"
    np.testing.assert_allclose(path[:, 1], 0.0, atol=1e-6)
    np.testing.assert_allclose(np.diff(path[:, 0]), 0.2, atol=1e-6)


def test_the_free_time_towards_a_point_by_hand():
    """The front of the robot, 0.2 m ahead, comes within GAP of x = 1 m at (0.8 - GAP) / 1 s."""
    free, gap = free_time(1.0, np.array([[1.0, 0.0]]))
    assert free == pytest.approx(0.7)
    assert gap < GAP


def test_the_free_time_until_somebody_arrives_by_hand():
    """Standing still; a disc from 2 m ahead at 1 m/s: 2 - 0.25 - 0.2 - GAP = 1.49 s."""
    free, _ = free_time(0.0, discs=np.array([[2.0, 0, -1.0, 0, 0.25]]))
    assert free == pytest.approx(1.4)


def test_a_disc_that_grows_arrives_earlier_by_hand():
    """As above with 0.1 m/s more: 1.49 m / 1.1 m/s = 1.35 s."""
    discs = np.array([[2.0, 0, -1.0, 0, 0.25]])
    assert free_time(0.0, discs=discs, growth=0.1)[0] == pytest.approx(1.3)


def test_without_limits_a_command_is_driven_as_an_arc_of_its_own():
    """A quarter of a circle of 0.5 m radius takes pi / 2 s at 0.5 m/s."""
    poses = arc(0.5, 1.0)
    radii = np.hypot(poses[:, 0], poses[:, 1] - 0.5)
    np.testing.assert_allclose(radii, 0.5, atol=1e-9)
    np.testing.assert_allclose(poses[:, 2], TICK * np.arange(1, 25), atol=1e-9)


def test_with_limits_a_command_is_reached_as_fast_as_they_allow():
    """From rest at 1 m/s2: t^2 / 2, and up to a tick's way more; it turns 1.5 rad/s after 0.5 s."""
    poses = arc(1.0, 0.0, limits=LIMITS)
    assert 0.5 <= poses[9, 0] <= 0.5 + TICK
    assert poses[23, 0] - poses[13, 0] == pytest.approx(1.0)
    assert 1.5 / 4 + 0.75 <= arc(0.0, 1.5, limits=LIMITS)[9, 2] <= 1.5 / 4 + 0.75 + 1.5 * TICK


def test_an_arc_past_the_goal_is_free():
    free, _ = free_time(1.0, np.array([[1.2, 0.0]]), goal=np.array([0.5, 0.0]))
    assert free > 2.0


def test_it_passes_an_obstacle_between_walls(world):
    walls = [(-3.0, -1.2, 9.0, -1.2), (-3.0, 1.2, 9.0, 1.2)]
    path, outcome = world.drive(
        DynamicWindow(), goal=(5.0, 0.0), discs=[(2.5, -0.2, 0.35)], walls=walls
    )
    assert outcome == "success"
    assert path[:, 1].max() > 0.25


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
