"""LiDAR ranges against shapely's geometry."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.affinity import rotate, translate
from shapely.geometry import LineString, Point, box

from crowdbench import Scenario
from crowdbench.robot import lidar_angles
from crowdbench.simulation.lidar import beam_table, cast_rays, footprint_segments

NO_PEOPLE, NO_OBSTACLES, NO_WALLS = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 4))
FULL_CIRCLE = np.arange(180) * (2 * np.pi / 180)


def scan(pose, angles=FULL_CIRCLE, people=NO_PEOPLE, obstacles=NO_OBSTACLES, walls=NO_WALLS):
    out = np.empty(len(angles), np.float32)
    least = cast_rays(np.array(pose, float), beam_table(angles), people, obstacles, walls, 6.0, out)
    assert least == pytest.approx(out.min())
    return out


def reference(pose, angles, people, obstacles, walls):
    origin = Point(pose[0], pose[1])
    # A circle of 400 corners stands for the true one: it is within 2e-5 m.
    shapes = [Point(x, y).buffer(r, quad_segs=100) for x, y, r in [*people, *obstacles]]
    shapes += [LineString([wall[:2], wall[2:]]) for wall in walls]
    directions = np.column_stack([np.cos(pose[2] + angles), np.sin(pose[2] + angles)])
    ends = pose[:2] + 6.0 * directions
    rays = shapely.linestrings(np.stack([np.broadcast_to(pose[:2], ends.shape), ends], axis=1))
    hits = shapely.intersection(rays[:, None], np.array(shapes)[None])
    distances = np.where(shapely.is_empty(hits), 6.0, shapely.distance(origin, hits))
    return distances.min(axis=1)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), view=st.sampled_from([360.0, 270.0, 90.0]))
def test_ranges_equal_shapelys_in_random_scenes(seed, view):
    rng = np.random.default_rng(seed)
    pose = np.array([*rng.uniform(-1, 1, 2), rng.uniform(-4, 4)])
    people = np.column_stack([rng.uniform(-6, 6, (6, 2)), rng.uniform(0.15, 0.35, 6)])
    people = people[np.linalg.norm(people[:, :2] - pose[:2], axis=1) > 0.4]
    obstacles = np.column_stack([rng.uniform(-6, 6, (3, 2)), rng.uniform(0.2, 0.6, 3)])
    obstacles = obstacles[np.linalg.norm(obstacles[:, :2] - pose[:2], axis=1) > 0.7]
    walls = rng.uniform(-5, 5, (3, 4))
    angles = lidar_angles(Scenario(name="s", lidar={"beams": 97, "field_of_view": view}))
    expected = reference(pose, angles, people, obstacles, walls)
    found = scan(pose, angles, people, obstacles, walls)
    # A beam along a silhouette may fall on either side of it: allow none but those.
    wrong = np.abs(found - expected) > 1e-3
    grazing = reference(pose, angles + 1e-4, people, obstacles, walls)
    other = reference(pose, angles - 1e-4, people, obstacles, walls)
    assert np.all((np.abs(found - grazing) < 0.05)[wrong] | (np.abs(found - other) < 0.05)[wrong])
    assert wrong.sum() <= 1


def test_an_empty_scene_returns_the_full_range():
    assert (scan([0, 0, 1.0]) == 6.0).all()


def test_beam_zero_looks_ahead_and_beams_go_counter_clockwise():
    ahead_left = np.array([[2.0, 0.0, 0.25], [0.0, 3.0, 0.25]])
    ranges = scan([0, 0, 0], people=ahead_left)
    assert ranges[0] == pytest.approx(1.75)
    assert ranges[45] == pytest.approx(2.75)
    turned = scan([0, 0, np.pi / 2], people=ahead_left)
    assert turned[0] == pytest.approx(2.75)
    assert turned[135] == pytest.approx(1.75)


def test_walls_have_no_gap_where_they_meet():
    square = np.array([[-2, -2, 2, -2], [2, -2, 2, 2], [2, 2, -2, 2], [-2, 2, -2, -2]], dtype=float)
    angles = np.arange(360) * (2 * np.pi / 360)
    ranges = scan([0, 0, 0], angles, walls=square)
    expected = 2 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    np.testing.assert_allclose(ranges, expected, rtol=1e-6)


def test_a_sensor_inside_a_shape_reads_zero():
    assert (scan([0, 0, 0], people=np.array([[0.1, 0.0, 0.25]])) == 0).all()


@settings(deadline=None)
@given(x=st.floats(-5, 5), y=st.floats(-5, 5), heading=st.floats(-4, 4), length=st.floats(0.2, 2))
def test_footprints_are_shapelys_turned_boxes(x, y, heading, length):
    edges = footprint_segments(np.array([x, y, heading]), length, 0.3)
    expected = translate(
        rotate(box(-length / 2, -0.15, length / 2, 0.15), heading, origin=(0, 0), use_radians=True),
        x,
        y,
    )
    ring = shapely.polygonize([LineString([e[:2], e[2:]]) for e in edges.round(12)]).geoms[0]
    assert ring.symmetric_difference(expected).area < 1e-9
