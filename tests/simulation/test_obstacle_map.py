"""The obstacle map against a brute-force reference in plain numpy."""

from dataclasses import replace

import numpy as np
import pytest
from crowdbench_agents.learning.inputs import reflect
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench import MapGeometry, ObstacleMap, ObstacleMaps, RobotSpec, Scenario

FRAMES = ObstacleMaps.FRAMES
RANGE = 6.0
ROBOT = RobotSpec.from_scenario(Scenario(name="test"))
ANGLES = ROBOT.lidar_angles


def scan(pose, circles):
    """(beams,) distances to circles (K, 3) by solving each ray's quadratic."""
    directions = np.stack([np.cos(ANGLES + pose[2]), np.sin(ANGLES + pose[2])], axis=-1)
    distances = np.full(len(ANGLES), RANGE)
    for x, y, radius in circles:
        offset = np.array([x, y]) - pose[:2]
        along = directions @ offset
        discriminant = along**2 - offset @ offset + radius**2
        hit = (discriminant >= 0) & (along > 0)
        first = along - np.sqrt(np.where(hit, discriminant, 0.0))
        distances = np.where(hit & (first > 0), np.minimum(distances, first), distances)
    return distances.astype(np.float32)


def brute_force(scans, poses, geometry):
    """The map from homogeneous transforms, one frame and one beam at a time."""
    result = np.zeros((geometry.cells, geometry.cells), np.uint8)
    for age, (distances, pose) in enumerate(zip(scans[::-1][:8], poses[::-1][:8], strict=True)):
        then, now = transform(pose), transform(poses[-1])
        for angle, distance in zip(ANGLES, distances, strict=True):
            if distance >= RANGE - 1e-3:
                continue
            local = np.array([distance * np.cos(angle), distance * np.sin(angle), 1.0])
            x, y, _ = np.linalg.inv(now) @ then @ local
            i = int(np.floor((x - geometry.origin[0]) / geometry.cell))
            j = int(np.floor((y - geometry.origin[1]) / geometry.cell))
            if 0 <= i < geometry.cells and 0 <= j < geometry.cells:
                result[i, j] |= 1 << age
    return result


def transform(pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0, 0, 1]], dtype=np.float64)


def drive(rng, steps):
    """Poses (steps, 3) of a robot that wanders with control period 0.2 s."""
    poses = [np.zeros(3)]
    for _ in range(steps - 1):
        v, w = rng.uniform(0, 1), rng.uniform(-1.5, 1.5)
        x, y, heading = poses[-1]
        step = np.array([0.2 * v * np.cos(heading), 0.2 * v * np.sin(heading), 0.2 * w])
        poses.append(np.array([x, y, heading]) + step)
    return np.array(poses, np.float32)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
def test_map_equals_brute_force(seed, steps):
    rng = np.random.default_rng(seed)
    geometry = MapGeometry()
    circles = np.column_stack([rng.uniform(-5, 5, (6, 2)), rng.uniform(0.2, 0.5, 6)])
    poses = drive(rng, steps)
    scans = [scan(pose, circles) for pose in poses]
    obstacle_map = ObstacleMap(ROBOT)
    for distances, pose in zip(scans, poses, strict=True):
        drawn = obstacle_map.update(distances, pose)
    differing = np.count_nonzero(drawn != brute_force(scans, poses, geometry))
    # A point within rounding of a cell's edge may fall to either side.
    assert differing <= 4


def test_frames_of_a_static_world_coincide_within_a_cell():
    rng = np.random.default_rng(1)
    circles = np.array([[2.0, 0.5, 0.4], [1.0, -1.5, 0.3], [-1.0, 2.0, 0.5], [3.5, 1.5, 0.5]])
    obstacle_map = ObstacleMap(ROBOT)
    for pose in drive(rng, FRAMES):
        bits = obstacle_map.update(scan(pose, circles), pose)
    seen = [np.argwhere(bits & (1 << age)) for age in range(FRAMES)]
    now = transform(pose)
    centres = (np.linalg.inv(now) @ np.column_stack([circles[:, :2], np.ones(4)]).T)[:2].T
    geometry = obstacle_map.geometry
    for cells in seen:
        assert len(cells) > 0
        points = (cells + 0.5) * geometry.cell + np.array(geometry.origin)
        surface = np.abs(np.linalg.norm(points[:, None] - centres, axis=-1) - circles[:, 2])
        assert surface.min(axis=1).max() <= geometry.cell


def test_a_moving_disc_leaves_a_trail_in_the_order_of_time():
    obstacle_map = ObstacleMap(ROBOT)
    for step in range(FRAMES):
        circle = np.array([[2.0, -1.4 + 0.4 * step, 0.2]])
        bits = obstacle_map.update(scan(np.zeros(3), circle), np.zeros(3, np.float32))
    sideways = [np.argwhere(bits & (1 << age))[:, 1].mean() for age in range(FRAMES)]
    assert np.all(np.diff(sideways) < 0)  # older frames lie further right, where it came from


def test_beams_without_a_return_draw_nothing():
    obstacle_map = ObstacleMap(replace(ROBOT, lidar_range=2.0))
    assert not obstacle_map.update(np.full(180, 2.0, np.float32), np.zeros(3, np.float32)).any()


def three_beams(**changes):
    """A robot with beams to its right, ahead and to its left."""
    return replace(ROBOT, lidar_angles=np.array([-np.pi / 2, 0.0, np.pi / 2]), **changes)


def test_beams_begin_where_the_lidar_is_mounted():
    obstacle_map = ObstacleMap(three_beams(lidar_mount=(0.15, -0.1, 0.0)))
    pose = np.array([3.0, 1.0, np.pi / 2], np.float32)
    bits = obstacle_map.update(np.array([1.01, 2.01, RANGE], np.float32), pose)
    cells = {tuple(cell) for cell in np.argwhere(bits)}
    # 8 cells per metre: (2 + 0.15, 3 - 0.1 - 1.01) and (2 + 0.15 + 2.01, 3 - 0.1) metres.
    assert cells == {(17, 15), (33, 23)}


def test_a_map_is_drawn_around_another_place_than_the_scan_was_taken_at():
    obstacle_map = ObstacleMap(three_beams())
    pose, ahead = np.array([3.0, 1.0, 0.0]), np.array([3.45, 0.98, np.pi / 2])
    bits = obstacle_map.update(np.array([1.01, 2.01, RANGE], np.float32), pose, ahead)
    cells = {tuple(cell) for cell in np.argwhere(bits)}
    # Facing left from there, the points are at (-0.99, 0.45) and (0.02, -1.56) metres; 8 cells per
    # metre from the corner at (-2, -3).
    assert cells == {(8, 27), (16, 11)}


def test_beams_are_drawn_where_the_sensor_points():
    obstacle_map = ObstacleMap(three_beams())
    bits = obstacle_map.update(np.array([1.01, 2.01, RANGE], np.float32), np.zeros(3, np.float32))
    cells = {tuple(cell) for cell in np.argwhere(bits)}
    # 8 cells per metre; the robot is at (2 m, 3 m) from the rear right corner.
    assert cells == {(16, 15), (32, 24)}


def test_reset_forgets_and_maps_of_several_robots_do_not_mix():
    scans = np.full((2, 180), RANGE, np.float32)
    scans[0, 0] = 1.0
    maps = ObstacleMaps(2, ROBOT)
    poses = np.zeros((2, 3), np.float32)
    first = maps.update(scans, poses)
    assert first[0].any()
    assert not first[1].any()
    maps.reset(0)
    scans[0, 0] = RANGE
    assert not maps.update(scans, poses).any()


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.5])
def test_reflection_is_the_map_of_the_reflected_world(heading):
    circles = np.array([[2.0, 0.9, 0.4], [1.0, -1.5, 0.3]])
    pose = np.array([0.0, 0.0, heading], np.float32)
    mirror = np.array([1, -1, -1], np.float32)
    straight = ObstacleMap(ROBOT).update(scan(pose, circles), pose)
    mirrored_world = circles * np.array([1, -1, 1])
    mirrored = ObstacleMap(ROBOT).update(scan(pose * mirror, mirrored_world), pose * mirror)
    assert np.count_nonzero(reflect(straight) != mirrored) <= 2  # beams on a cell's edge
