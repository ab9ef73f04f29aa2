"""Clusters of a scan against scenes whose discs and walls are known."""

import numpy as np
import pytest
import shapely
from crowdbench_agents.geometry.clusters import Tracker
from crowdbench_agents.geometry.footprint import advance, arc_gap, point_gap, wall_gap
from crowdbench_agents.geometry.scan import ScanGeometry
from hypothesis import example, given, settings
from hypothesis import strategies as st


def test_a_disc_is_found_where_it_is(world):
    discs = np.array([[2.0, 0.5, 0.25], [-1.0, -1.5, 0.4], [0.3, 3.0, 0.3]])
    scene = Tracker(world.spec).update(world.observe((0.1, -0.2, 0.7), discs))
    found = scene.discs[np.argsort(scene.discs[:, 0])][:, [0, 1, 4]]
    np.testing.assert_allclose(found, discs[np.argsort(discs[:, 0])], atol=2e-3)
    assert len(scene.segments) == 0


def test_a_moving_disc_has_its_velocity_though_the_robot_moves_too(world):
    tracker = Tracker(world.spec)
    for k in range(8):
        t = k * world.spec.control_period
        pose = advance(0.0, 0.0, 0.3, 0.8, 0.6, t)
        discs = [(2.5 - 0.7 * t, 1.0 + 0.4 * t, 0.25), (1.5, -1.2, 0.35)]
        scene = tracker.update(world.observe(pose, discs))
    walking, standing = scene.discs[np.argsort(-scene.discs[:, 1])]
    np.testing.assert_allclose(walking[2:4], [-0.7, 0.4], atol=0.05)
    np.testing.assert_allclose(standing[2:4], 0.0, atol=0.02)
    np.testing.assert_array_equal(np.sort(scene.moving), [False, True])


def test_a_hidden_disc_is_remembered_for_a_while_and_then_forgotten(world):
    tracker, nothing = Tracker(world.spec), ()
    for k in range(4):
        tracker.update(world.observe((0, 0, 0), [(2.0, 0.1 * k, 0.25)]))
    assert len(tracker.update(world.observe((0, 0, 0), nothing)).discs) == 1
    for _ in range(10):
        scene = tracker.update(world.observe((0, 0, 0), nothing))
    assert len(scene.discs) == 0


def test_walls_are_segments_and_do_not_move(world):
    walls = [(-9.0, -2.0, 9.0, -2.0), (-9.0, 2.0, 9.0, 2.0)]
    tracker = Tracker(world.spec)
    for k in range(5):
        scene = tracker.update(world.observe((0.2 * k, 0.3, 0.1), (), walls))
    assert len(scene.segments) > 20
    np.testing.assert_allclose(np.abs(scene.segments[:, [1, 3]]), 2.0, atol=1e-3)
    assert not scene.moving.any()


def test_the_scan_without_moving_discs_keeps_what_stands(world):
    tracker = Tracker(world.spec)
    for k in range(5):
        seen = world.observe((0, 0, 0), [(2.0, 0.1 * k, 0.25), (-2.0, 0.0, 0.3)])
        scene = tracker.update(seen)
    np.testing.assert_allclose(
        tracker.without_moving(seen, scene), world.scan((0, 0, 0), [(-2.0, 0.0, 0.3)]), atol=1e-5
    )


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
@example(308664)  # a wall that ends just outside, beside a corner
def test_gaps_of_the_footprint_equal_shapely(seed):
    rng = np.random.default_rng(seed)
    x, y, heading = rng.uniform(-1, 1, 3) * [1, 1, np.pi]
    half_length, half_width = rng.uniform(0.1, 0.5, 2)
    c, s = np.cos(heading), np.sin(heading)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [half_length, half_width]
    robot = shapely.Polygon(corners @ np.array([[c, s], [-s, c]]) + [x, y])
    point = rng.uniform(-2, 2, 2)
    gap = point_gap(x, y, c, s, half_length, half_width, *point)
    outside = robot.distance(shapely.Point(point))
    inside = robot.exterior.distance(shapely.Point(point))
    assert gap == pytest.approx(outside if outside > 0 else -inside, abs=1e-9)
    wall = rng.uniform(-2, 2, 4)
    segment = shapely.LineString(wall.reshape(2, 2))
    gap = wall_gap(x, y, c, s, half_length, half_width, wall)
    if robot.intersects(segment):
        assert gap < 0
    else:
        assert gap == pytest.approx(robot.distance(segment), abs=1e-9)


def test_an_arc_is_as_free_as_its_nearest_point(world):
    lidar = world.scan((0, 0, 0), [(1.0, 0.0, 0.25)]).astype(float)
    points = ScanGeometry(world.spec).points(lidar)
    gap = arc_gap(0.5, 0.0, 0.4, 4, 0.2, 0.15, points)
    assert gap == pytest.approx(0.75 - 0.2 - 0.2, abs=1e-6)
