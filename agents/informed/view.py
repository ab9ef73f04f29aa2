"""Whom a robot is told of: everybody, people on a map around it, or those its LiDAR hits."""

from __future__ import annotations

import math

import numpy as np
from crowdbench_agents.informed.search import ABSENT

from crowdbench.compiled import compiled

AHEAD = 2 / 3
"""Share of a square map that lies ahead of the robot, as in the learned agents' maps."""


def in_view(view, me, robot, state):
    """(P + R,) bool: of which people and robots a robot is told.

    Args:
        view: ``all``, ``lidar``, or the side of a square map [m].
        me: index of the robot.
        robot: its RobotSpec.
        state: of the world.
    """
    pose, people = state["robot_pose"][me], len(state["pedestrian_position"])
    places = np.vstack([state["pedestrian_position"], state["robot_pose"][:, :2]])
    there = np.isfinite(places[:, 0])
    if view == "all":
        return there
    if view == "lidar":
        # Other robots are taken for the circles around their footprints.
        radii = np.where(state["robot_active"], robot.radius, ABSENT)
        radii[me] = ABSENT
        radii = np.where(there, np.concatenate([state["pedestrian_radius"], radii]), ABSENT)
        cosine, sine = math.cos(pose[2]), math.sin(pose[2])
        x, y, _ = robot.lidar_mount
        mount = np.array(
            [pose[0] + cosine * x - sine * y, pose[1] + sine * x + cosine * y, pose[2]]
        )
        seen = hit_by_lidar(
            mount,
            robot.lidar_angles,
            robot.lidar_range,
            np.column_stack([places, radii]),
            state["obstacles"],
            state["walls"],
        )
    else:
        seen = on_map(pose, view, places)
    seen[people + me] = True
    return seen


def told_of(seen, state):
    """The state with those people and robots only of which ``seen`` (P + R,) is true."""
    people = len(state["pedestrian_position"])
    limited = {
        name: value[seen[:people]] if name.startswith("pedestrian_") else value
        for name, value in state.items()
    }
    if "recorded_ahead" in state:
        limited["recorded_ahead"] = state["recorded_ahead"][:, seen[:people]]
    return {**limited, "robot_active": state["robot_active"] & seen[people:]}


def on_map(pose, side, places):
    """(N,) bool: which of the places (N, 2) [m] lie on a square map of a robot at ``pose``.

    Args:
        pose: (3,) x, y [m], heading [rad].
        side: of the map [m]; two thirds of it lie ahead of the robot.
        places: (N, 2) [m].
    """
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = places[:, 0] - pose[0], places[:, 1] - pose[1]
    ahead, left = cosine * dx + sine * dy, cosine * dy - sine * dx
    return (ahead <= AHEAD * side) & (ahead >= (AHEAD - 1) * side) & (np.abs(left) <= side / 2)


@compiled()
def hit_by_lidar(pose, angles, reach, discs, obstacles, walls):
    """(N,) bool: which of the discs at least one beam meets first, without noise.

    Args:
        pose: (3,) of the LiDAR: x, y [m], heading [rad].
        angles: (beams,) from the heading [rad].
        reach: of a beam [m].
        discs: (N, 3) x, y, radius [m]; those with a radius below 0 are not there.
        obstacles: (K, 3) x, y, radius [m].
        walls: (S, 4) x1, y1, x2, y2 [m].
    """
    seen = np.zeros(len(discs), dtype=np.bool_)
    for b in range(len(angles)):
        cosine, sine = math.cos(pose[2] + angles[b]), math.sin(pose[2] + angles[b])
        nearest, who = reach, -1
        for s in range(len(walls)):
            ex, ey = walls[s, 2] - walls[s, 0], walls[s, 3] - walls[s, 1]
            dx, dy = walls[s, 0] - pose[0], walls[s, 1] - pose[1]
            across = cosine * ey - sine * ex
            if across != 0.0:
                along = (dx * ey - dy * ex) / across
                share = (dx * sine - dy * cosine) / across
                if along >= 0.0 and 0.0 <= share <= 1.0:
                    nearest = min(nearest, along)
        for k in range(len(obstacles)):
            x, y = obstacles[k, 0] - pose[0], obstacles[k, 1] - pose[1]
            nearest = min(nearest, _to_disc(x, y, obstacles[k, 2], cosine, sine))
        for d in range(len(discs)):
            if discs[d, 2] >= 0.0:
                x, y = discs[d, 0] - pose[0], discs[d, 1] - pose[1]
                along = _to_disc(x, y, discs[d, 2], cosine, sine)
                if along < nearest:
                    nearest, who = along, d
        if who >= 0:
            seen[who] = True
    return seen


@compiled()
def _to_disc(x, y, radius, cosine, sine):
    """Distance along a beam to a disc at (x, y) from its origin; inf if it misses [m]."""
    along, off = x * cosine + y * sine, x * sine - y * cosine
    if x * x + y * y <= radius * radius:
        return 0.0
    if along < 0.0 or abs(off) > radius:
        return math.inf
    return along - math.sqrt(radius * radius - off * off)
