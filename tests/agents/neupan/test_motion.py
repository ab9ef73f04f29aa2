"""Point velocities from scans: circles are found, followed, and told from walls."""

import numpy as np
import pytest
from crowdbench_agents.neupan.motion import RING_POINTS, Tracker

from crowdbench.simulation.lidar import beam_table, cast_rays

ANGLES = np.arange(180) * (2 * np.pi / 180)
RANGE, PERIOD = 6.0, 0.2
NOTHING = np.empty((0, 4))


def scan(pose, bodies=(), walls=NOTHING, radius=0.25, angles=ANGLES):
    out = np.empty(len(angles), dtype=np.float32)
    discs = np.array([[*body, radius] for body in bodies], float).reshape(-1, 3)
    cast_rays(
        np.array(pose, dtype=float), beam_table(angles), np.empty((0, 3)), discs,
        np.array(walls, float), RANGE, out,
    )  # fmt: skip
    return out


def moving_points(points, velocity):
    return points[np.linalg.norm(velocity, axis=1) > 0]


@pytest.mark.parametrize("radius", [0.2, 0.25, 0.4])
def test_a_walker_is_followed_by_a_turning_driving_robot(radius):
    tracker = Tracker(ANGLES, RANGE, PERIOD)
    velocity = np.array([-0.3, 0.8])
    for k in range(6):
        pose = np.array([0.1 * k, 0.02 * k, 0.2 * k])
        centre = np.array([2.0, -1.0]) + velocity * PERIOD * k
        points, found = tracker.update(scan(pose, [centre], radius=radius), pose)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    to_robot = np.array([[c, s], [-s, c]])
    assert len(points) == RING_POINTS
    assert found == pytest.approx(np.tile(to_robot @ velocity, (RING_POINTS, 1)), abs=0.08)
    # All around the circle, the far side as well.
    middle = to_robot @ (centre - pose[:2])
    assert np.linalg.norm(points - middle, axis=1) == pytest.approx(radius, abs=0.03)
    assert points.mean(axis=0) == pytest.approx(middle, abs=0.03)


def test_two_walkers_keep_their_own_velocities_when_they_pass():
    tracker = Tracker(ANGLES, RANGE, PERIOD)
    for k in range(8):
        first = np.array([1.5, -0.7 + 0.2 * k])
        second = np.array([2.6, 0.7 - 0.2 * k])
        points, velocity = tracker.update(scan((0, 0, 0), [first, second]), np.zeros(3))
    near = points[:, 0] < 2.0
    assert velocity[near][:, 1] == pytest.approx(1.0, abs=0.1)
    assert velocity[~near][:, 1] == pytest.approx(-1.0, abs=0.1)


@pytest.mark.parametrize(("gap", "bodies"), [(0.12, 2), (0.2, 1)])
def test_how_far_apart_two_bodies_are_can_be_said(gap, bodies):
    """Two people 0.10 m apart, one a little farther away."""
    seen = scan((0, 0, 0), [(1.5, 0.25), (1.9, -0.2)])
    points, _ = Tracker(ANGLES, RANGE, PERIOD, group_gap=gap).update(seen, np.zeros(3))
    assert len(points) == bodies * RING_POINTS


def test_velocities_in_noise_are_smoother_when_more_of_it_is_expected():
    rng = np.random.default_rng(0)
    scans = [scan((0, 0, 0), [(2.0, -2.0 + 0.2 * k)]) + rng.normal(0, 0.02, 180) for k in range(20)]
    errors = []
    for noise in (0.03, 0.05):
        tracker = Tracker(ANGLES, RANGE, PERIOD, position_noise=noise)
        found = [tracker.update(one, np.zeros(3))[1] for one in scans]
        off = np.array(
            [velocity[np.linalg.norm(velocity, axis=1) > 0][0] for velocity in found[6:]]
        )
        errors.append(np.sqrt(np.mean(np.sum((off - [0.0, 1.0]) ** 2, axis=1))))
    assert errors[1] < errors[0] < 0.6


def test_walls_stand_still_while_the_robot_drives_past():
    tracker = Tracker(ANGLES, RANGE, PERIOD)
    walls = [[-10, 1.5, 10, 1.5], [-10, -1.5, 10, -1.5], [3, -1.5, 3, 0.5]]
    for k in range(10):
        pose = np.array([0.2 * k, 0.0, 0.3 * np.sin(k)])
        points, velocity = tracker.update(scan(pose, walls=walls), pose)
        assert not velocity.any()
        assert len(points) > 100


def test_a_standing_body_has_no_velocity():
    tracker = Tracker(ANGLES, RANGE, PERIOD)
    for k in range(10):
        pose = np.array([0.15 * k, 0.0, 0.1 * k])
        _, velocity = tracker.update(scan(pose, [[2.0, 1.0]]), pose)
        assert not velocity.any()


def test_a_velocity_is_forgotten_with_its_body():
    tracker = Tracker(ANGLES, RANGE, PERIOD)
    for k in range(5):
        tracker.update(scan((0, 0, 0), [[2.0, 0.2 * k]]), np.zeros(3))
    for _ in range(5):
        tracker.update(scan((0, 0, 0)), np.zeros(3))
    _, velocity = tracker.update(scan((0, 0, 0), [[2.0, 1.0]]), np.zeros(3))
    assert not velocity.any()


def test_a_narrow_view_does_not_join_its_edges():
    angles = np.linspace(-np.pi / 4, np.pi / 4, 90)
    tracker = Tracker(angles, RANGE, PERIOD)
    points, _ = tracker.update(scan((0, 0, 0), [[2.0, 0.0]], angles=angles), np.zeros(3))
    assert np.linalg.norm(points - [2.0, 0.0], axis=1) == pytest.approx(0.25, abs=0.02)


@pytest.mark.parametrize("value", [RANGE, np.inf, np.nan, 0.0])
def test_beams_without_a_return_make_no_points(value):
    tracker = Tracker(ANGLES, RANGE, PERIOD)
    points, velocity = tracker.update(np.full(180, value), np.zeros(3))
    assert points.shape == velocity.shape == (0, 2)


def test_a_single_point_is_kept_as_it_is():
    ranges = np.full(180, RANGE)
    ranges[45] = 1.0
    points, velocity = Tracker(ANGLES, RANGE, PERIOD).update(ranges, np.zeros(3))
    assert points == pytest.approx(np.array([[0.0, 1.0]]), abs=1e-12)
    assert not velocity.any()


def test_a_lidar_without_beams_sees_nothing():
    points, _ = Tracker(np.empty(0), RANGE, PERIOD).update(np.empty(0), np.zeros(3))
    assert points.shape == (0, 2)
