from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import GOAL, RADIUS, START, grid_search, is_free, random_scene

from crowdbench.evaluation.shortest_path import shortest_route
from crowdbench.simulation.ways import Ways, next_point

LARGER = math.tan(math.pi / 8) / (math.pi / 8)
"""A polygon of eight corners is this much longer than the circle inside."""


def ways(walls=(), obstacles=()):
    return Ways(
        np.array(walls, dtype=float).reshape(-1, 4),
        np.array(obstacles, dtype=float).reshape(-1, 3),
        RADIUS,
    )


def length_of(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()


def test_nothing_in_the_way_is_a_straight_line():
    assert ways().path(START, GOAL).tolist() == [START.tolist(), GOAL.tolist()]
    assert ways().length(START, GOAL) == 4.0
    assert ways().path(START, START).tolist() == [START.tolist()]


def test_a_wall_that_is_touched_is_not_in_the_way():
    assert ways([[1.0, -RADIUS, 3.0, -RADIUS]]).length(START, GOAL) == 4.0


def test_around_the_end_of_a_wall_the_way_touches_the_clearance_at_the_end():
    # Symmetric about the wall; the arc's polygon touches it straight above the end, at height
    # RADIUS, with a corner RADIUS tan(22.5 deg) to either side.
    corner = RADIUS * math.tan(math.pi / 8)
    path = ways([[2.0, -3.0, 2.0, 1.0]]).path(START, GOAL)
    expected = [[0, 0], [2 - corner, 1 + RADIUS], [2 + corner, 1 + RADIUS], [4, 0]]
    assert path == pytest.approx(np.array(expected), abs=1e-12)


def test_around_the_corner_of_a_block_there_are_two_way_points():
    block = [[1, -9, 1, -1], [1, -1, 3, -1], [3, -1, 3, -9]]
    path = ways(block).path(np.array([0.5, -2.0]), np.array([3.5, -2.0]))
    corner = RADIUS * math.tan(math.pi / 8)
    expected = [
        [0.5, -2],
        [1 - RADIUS, -1 + corner],
        [1 - corner, -1 + RADIUS],
        [3 + corner, -1 + RADIUS],
        [3 + RADIUS, -1 + corner],
        [3.5, -2],
    ]
    assert path == pytest.approx(np.array(expected), abs=1e-12)


def test_a_gap_as_wide_as_the_disc_is_passed_and_a_narrower_one_is_not():
    def gap(half):
        return ways([[2.0, -9.0, 2.0, -half], [2.0, half, 2.0, 9.0]])

    assert gap(RADIUS).length(START, GOAL) == 4.0
    assert gap(RADIUS - 0.01).length(START, GOAL) > 18.0


def test_where_there_is_no_way_the_path_is_empty():
    box = ways([[-1, -1, 1, -1], [1, -1, 1, 1], [1, 1, -1, 1], [-1, 1, -1, -1]])
    assert box.path(START, GOAL).shape == (0, 2)
    assert box.length(START, GOAL) == math.inf
    assert box.length(START, np.array([0.5, 0.5])) == pytest.approx(math.sqrt(0.5))


def test_many_ways_from_one_place_begin_as_each_of_them_does():
    shut = [[0, 3, 2, 3], [2, 3, 2, 5], [2, 5, 0, 5], [0, 5, 0, 3]]
    some = ways([[2.0, -3.0, 2.0, 1.0], *shut])
    goals = np.array([GOAL, [1.0, 0.5], [3.0, -1.0], [1.0, 4.0]])
    remaining = np.array([some.remaining(goal) for goal in goals])
    found = some.next_points(START, goals, remaining)
    for goal, (x, y, length) in zip(goals[:3], found[:3], strict=True):
        path = some.path(START, goal)
        assert [x, y] == path[1].tolist()
        assert length == pytest.approx(length_of(path))
    assert found[3].tolist() == [1.0, 4.0, math.inf], "nobody gets in there"


def test_a_way_does_not_leave_the_bounds():
    wall = np.array([[2.0, -3.0, 2.0, 1.0]])
    closed = Ways(wall, np.empty((0, 3)), RADIUS, bounds=(-1, -5, 5, 1))
    assert closed.length(START, GOAL) > 6.0  # around the lower end
    assert closed.path(START, GOAL)[:, 1].min() == pytest.approx(-3 - RADIUS)


def test_a_wall_that_ends_on_another_has_no_way_points_behind_it():
    post = [[0.0, 0.0, 0.0, 3.0], [-9.0, 0.0, 9.0, 0.0]]
    points = ways(post).network.nodes
    assert (points[:, 1] < 0).sum() == 4  # halves of both ends of the long wall, nothing below it
    assert sorted(points[points[:, 1] > 1, 1].round(3)) == [3.062, 3.062, 3.15, 3.15]
    assert len(points) == 12


def test_an_end_nearer_than_the_clearance_is_left_and_reached_without_coming_nearer():
    wall = ways([[-1.0, 0.0, 1.0, 0.0]])
    near, far = np.array([0.0, 0.05]), np.array([3.0, 0.05])
    assert wall.path(near, far).tolist() == [near.tolist(), far.tolist()]
    assert wall.path(far, near).tolist() == [far.tolist(), near.tolist()]
    behind = wall.path(near, np.array([0.0, -0.05]))
    assert length_of(behind) > 2.0


@pytest.mark.parametrize("seed", range(30))
def test_a_way_is_free_and_hardly_longer_than_the_exact_one(seed):
    walls, discs = random_scene(seed)
    found = ways(walls, discs)
    path, exact = found.path(START, GOAL), shortest_route(START, GOAL, walls, discs, RADIUS)
    assert path[0].tolist() == START.tolist() and path[-1].tolist() == GOAL.tolist()
    share = np.linspace(0, 1, 50)[:, None, None]
    along = (1 - share) * path[:-1] + share * path[1:]
    assert is_free(along, walls, discs, clearance=RADIUS - 1e-6).all()
    assert length_of(path) == pytest.approx(found.length(START, GOAL), abs=1e-12)
    arcs = exact.turning * (RADIUS + 0.4)
    assert exact.length - 1e-9 <= length_of(path) <= exact.length + (LARGER - 1) * arcs + 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_a_search_on_a_fine_grid_finds_no_shorter_way(seed):
    walls, discs = random_scene(seed)
    grid = grid_search(walls, discs)
    assert grid / 1.015 - 0.03 <= ways(walls, discs).length(START, GOAL) <= grid * LARGER


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_way_point_after_way_point_the_goal_comes_nearer_by_what_was_walked(seed):
    walls, discs = random_scene(seed)
    found = ways(walls, discs)
    fixed = found.remaining(GOAL), found.network
    x, y, left = *START, found.length(START, GOAL)
    while (x, y) != tuple(GOAL):
        to_x, to_y, length = next_point(x, y, *GOAL, *fixed)
        assert length == pytest.approx(left, abs=1e-9)
        # Halfway to the next point the rest is what it was, less that half.
        half = (x + to_x) / 2, (y + to_y) / 2
        walked = math.hypot(to_x - x, to_y - y)
        assert next_point(*half, *GOAL, *fixed)[2] <= left - walked / 2 + 1e-9
        x, y, left = to_x, to_y, left - walked


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_off_the_way_nobody_is_led_through_an_opening_that_is_too_narrow(seed):
    rng, narrowest, side = np.random.default_rng(seed), 0.3, 3.0
    ends = rng.uniform(-side, side, (rng.integers(3, 14), 2))
    walls = np.hstack([ends, ends + rng.normal(0, 1, ends.shape)])
    found = Ways(walls, np.empty((0, 3)), 0.35, (-side, -side, side, side), narrowest)
    lines = shapely.linestrings(walls.reshape(-1, 2, 2))
    taken = shapely.union_all(shapely.buffer(lines, narrowest / 2 - 1e-6, quad_segs=64))
    free = shapely.box(-4 * side, -4 * side, 4 * side, 4 * side).difference(taken)
    shapely.prepare(parts := shapely.get_parts(free))
    for place, goal in rng.uniform(-side, side, (40, 2, 2)):
        around = parts[shapely.contains_xy(parts, *place)]
        path = found.path(place, goal) if found.is_free(goal) else []
        if len(around) and len(path):
            assert around[0].distance(shapely.Point(path[1])) < 1e-5


def test_a_slit_is_squeezed_through_only_by_who_is_narrower():
    slit, sides = [[0, -5, 0, 0], [0, 0.12, 0, 5]], [[-1.5, -0.25, 0, -0.25], [-1.5, 0.37, 0, 0.37]]
    walls = np.array([*slit, *sides], dtype=np.float64)
    behind, beyond = np.array([-0.36, -0.03]), np.array([4.0, 0.0])
    lengths = {
        narrowest: Ways(walls, np.empty((0, 3)), 0.35, None, narrowest).length(behind, beyond)
        for narrowest in (0.0, 0.1, 0.13, 0.3)
    }
    assert lengths[0.0] == lengths[0.1] < 5.0
    assert lengths[0.13] == lengths[0.3] > 10.0
