"""Where randomness comes from: one seed per episode, one independent stream per purpose.

Streams are spawned by key, not by order, so what one part of the world draws never changes what
another part draws, whatever the robot does.
"""

from __future__ import annotations

import numpy as np

(
    _LAYOUT,
    _LIDAR,
    _AGENT,
    _PEDESTRIAN,
    _NEXT_EPISODE,
    _WALKING,
    _SCENARIO,
    _ODOMETRY,
    _TRAITS,
    _GROUPS,
) = range(10)


def layout(seed: int) -> np.random.Generator:
    """Stream that places robots, obstacles and pedestrians."""
    return _stream(seed, _LAYOUT)


def lidar(seed: int, robot: int) -> np.random.Generator:
    """Stream of one robot's LiDAR noise."""
    return _stream(seed, _LIDAR, robot)


def odometry(seed: int, robot: int) -> np.random.Generator:
    """Stream of the errors of one robot's odometry."""
    return _stream(seed, _ODOMETRY, robot)


def pedestrian(seed: int, index: int) -> np.random.Generator:
    """Stream of one pedestrian: speed, goals and changes of mind."""
    return _stream(seed, _PEDESTRIAN, index)


def traits(seed: int, index: int) -> np.random.Generator:
    """Stream of what one pedestrian is like, beside its speed."""
    return _stream(seed, _TRAITS, index)


def groups(seed: int) -> np.random.Generator:
    """Stream of how many people walk together in each group."""
    return _stream(seed, _GROUPS)


def walking(seed: int) -> np.random.Generator:
    """Stream of the walking model, where it draws anything."""
    return _stream(seed, _WALKING)


def next_episode(seed: int) -> np.random.Generator:
    """Stream of the seeds of later episodes, when ``reset`` is called without one."""
    return _stream(seed, _NEXT_EPISODE)


def scenario(seed: int) -> np.random.Generator:
    """Stream of the scenarios of later episodes, where there are several."""
    return _stream(seed, _SCENARIO)


def agent_seed(seed: int, robot: int = 0) -> int:
    """Seed given to the agent that drives a robot."""
    key = np.random.SeedSequence(seed, spawn_key=(_AGENT, robot))
    return int(key.generate_state(1, np.uint32)[0])


def _stream(seed: int, *key: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))
