"""Gaps along a motion, against shapely."""

from fractions import Fraction

import numpy as np
import pytest
import shapely
from crowdbench_agents.geometry.footprint import arc_gap, line_gap, turned
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.affinity import rotate, translate

LENGTH, WIDTH, PERIOD, CHECKS, REACH = 0.4, 0.3, 0.2, 4, 6.0
ANGLES = np.arange(60) * (2 * np.pi / 60)
BOX = shapely.box(-LENGTH / 2, -WIDTH / 2, LENGTH / 2, WIDTH / 2)


def pose_on_arc(v, w, time):
    """Closed form of the arc from the origin."""
    if abs(w) < 1e-6:
        return v * time, 0.0, w * time
    return v / w * np.sin(w * time), v / w * (1 - np.cos(w * time)), w * time


def pose_on_line(ahead, left, time):
    return ahead * time, left * time, 0.0


@pytest.mark.parametrize(("gap", "pose"), [(arc_gap, pose_on_arc), (line_gap, pose_on_line)])
@settings(deadline=None, max_examples=30)
@given(first=st.floats(-1, 1), second=st.floats(-1, 1), seed=st.integers(0, 2**32 - 1))
def test_the_gap_is_the_least_over_the_checked_poses(gap, pose, first, second, seed):
    lidar = np.random.default_rng(seed).uniform(0.5, 1.1 * REACH, len(ANGLES)).clip(max=REACH)
    hit = lidar < REACH
    ends = lidar[hit, None] * np.column_stack([np.cos(ANGLES[hit]), np.sin(ANGLES[hit])])
    found = gap(first, second, PERIOD, CHECKS, LENGTH / 2, WIDTH / 2, ends)
    points = shapely.points(ends)
    expected = np.inf
    for check in range(1, CHECKS + 1):
        x, y, heading = pose(first, second, PERIOD * check / CHECKS)
        robot = translate(rotate(BOX, heading, origin=(0, 0), use_radians=True), x, y)
        expected = min(expected, shapely.distance(robot, points).min(initial=np.inf))
    assert found == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("gap", [arc_gap, line_gap])
def test_where_nothing_is_there_is_no_gap(gap):
    nothing = np.empty((0, 2))
    assert gap(1.0, 0.5, PERIOD, CHECKS, LENGTH / 2, WIDTH / 2, nothing) == np.inf


def test_vectors_are_turned_alone_as_among_others_and_rounded_twice():
    vectors = np.random.default_rng(0).uniform(-6, 6, (50, 2))
    cosine, sine = np.cos(0.7), np.sin(0.7)
    together = turned(vectors, cosine, sine)
    alone = [turned(one[None], cosine, sine)[0] for one in vectors]
    np.testing.assert_array_equal(together, alone)
    for (x, y), (ahead, aside) in zip(vectors, together, strict=True):
        assert ahead == float(Fraction(x * cosine) + Fraction(y) * Fraction(sine))
        assert aside == float(Fraction(x * -sine) + Fraction(y) * Fraction(cosine))
    assert turned(np.empty((0, 2)), cosine, sine).shape == (0, 2)
