"""Scans of a LiDAR that is not at the robot's centre."""

import dataclasses

import numpy as np
import pytest
from crowdbench_agents.geometry.clusters import Tracker
from crowdbench_agents.geometry.scan import ScanGeometry

import crowdbench

MOUNTS = [(0.0, 0.0, 0.0), (0.2, 0.1, 0.0), (-0.15, 0.0, 2.0)]


def robot(mount):
    return crowdbench.RobotSpec.from_scenario(
        crowdbench.Scenario(name="test", lidar={"mount": mount})
    )


def observe(world, mount, pose, discs, walls=()):
    """What a robot at a pose senses by a LiDAR that is mounted somewhere on it."""
    x, y, heading = pose
    c, s = np.cos(heading), np.sin(heading)
    lidar = (x + c * mount[0] - s * mount[1], y + s * mount[0] + c * mount[1], heading + mount[2])
    return dataclasses.replace(world.observe(pose, discs), lidar=world.scan(lidar, discs, walls))


@pytest.mark.parametrize("mount", MOUNTS)
def test_points_lie_on_what_is_seen(world, mount):
    pose = (1.0, -2.0, 0.7)
    seen = observe(world, mount, pose, (), walls=[(3.0, -9.0, 3.0, 9.0)])
    geometry = ScanGeometry(robot(mount))
    points = geometry.points(seen.lidar.astype(float))
    assert len(points) > 20
    across = pose[0] + points @ [np.cos(pose[2]), -np.sin(pose[2])]
    np.testing.assert_allclose(across, 3.0, atol=1e-5)


@pytest.mark.parametrize("mount", MOUNTS)
def test_discs_are_tracked_where_they_are(world, mount):
    tracker, spec = Tracker(robot(mount)), robot(mount)
    place, velocity = np.array([2.0, 1.0]), np.array([-0.5, 0.2])
    for step in range(12):
        pose = np.array([0.05 * step, 0.0, 0.1 * step])
        place = place + 0.2 * velocity
        seen = observe(world, mount, pose, [(*place, 0.25)])
        scene = tracker.update(seen)
    (disc,) = scene.discs
    np.testing.assert_allclose(disc[:2], place, atol=0.03)
    np.testing.assert_allclose(disc[2:4], velocity, atol=0.1)
    assert (tracker.without_moving(seen, scene) == spec.lidar_range).all()


def test_a_pose_is_where_beams_begin_if_the_lidar_is_at_the_centre():
    pose = np.array([1.0, 2.0, 0.5])
    np.testing.assert_array_equal(ScanGeometry(robot(MOUNTS[0])).origin(pose), pose)


@pytest.mark.parametrize("lost", [2, -1, 0, 1])
def test_a_lost_beam_does_not_break_what_it_fell_on(world, lost):
    scan = world.scan((0.0, 0.0, 0.0), [(2.0, 0.0, 0.25)]).astype(float)
    broken = scan.copy()
    broken[lost] = world.spec.lidar_range
    np.testing.assert_allclose(ScanGeometry(world.spec).bridged(broken), scan, atol=0.05)


def test_beams_between_two_things_stay_empty(world):
    """Two lost beams in a row, and one between things at different distances, are as they were."""
    scan = np.full(180, 6.0)
    scan[[10, 13, 20, 22]] = 2.0, 2.0, 2.0, 2.2
    np.testing.assert_array_equal(ScanGeometry(world.spec).bridged(scan), scan)


def test_the_ends_of_a_narrow_view_are_no_neighbours():
    narrow = crowdbench.Scenario(name="test", lidar={"beams": 90, "field_of_view": 180})
    scan = np.full(90, 2.0)
    scan[[0, -1]] = 6.0
    geometry = ScanGeometry(crowdbench.RobotSpec.from_scenario(narrow))
    np.testing.assert_array_equal(geometry.bridged(scan), scan)


@pytest.mark.parametrize("changes", [{"acceleration": (1.0, 3.0)}, {"latency": 1}])
def test_a_robot_that_is_slow_to_react_takes_a_person_with_a_lost_beam_for_a_disc(world, changes):
    seen = world.observe((0.0, 0.0, 0.0), [(2.0, 0.0, 0.25)])
    seen.lidar[0] = world.spec.lidar_range
    # Half of what is seen of it on either side is as straight as a piece of wall.
    assert len(Tracker(world.spec).update(seen).discs) == 0
    spec = dataclasses.replace(world.spec, **changes)
    assert len(Tracker(spec).update(seen).discs) == 1
