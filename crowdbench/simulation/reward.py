"""Reward terms of the paper (section III.B): R = R_goal + R_collision + R_social."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.scenario import Reward, Scenario
from crowdbench.simulation.world import World

WALKING = 0.1
"""Pedestrians slower than this do not take part in interactions [m/s]."""


def reward_and_outcome(
    world: World, scenario: Scenario, r: int, nearest: float, before: float
) -> tuple[dict[str, float], str, float]:
    """Reward terms and outcome of a robot's step; a contact counts even on arrival.

    Args:
        world: after the step.
        scenario: names weights and the goal tolerance.
        r: index of the robot.
        nearest: its least true LiDAR distance [m].
        before: its distance to the goal before the step [m].

    Returns:
        Terms by name, ``running``, ``success`` or ``collision``, and the distance now [m].
    """
    weights = scenario.reward
    x, y = (world.goals[r] - world.pose[r, :2]).tolist()
    distance = math.hypot(x, y)
    collided = r in world.contacts
    arrived = not collided and distance <= scenario.robots.goal_tolerance
    social = 0.0
    if weights.social > 0.0:
        social = weights.social * social_term(
            world.pose[r, :2],
            world.direction[r],
            world.speed[r],
            world.drive.full_speed,
            world.pedestrians.position,
            world.pedestrians.velocity,
            weights.social_radius,
            weights.social_horizon,
        )
    terms = {
        "goal": goal_term(weights, arrived, before - distance),
        "collision": collision_term(weights, collided, nearest),
        "social": social,
    }
    return terms, "collision" if collided else "success" if arrived else "running", distance


def goal_term(weights: Reward, arrived: bool, progress: float) -> float:
    """R_goal: a bonus on arrival, otherwise w_1 times the metres gained (``progress``)."""
    return weights.arrival if arrived else weights.progress * progress


def collision_term(weights: Reward, collided: bool, nearest: float) -> float:
    """R_collision: a penalty on contact, otherwise w_2 (1 - d / (r + 1 m)) near obstacles.

    Args:
        weights: of the scenario.
        collided: the robot touched something.
        nearest: d, the least LiDAR distance [m].
    """
    if collided:
        return weights.collision
    return weights.proximity * max(0.0, 1.0 - nearest / weights.proximity_range)


@compiled()
def social_term(
    position: NDArray[np.float64],
    direction: NDArray[np.float64],
    speed: float,
    top_speed: float,
    pedestrian_position: NDArray[np.float64],
    pedestrian_velocity: NDArray[np.float64],
    radius: float,
    horizon: float,
) -> float:
    """R_social / w_3: -(1 - d_min / r_s) for cutting in, +(1 - d_min / r_s) for yielding.

    Everybody is predicted at constant velocity over ``horizon``. The robot cuts in when it crosses
    a walking pedestrian's path ahead of that pedestrian and they come nearer than r_s. It yields
    when at top speed it would have cut in and at its actual speed it does not; d_min is then the
    distance of the conflict that was avoided, so that passing close by earns nothing. The
    strongest interaction counts.

    Args:
        position: (2,) of the robot [m].
        direction: (2,) unit vector along which it travels.
        speed: along this, negative backwards [m/s].
        top_speed: the speed at which not yielding is judged [m/s].
        pedestrian_position, pedestrian_velocity: (P, 2) [m], [m/s].
        radius: r_s [m].
        horizon: [s].
    """
    cosine, sine = direction[0], direction[1]
    cut, yielded = 0.0, 0.0
    for p in range(len(pedestrian_position)):
        walk = np.hypot(pedestrian_velocity[p, 0], pedestrian_velocity[p, 1])
        x, y = position[0] - pedestrian_position[p, 0], position[1] - pedestrian_position[p, 1]
        reach = (walk + top_speed) * horizon + radius
        if walk < WALKING or x * x + y * y > reach * reach:
            continue
        ux, uy = pedestrian_velocity[p, 0] / walk, pedestrian_velocity[p, 1] / walk
        # The pedestrian's frame: ahead along its walk, left across it.
        ahead, left = x * ux + y * uy, y * ux - x * uy
        forward, across = cosine * ux + sine * uy, sine * ux - cosine * uy
        now = _cut_in(ahead, left, speed * forward - walk, speed * across, radius, horizon)
        if now > 0.0:
            cut = max(cut, now)
            continue
        top = _cut_in(ahead, left, top_speed * forward - walk, top_speed * across, radius, horizon)
        yielded = max(yielded, top)
    return yielded if cut == 0.0 else -cut


@compiled()
def _cut_in(
    ahead: float, left: float, forward: float, across: float, radius: float, horizon: float
) -> float:
    """1 - d_min / r_s if the pedestrian's path is crossed ahead of it within reach, else 0."""
    if left * across >= 0.0:
        return 0.0
    crossing = -left / across
    if crossing > horizon or ahead + forward * crossing <= 0.0:
        return 0.0
    squared = forward * forward + across * across
    nearest = min(max(-(ahead * forward + left * across) / squared, 0.0), horizon)
    distance = np.hypot(ahead + forward * nearest, left + across * nearest)
    return max(0.0, 1.0 - distance / radius)
