"""Episodes made by hand: only what a test is about is written down, the rest is empty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from crowdbench.evaluation.episode import Episode


def _make_episode(robot_pose, actions=None, pedestrians=None, velocities=None, **fields):
    """An episode of a 0.4 x 0.3 m robot, 0.2 s per step, pedestrians of radius 0.25 m.

    It has a differential drive, so that its velocity is that of its actions along its heading.
    ``pedestrians`` and ``velocities``: (T + 1, P, 2), or (P, 2) for people who stay as they are.
    """
    pose = np.array(robot_pose, dtype=float).reshape(-1, 3)
    states = len(pose)
    actions = np.zeros((states - 1, 2)) if actions is None else np.array(actions, dtype=float)

    def crowd(values):
        values = np.array(values, dtype=float)
        return np.broadcast_to(values, (states, *values.shape[-2:])).copy()

    speed = np.concatenate([[0.0], actions.reshape(-1, 2)[:, 0]])
    ahead = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)
    position = crowd(np.zeros((0, 2)) if pedestrians is None else pedestrians)
    people = position.shape[:2]
    values = {
        "scenario": "by_hand",
        "agent": "by_hand",
        "seed": 0,
        "robot": "robot_0",
        "control_period": 0.2,
        "footprint": (0.4, 0.3),
        "goal_tolerance": 0.3,
        "top_speed": 1.0,
        "goal": np.array([4.0, 0.0]),
        "walls": np.zeros((0, 4)),
        "obstacles": np.zeros((0, 3)),
        "pedestrian_radius": np.full(people[1], 0.25),
        "robot_pose": pose,
        "robot_world_velocity": speed[:, None] * ahead,
        "robot_speed": speed,
        "actions": actions.reshape(states - 1, 2),
        "other_robots": np.zeros((states, 0, 3)),
        "pedestrian_reactive": np.ones(people[1], dtype=bool),
        "pedestrian_position": position,
        "pedestrian_velocity": np.zeros_like(position) if velocities is None else crowd(velocities),
        "pedestrian_goal": np.zeros_like(position),
        "pedestrian_intent": np.zeros(people, dtype=np.int64),
        "pedestrian_attentive": np.ones(people, dtype=bool),
        "pedestrian_switch_time": np.full(people, np.inf),
        "pedestrian_group": np.full(people[1], -1),
        "pedestrian_queue": np.full(people[1], -1),
        "pedestrian_place": np.full(people, -1),
        "pedestrian_stop_time": np.full(people, np.inf),
        "pedestrian_stop_end": np.full(people, np.inf),
        "inference_s": np.full(states - 1, 0.01),
        "outcome": "timeout",
    }
    values.update({key: np.array(v) if isinstance(v, list) else v for key, v in fields.items()})
    return Episode(**values)


def _random_episode(seed, steps=60, people=6):
    """A robot that drives arcs among people who wander, with obstacles and a wall in between."""
    rng = np.random.default_rng(seed)
    period = 0.2
    actions = np.stack([rng.uniform(0, 1, steps), rng.uniform(-1.5, 1.5, steps)], axis=1)
    pose = np.zeros((steps + 1, 3))
    pose[0] = [-2.0, rng.uniform(-0.5, 0.5), rng.uniform(-3, 3)]
    for t, (v, w) in enumerate(actions):
        x, y, heading = pose[t]
        step = v * period * np.array([np.cos(heading), np.sin(heading)])
        pose[t + 1] = [x + step[0], y + step[1], heading + w * period]
    turning = np.cumsum(rng.normal(0, 0.2, (steps + 1, people)), axis=0)
    angle = rng.uniform(-np.pi, np.pi, people) + turning
    speed = rng.uniform(0.0, 1.2, people)[:, None]
    velocity = speed * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    start = rng.uniform([-3.5, -1.5], [-0.5, 1.5], (people, 2))
    position = start + np.cumsum(velocity, axis=0) * period
    return _make_episode(
        pose,
        actions,
        position,
        velocity,
        goal=np.array([2.5, rng.uniform(-1, 1)]),
        obstacles=np.concatenate(
            [rng.uniform([-1.2, -1.0], [1.2, 1.0], (3, 2)), rng.uniform(0.2, 0.5, (3, 1))], axis=1
        ),
        walls=rng.uniform(-1.0, 1.0, (1, 4)),
        outcome="success",
    )


def _moved(episode, angle=0.0, shift=(0.0, 0.0), mirror=False):
    """The same episode in a frame that is mirrored at the x axis, then turned, then shifted."""
    cos, sin = np.cos(angle), np.sin(angle)
    flip = np.diag([1.0, -1.0 if mirror else 1.0])
    turn = np.array([[cos, -sin], [sin, cos]]) @ flip
    sign = -1.0 if mirror else 1.0

    def vectors(values):
        return values @ turn.T

    def points(values):
        return vectors(values) + np.array(shift)

    def poses(values):
        return np.concatenate([points(values[..., :2]), sign * values[..., 2:] + angle], axis=-1)

    walls, obstacles = episode.walls, episode.obstacles
    return replace(
        episode,
        goal=points(episode.goal),
        walls=np.concatenate([points(walls[:, :2]), points(walls[:, 2:])], axis=1),
        obstacles=np.concatenate([points(obstacles[:, :2]), obstacles[:, 2:]], axis=1),
        robot_pose=poses(episode.robot_pose),
        robot_world_velocity=vectors(episode.robot_world_velocity),
        actions=episode.actions * [1.0, sign],
        other_robots=poses(episode.other_robots),
        pedestrian_position=points(episode.pedestrian_position),
        pedestrian_velocity=vectors(episode.pedestrian_velocity),
        pedestrian_goal=points(episode.pedestrian_goal),
    )


@pytest.fixture(scope="session")
def make_episode():
    return _make_episode


@pytest.fixture(scope="session")
def random_episode():
    return _random_episode


@pytest.fixture(scope="session")
def moved():
    return _moved
