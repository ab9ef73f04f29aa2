"""Reward terms of the paper (section III.B): R = R_goal + R_collision + R_social."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.simulation.lanes import COLLISION, RUNNING, SUCCESS
from crowdbench.simulation.rounding import length

WALKING = 0.1
"""Pedestrians slower than this do not take part in interactions [m/s]."""


@compiled()
def judge(
    lanes: NDArray[np.int64],
    worlds: NDArray[np.void],
    robots: NDArray[np.void],
    people: NDArray[np.void],
    contacts: NDArray[np.float64],
) -> None:
    """Write reward terms and outcomes of the active robots' step; a contact counts even on arrival.

    Args:
        lanes: (M,) which.
        worlds, robots, people, contacts: of all lanes after the step, see ``State``. A robot's
            ``distance`` is still that before it, and is brought up to date; ``terms`` and
            ``outcome`` (but no timeouts) are written.
    """
    position, velocity = np.empty((people.shape[1], 2)), np.empty((people.shape[1], 2))
    for i in range(len(lanes)):
        world = worlds[lanes[i]]
        count = world.people
        for p in range(count):
            person = people[lanes[i], p]
            position[p, 0], position[p, 1] = person.position[0], person.position[1]
            velocity[p, 0], velocity[p, 1] = person.velocity[0], person.velocity[1]
        for r in range(robots.shape[1]):
            robot = robots[lanes[i], r]
            if robot.active:
                collided = contacts[lanes[i], r, 0] != 0.0
                _judge_robot(robot, world, collided, position[:count], velocity[:count])


@compiled(inline="always")
def _judge_robot(robot, world, collided, position, velocity):  # type: ignore[no-untyped-def]
    distance = length(robot.goal[0] - robot.pose[0], robot.goal[1] - robot.pose[1])
    progress = robot.distance - distance
    robot.distance = distance
    arrived = not collided and distance <= world.goal_tolerance
    robot.terms[0] = goal_term(world, arrived, progress)
    robot.terms[1] = collision_term(world, collided, robot.nearest)
    robot.terms[2] = 0.0
    if world.social > 0.0:
        robot.terms[2] = world.social * social_term(
            robot.pose[:2],
            robot.direction,
            robot.speed,
            world.full_speed,
            position,
            velocity,
            world.social_radius,
            world.social_horizon,
        )
    robot.outcome = COLLISION if collided else SUCCESS if arrived else RUNNING


@compiled(inline="always")
def goal_term(weights, arrived, progress):  # type: ignore[no-untyped-def]
    """R_goal: a bonus on arrival, otherwise w_1 times the metres gained (``progress``)."""
    return weights.arrival if arrived else weights.progress * progress


@compiled(inline="always")
def collision_term(weights, collided, nearest):  # type: ignore[no-untyped-def]
    """R_collision: a penalty on contact, otherwise w_2 (1 - d / (r + 1 m)) near obstacles.

    Args:
        weights: of the scenario, fields as of its ``reward``.
        collided: the robot touched something.
        nearest: d, the least LiDAR distance [m].
    """
    if collided:
        return weights.collision
    return weights.proximity * max(0.0, 1.0 - nearest / weights.proximity_range)


@compiled(inline="always")
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
        walk = math.hypot(pedestrian_velocity[p, 0], pedestrian_velocity[p, 1])
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
    distance = math.hypot(ahead + forward * nearest, left + across * nearest)
    return max(0.0, 1.0 - distance / radius)
