"""What a step that people were seen to walk tells about where they are going.

People walk by ORCA: velocities follow from what everybody can see and from the preferred direction.
So each of many directions is as likely as this step was for somebody who prefers it, and each place
where somebody may be going is believed in by Bayes' rule.

Numbers are rounded alike everywhere, as they decide plans.
"""

from __future__ import annotations

import math

import numpy as np

from crowdbench import orca_velocities
from crowdbench.compiled import compiled

DIRECTIONS = 180
"""Preferred directions that are tried."""
ARRIVAL = 0.3
"""A pedestrian this near to its goal takes a new one [m]."""
CELL = 0.25
"""Side of the cells in which goals may lie [m]."""
NEAREST = ARRIVAL - CELL / 2
"""Nobody's goal lies in a cell whose middle is nearer than this [m]."""
NOISE = 0.05
"""Standard deviation of a walk from what the model says of the nearest direction [m/s]."""
GROUP_NOISE = 0.2
"""The same of a group's mean velocity from the direction to its goal [m/s]."""
FLOOR = 1e-5
"""What a walk counts for where the model does not explain it."""


def likely_directions(state, before, period, robot_radius):
    """(P, DIRECTIONS) how likely what everybody walked is for each preferred direction.

    Args:
        state: of the world now.
        before: of the world a step ago, None as the episode begins.
        period: control period [s].
        robot_radius: of the circle around a robot [m].
    """
    if before is None:
        likely = _of_velocities(state["pedestrian_velocity"], state["pedestrian_speed"], NOISE)
    else:
        likely = _of_walks(
            before["pedestrian_position"],
            before["pedestrian_velocity"],
            state["pedestrian_speed"],
            state["pedestrian_acceleration"],
            state["pedestrian_radius"],
            state["pedestrian_reactive"],
            before["robot_active"],
            before["robot_pose"],
            before["robot_world_velocity"],
            robot_radius,
            state["obstacles"],
            state["walls"],
            period,
            state["pedestrian_velocity"],
        )
    grouped = state["pedestrian_group"] >= 0
    if grouped.any():
        likely[grouped] = _of_groups(state, before, grouped, period)
    return likely


def _of_groups(state, before, grouped, period):
    """(G, DIRECTIONS) the same of all grouped people, by how the middle of their group moved."""
    group, velocity = state["pedestrian_group"], state["pedestrian_velocity"]
    likely = np.empty((np.count_nonzero(grouped), DIRECTIONS))
    for i, p in enumerate(np.flatnonzero(grouped)):
        members = group == group[p]
        pace = state["pedestrian_speed"][members].min()
        mean = velocity[members].mean(axis=0)
        if before is None:
            mean *= pace / max(math.hypot(*mean), 1e-3)
            likely[i] = _of_velocities(mean[None], np.array([pace]), GROUP_NOISE)
        else:
            most = state["pedestrian_acceleration"][members].min() * period
            last = before["pedestrian_velocity"][members].mean(axis=0)
            likely[i] = _of_turn(last, mean, pace, most)
    return likely


@compiled()
def _of_turn(last, mean, pace, most):
    """(DIRECTIONS,) how likely a group's mean velocity is a step after another one."""
    likely = np.empty(DIRECTIONS)
    for a in range(DIRECTIONS):
        angle = 2 * math.pi * a / DIRECTIONS
        dx, dy = pace * math.cos(angle) - last[0], pace * math.sin(angle) - last[1]
        share = math.hypot(dx, dy) / most
        if share > 1.0:
            dx, dy = dx / share, dy / share
        likely[a] = _density(mean[0] - last[0] - dx, mean[1] - last[1] - dy, GROUP_NOISE)
    return likely


@compiled()
def _of_velocities(velocity, speed, noise):
    """(P, DIRECTIONS) how likely a velocity is for each preferred direction, with nobody near."""
    likely = np.empty((len(velocity), DIRECTIONS))
    for a in range(DIRECTIONS):
        angle = 2 * math.pi * a / DIRECTIONS
        x, y = math.cos(angle), math.sin(angle)
        for p in range(len(velocity)):
            dx, dy = velocity[p, 0] - speed[p] * x, velocity[p, 1] - speed[p] * y
            likely[p, a] = _density(dx, dy, noise)
    return likely


@compiled()
def _of_walks(
    position,
    velocity,
    speed,
    acceleration,
    radius,
    reactive,
    active,
    robot_pose,
    robot_velocity,
    robot_radius,
    obstacles,
    walls,
    period,
    walked,
):
    """(P, DIRECTIONS) how likely what was walked is for each preferred direction.

    Reactive people have seen the robots or not.
    """
    people, robots = len(position), len(robot_pose)
    likely = np.zeros((people, DIRECTIONS))
    preferred, out = np.empty_like(position), np.empty_like(position)
    place, sees = np.empty((robots, 2)), np.zeros((people, robots), dtype=np.bool_)
    for r in range(robots):
        place[r, 0], place[r, 1] = robot_pose[r, 0], robot_pose[r, 1]
    for courteous in range(2):
        for p in range(people):
            for r in range(robots):
                sees[p, r] = courteous == 1 and reactive[p] and active[r]
        for a in range(DIRECTIONS):
            angle = 2 * math.pi * a / DIRECTIONS
            x, y = math.cos(angle), math.sin(angle)
            for p in range(people):
                preferred[p, 0], preferred[p, 1] = speed[p] * x, speed[p] * y
            orca_velocities(
                position, velocity, preferred, speed, radius, sees, place, robot_velocity,
                robot_radius, 0.5, obstacles, walls, period, out,
            )  # fmt: skip
            for p in range(people):
                dx, dy = out[p, 0] - velocity[p, 0], out[p, 1] - velocity[p, 1]
                share = math.hypot(dx, dy) / (acceleration[p] * period)
                if share > 1.0:
                    dx, dy = dx / share, dy / share
                dx, dy = walked[p, 0] - velocity[p, 0] - dx, walked[p, 1] - velocity[p, 1] - dy
                likely[p, a] = max(likely[p, a], _density(dx, dy, NOISE))
    return likely


@compiled()
def _density(dx, dy, noise):
    return math.exp(-(dx * dx + dy * dy) / (2 * noise * noise))


@compiled()
def taken(x, y, obstacles, radius):
    """Whether somebody's goal cannot lie at (x, y), since an obstacle (K, 3) is in its place."""
    for k in range(len(obstacles)):
        dx, dy = x - obstacles[k, 0], y - obstacles[k, 1]
        if math.sqrt(dx * dx + dy * dy) <= obstacles[k, 2] + radius + ARRIVAL:
            return True
    return False


@compiled()
def weigh(weights, places, ahead, x, y, likely):
    """Multiply a person's belief by how likely its step is on the way to each place.

    Args:
        weights: (C,) the belief, written.
        places: (C, 2) where it may be going [m].
        ahead: (C, 2 or 3) x, y where the way to each of them leads next [m].
        x, y: where it was before the step [m].
        likely: (DIRECTIONS,) of its step.

    Returns:
        Whether anything is left to be believed; else weights are not changed but for zeros.
    """
    total = 0.0
    for g in range(len(places)):
        if weights[g] > 0.0:
            dx, dy = places[g, 0] - x, places[g, 1] - y
            if dx * dx + dy * dy < NEAREST * NEAREST:
                weights[g] = 0.0  # it would have arrived
                continue
            dx, dy = ahead[g, 0] - x, ahead[g, 1] - y
            part = (math.atan2(dy, dx) / (2 * math.pi) % 1.0) * DIRECTIONS
            low = int(part) % DIRECTIONS
            share = part - math.floor(part)
            between = (1 - share) * likely[low] + share * likely[(low + 1) % DIRECTIONS]
            weights[g] *= between + FLOOR
            total += weights[g]
    if total > 0.0:
        for g in range(len(places)):
            weights[g] /= total
    return total > 0.0
