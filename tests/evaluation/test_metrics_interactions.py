from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import MultiPoint, Point, Polygon

from crowdbench.evaluation.interactions import (
    clearance,
    crossing_gaps,
    cut_offs,
    hull_distance,
    time_to_collision,
)
from crowdbench.evaluation.metrics import METRICS

REACH = 0.5
PERIOD = 0.2


def gap(robot, pedestrian=(0.0, 0.0), velocity=(1.0, 0.0), reach=REACH):
    """Gap of one step of the robot, from the first place to the second."""
    position = np.array([[pedestrian], [pedestrian]], dtype=float)
    speeds = np.array([[velocity], [velocity]], dtype=float)
    return crossing_gaps(np.array(robot, dtype=float), position, speeds, PERIOD, reach)[0, 0]


# Time to collision


@pytest.mark.parametrize(
    ("offset", "velocity", "seconds"),
    [
        ([2.0, 0.0], [-1.0, 0.0], 1.5),  # head on: 1.5 m between surfaces at 1 m/s
        ([2.0, 0.0], [-3.0, 0.0], 0.5),
        ([1.3, 0.4], [-1.0, 0.0], 1.0),  # passing at 0.4 m: touch at sqrt(0.25 - 0.16) = 0.3 m
        ([2.0, 0.6], [-1.0, 0.0], math.inf),  # passing at 0.6 m
        ([2.0, 0.0], [1.0, 0.0], math.inf),  # going away
        ([2.0, 0.0], [0.0, 0.0], math.inf),  # at rest
        ([0.4, 0.0], [1.0, 0.0], 0.0),  # overlapping, even if going apart
    ],
)
def test_time_to_collision_by_hand(offset, velocity, seconds):
    assert time_to_collision(np.array(offset), np.array(velocity), REACH) == pytest.approx(seconds)


@settings(max_examples=300, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_discs_touch_at_the_time_to_collision_and_not_before(seed):
    rng = np.random.default_rng(seed)
    offset, velocity = rng.uniform(-3, 3, 2), rng.uniform(-2, 2, 2)
    time = float(time_to_collision(offset, velocity, REACH))
    until = np.linspace(0, min(time, 20.0), 2001)
    distance = np.linalg.norm(offset + until[:, None] * velocity, axis=1)
    if time == 0:
        assert distance[0] <= REACH
        return
    assert np.all(distance > REACH - 1e-9)
    if math.isfinite(time):
        assert np.linalg.norm(offset + time * velocity) == pytest.approx(REACH)


# Clearance


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_clearance_is_the_distance_between_the_shapes(seed):
    rng = np.random.default_rng(seed)
    x, y, heading = pose = rng.uniform(-2, 2, 3)
    length, width = rng.uniform(0.1, 1.5, 2)
    people = rng.uniform(-3, 3, (5, 2))
    ahead, left = (
        np.array([np.cos(heading), np.sin(heading)]),
        np.array([-np.sin(heading), np.cos(heading)]),
    )
    corners = [
        (x, y) + sx * length / 2 * ahead + sy * width / 2 * left
        for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ]
    expected = [max(Polygon(corners).distance(Point(p)) - 0.25, 0.0) for p in people]
    measured = clearance(pose[None], (length, width), people[None], np.full(len(people), 0.25))[0]
    assert measured == pytest.approx(np.array(expected))


# Cut-offs


def test_the_gap_is_what_the_pedestrian_still_has_to_walk_when_the_robot_crosses():
    # Half a step after it began the pedestrian is at 0.1 m, the robot at 2 m; 0.5 m are bodies.
    assert gap([[2.0, -0.1], [2.0, 0.1]]) == pytest.approx(2.0 - 0.1 - 0.5)


def test_a_slower_pedestrian_leaves_a_longer_gap():
    assert gap([[2.0, -0.1], [2.0, 0.1]], velocity=(0.5, 0.0)) == pytest.approx(1.45 / 0.5)


def test_the_crossing_is_where_the_paths_meet():
    # The robot meets the path a quarter into its step, at x = 2.1.
    assert gap([[2.0, -0.1], [2.4, 0.3]]) == pytest.approx(2.1 - 0.05 - 0.5)


def test_a_crossing_within_reach_has_no_gap():
    assert gap([[0.3, -0.1], [0.3, 0.1]]) == 0.0


@pytest.mark.parametrize(
    ("robot", "velocity"),
    [
        ([[-1.0, -0.1], [-1.0, 0.1]], (1.0, 0.0)),  # behind
        ([[0.05, -0.1], [0.05, 0.1]], (1.0, 0.0)),  # ahead at first, passed when it crosses
        ([[2.0, -0.3], [2.0, -0.1]], (1.0, 0.0)),  # not there yet
        ([[2.0, 0.1], [2.0, 0.3]], (1.0, 0.0)),  # across already
        ([[2.0, -0.1], [2.0, 0.1]], (0.09, 0.0)),  # the pedestrian stands
        ([[2.0, 0.1], [2.0, 0.1]], (1.0, 0.0)),  # the robot stands
    ],
)
def test_what_is_no_crossing(robot, velocity):
    assert gap(robot, velocity=velocity) == math.inf


def test_a_pedestrian_that_turns_does_not_sweep_its_path_over_the_robot():
    robot = np.tile([2.0, 0.1], (3, 1))
    velocity = np.array([[[1.0, 0.0]], [[1.0, 0.1]], [[1.0, 0.3]]])
    gaps = crossing_gaps(robot, np.zeros((3, 1, 2)), velocity, PERIOD, REACH)
    assert np.all(np.isinf(gaps))


def test_the_path_is_the_one_walked_before_the_pedestrian_gave_way():
    robot = np.array([[2.0, -0.1], [2.0, 0.1]])
    velocity = np.array([[[1.0, 0.0]], [[0.0, -1.0]]])
    gaps = crossing_gaps(robot, np.zeros((2, 1, 2)), velocity, PERIOD, REACH)
    assert gaps[0, 0] == pytest.approx(1.4)


def test_a_state_exactly_on_the_path_is_one_crossing():
    robot = np.array([[2.0, -0.1], [2.0, 0.0], [2.0, 0.1]])
    position, velocity = np.zeros((3, 1, 2)), np.tile([1.0, 0.0], (3, 1, 1))
    gaps = crossing_gaps(robot, position, velocity, PERIOD, REACH)
    assert np.count_nonzero(np.isfinite(gaps)) == 1


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_gaps_agree_with_a_fine_simulation_of_the_step(seed):
    rng = np.random.default_rng(seed)
    robot, person = rng.uniform(-1, 1, (2, 2)), rng.uniform(-2, 2, 2)
    velocity = rng.uniform(-1, 1, 2)
    measured = gap(robot, person, velocity)
    # Complex numbers, in a frame that walks along with the pedestrian, its path ahead real.
    time = np.linspace(0, 1, 20_001)
    heading = complex(*velocity)
    track = complex(*robot[0]) + time * complex(*(robot[1] - robot[0]))
    relative = (track - complex(*person) - heading * time * PERIOD) * heading.conjugate()
    relative /= abs(heading)
    change = np.flatnonzero(relative.imag[:-1] * relative.imag[1:] < 0)
    place = relative.real[change[0]] if len(change) else -1.0
    expected = max(place - REACH, 0.0) / abs(heading) if place > 0 else math.inf
    if abs(heading) < 0.1:
        expected = math.inf
    if abs(place) > 1e-3:  # not decided by the last digit
        assert measured == pytest.approx(expected, abs=2e-3)


def test_crossings_of_one_pedestrian_within_a_second_are_one_event():
    gaps = np.full((20, 2), np.inf)
    gaps[[2, 6, 7, 11, 12], 0] = 0.5  # events at 2, 7 (1.0 s later) and 12
    gaps[3, 1] = 1.9
    gaps[10, 1] = 2.0  # not below the limit
    assert len(cut_offs(gaps, PERIOD)) == 4


@pytest.mark.parametrize("period", [0.1, 0.2, 0.25, 0.3])
def test_an_event_may_follow_after_a_second_at_any_period(period):
    later = math.ceil(1.0 / period)
    gaps = np.full((later + 1, 1), np.inf)
    gaps[[0, later]] = 0.0
    assert len(cut_offs(gaps, period)) == 2
    assert len(cut_offs(gaps[[0, *range(2, later + 1)]], period)) == 1


def test_a_robot_that_drives_across_in_front_of_someone_cuts_them_off_once(make_episode):
    steps = np.arange(11)
    poses = np.stack([np.full(11, 2.5), -1.05 + 0.2 * steps, np.full(11, np.pi / 2)], axis=1)
    walk = np.stack([0.2 * steps, np.zeros(11)], axis=1)[:, None]
    velocity = np.tile([1.0, 0.0], (11, 1, 1))
    crossing = make_episode(poses, np.tile([1.0, 0.0], (10, 1)), walk, velocity)
    # At the crossing, after 1.05 s, the pedestrian is at 1.05 m: 2.5 - 1.05 - 0.5 = 0.95 s.
    assert METRICS["cutoff"].function(crossing) == 1.0
    behind = make_episode(poses - [2.0, 0, 0], np.tile([1.0, 0.0], (10, 1)), walk, velocity)
    assert METRICS["cutoff"].function(behind) == 0.0
    far = make_episode(poses + [1.2, 0, 0], np.tile([1.0, 0.0], (10, 1)), walk, velocity)
    assert METRICS["cutoff"].function(far) == 0.0


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 6))
def test_the_distance_to_a_hull_is_shapelys(seed, count):
    rng = np.random.default_rng(seed)
    robot, people = rng.uniform(-2, 2, (5, 2)), rng.uniform(-2, 2, (5, count, 2))
    expected = [
        MultiPoint(around).convex_hull.distance(Point(place))
        for place, around in zip(robot, people, strict=True)
    ]
    np.testing.assert_allclose(hull_distance(robot, people), expected, atol=1e-9)
