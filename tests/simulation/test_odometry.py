"""What robots believe of their poses."""

import numpy as np
import pytest

import crowdbench
from crowdbench.scenario import Odometry
from crowdbench.simulation.odometry import DriftingOdometry


def believe(settings, path, seed=0):
    """(3,) where a robot believes to be after a path (T, 3)."""
    odometry = DriftingOdometry(settings, path[0], np.random.default_rng(seed))
    for pose in path[1:]:
        odometry.update(pose)
    return odometry.wrapped()


def relative(path):
    """(3,) the last pose of a path in the frame of the first."""
    c, s = np.cos(path[0, 2]), np.sin(path[0, 2])
    x, y, turn = path[-1] - path[0]
    return np.array([c * x + s * y, c * y - s * x, (turn + np.pi) % (2 * np.pi) - np.pi])


def test_without_errors_a_robot_knows_where_it_is():
    path = np.cumsum(np.random.default_rng(1).normal(0.0, 0.3, (30, 3)), axis=0)
    np.testing.assert_allclose(believe(Odometry(), path), relative(path), atol=1e-9)


@pytest.mark.parametrize("path", [
    [[0, 0, 0], [-1, 0, 0]],  # backwards
    [[1, 2, 0.5], [1, 2, 0.5]],  # standing
    [[0, 0, 0], [0, 1, 0]],  # sideways
])  # fmt: skip
def test_the_way_is_believed_along_its_true_direction(path):
    path = np.array(path, float)
    errors = np.array([
        believe(Odometry(translation=0.01), path, seed) - relative(path) for seed in range(400)
    ])  # fmt: skip
    way = path[-1] - path[0]
    # A tenth of the way is the standard deviation, and all of it is along the way.
    np.testing.assert_allclose(errors.std(axis=0), 0.1 * np.abs(way), rtol=0.1, atol=1e-9)


def test_errors_have_the_variances_of_the_motion_model():
    # Thrun et al., table 5.6, with turns of 0.2 rad before and after a way of 1 m.
    path = np.array([[0.0, 0.0, 0.0], [np.cos(0.2), np.sin(0.2), 0.4]])
    settings = Odometry(
        rotation=0.04, rotation_by_translation=0.01, translation=0.02, translation_by_rotation=0.1
    )
    ends = np.array([believe(settings, path, seed) for seed in range(2000)])
    turns = 0.04 * 0.2**2 + 0.01
    way = 0.02 + 0.1 * 2 * 0.2**2
    bearings = np.arctan2(ends[:, 1], ends[:, 0])
    assert np.var(bearings) == pytest.approx(turns, rel=0.1)
    assert np.var(ends[:, 2]) == pytest.approx(2 * turns, rel=0.1)
    assert np.var(np.hypot(ends[:, 0], ends[:, 1])) == pytest.approx(way, rel=0.1)
    np.testing.assert_allclose(ends.mean(axis=0), relative(path), atol=0.02)


def test_only_the_pose_drifts():
    drift = {"rotation": 0.01, "translation": 0.02}
    envs = [
        crowdbench.parallel_env(
            "multimodal_fast", robots={"odometry": odometry}, lidar={"noise": 0.02}
        )
        for odometry in ({}, drift)
    ]
    seen = [env.reset(seed=0)[0]["robot_0"] for env in envs]
    np.testing.assert_array_equal(seen[0]["pose"], seen[1]["pose"])
    for _ in range(8):
        seen = [env.step({"robot_0": (0.8, 0.4)})[0]["robot_0"] for env in envs]
    for key in ("lidar", "velocity", "goal"):
        np.testing.assert_array_equal(seen[0][key], seen[1][key])
    off = np.abs(seen[0]["pose"] - seen[1]["pose"])
    assert (off > 1e-4).all()
    assert (off < 0.3).all()


def test_robots_drift_each_by_themselves():
    env = crowdbench.parallel_env(
        "multimodal_fast",
        robots={"count": 2, "odometry": {"translation": 0.05}},
        pedestrians={"count": 0},
    )
    env.reset(seed=0)
    seen, *_ = env.step(dict.fromkeys(env.agents, (1.0, 0.0)))
    ways = [seen[name]["pose"][0] for name in env.agents]
    assert ways[0] != ways[1]
