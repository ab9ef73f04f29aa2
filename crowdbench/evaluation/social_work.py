"""Social work after HuNavSim: how hard the social force model would push robot and people apart.

The force that a neighbour exerts is that of Moussaid et al. ("Experimental study of the behavioural
mechanisms underlying self-organization in human crowds", Proc. R. Soc. B 276, 2009), with the
parameters of HuNavSim's evaluator (Perez-Higueras et al. 2023, "HuNavSim: A ROS 2 Human Navigation
Simulator for Benchmarking Human-Aware Robot Navigation"). Symbols as there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from crowdbench.libm import atan2, exp

Array = NDArray[np.float64]

INTERACTION_STRENGTH = 2.1
"""A [m/s^2]."""
INTERACTION_RANGE = 0.35
"""gamma: B = gamma |D| [s]."""
VELOCITY_WEIGHT = 2.0
"""lambda: D = lambda (v_i - v_j) + e_ij."""
SWERVE_WIDTH = 2.0
"""n."""
BRAKE_WIDTH = 3.0
"""n'."""
BOUNDARY_STRENGTH = 10.0
"""Repulsion at the surface of a wall or obstacle [m/s^2]."""
BOUNDARY_RANGE = 0.2
"""Distance over which it falls to 1/e [m]."""


def social_work(
    position: Array,
    velocity: Array,
    radius: float,
    people_position: Array,
    people_velocity: Array,
    walls: Array,
    obstacles: Array,
) -> Array:
    """|F_r| + |O_r| + sum over people of |F_p|: on the robot, by what is static, on the people.

    F_r is the sum of the people's forces on the robot, F_p the robot's on one of them, which is
    the opposite of that one's on the robot. O_r comes from the nearest wall or obstacle.

    Args:
        position: (N, 2) of the robot in each state [m].
        velocity: (N, 2) [m/s].
        radius: of the circle around its footprint [m].
        people_position: (N, P, 2) [m]; NaN where somebody is not there.
        people_velocity: (N, P, 2) [m/s].
        walls: (S, 4) segments x1, y1, x2, y2 [m].
        obstacles: (K, 3) x, y, radius [m].

    Returns:
        (N,) [m/s^2].
    """
    forces = social_force(people_position - position[:, None], velocity[:, None] - people_velocity)
    forces[np.isnan(people_position[..., 0])] = 0.0
    on_robot = np.linalg.norm(forces.sum(axis=1), axis=1)
    on_people = np.linalg.norm(forces, axis=2).sum(axis=1)
    distance = boundary_distance(position, walls, obstacles)
    by_boundary = BOUNDARY_STRENGTH * exp(-(distance - radius) / BOUNDARY_RANGE)
    return np.asarray(on_robot + by_boundary + on_people)


def social_force(offset: Array, relative_velocity: Array) -> Array:
    """Force of a neighbour on somebody.

    Args:
        offset: (..., 2) from the one who is pushed to the neighbour [m].
        relative_velocity: (..., 2) v_i - v_j, of the one who is pushed less the neighbour's [m/s].

    Returns:
        (..., 2) [m/s^2]; zero where both are at one place.
    """
    distance = np.linalg.norm(offset, axis=-1)
    apart = np.where(distance > 0, distance, 1.0)
    e = offset / apart[..., None]
    D = VELOCITY_WEIGHT * relative_velocity + e
    length = np.linalg.norm(D, axis=-1)
    acts = (distance > 0) & (length > 0)
    length = np.where(acts, length, 1.0)
    t = D / length[..., None]
    theta = atan2(e[..., 0] * t[..., 1] - e[..., 1] * t[..., 0], np.sum(e * t, axis=-1))
    B = INTERACTION_RANGE * length
    strength = np.where(acts, INTERACTION_STRENGTH * exp(-distance / B), 0.0)
    brake = -strength * exp(-((BRAKE_WIDTH * B * theta) ** 2))
    swerve = np.sign(theta) * strength * exp(-((SWERVE_WIDTH * B * theta) ** 2))
    left = np.stack([-t[..., 1], t[..., 0]], axis=-1)
    return np.asarray(brake[..., None] * t + swerve[..., None] * left)


def boundary_distance(position: Array, walls: Array, obstacles: Array) -> Array:
    """Distance from each place (N, 2) to the nearest wall or obstacle, (N,) [m]; inf if none."""
    along = walls[:, 2:] - walls[:, :2]
    square = np.sum(along**2, axis=1)
    offset = position[:, None] - walls[:, :2]
    share = np.sum(offset * along, axis=2) / np.where(square > 0, square, 1.0)
    to_walls = np.linalg.norm(offset - np.clip(share, 0.0, 1.0)[..., None] * along, axis=2)
    to_obstacles = np.linalg.norm(position[:, None] - obstacles[:, :2], axis=2) - obstacles[:, 2]
    return np.asarray(np.hstack([to_walls, to_obstacles]).min(axis=1, initial=np.inf))
