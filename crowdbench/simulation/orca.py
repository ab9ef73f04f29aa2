"""ORCA: optimal reciprocal collision avoidance, for all pedestrians of a scene at once.

Van den Berg, Guy, Lin, Manocha, "Reciprocal n-Body Collision Avoidance", ISRR 2009 (Springer
STAR 70, 2011). Each neighbour, robot, obstacle and wall gives one half-plane of permitted
velocities; the new velocity is the permitted one nearest to the preferred one (a linear programme
in 2D), or, in a crowd so dense that nothing is permitted, the one that violates the half-planes of
moving neighbours least (a linear programme in 3D, section 5.2 there).

A half-plane is a row (x, y, dx, dy): velocities to the left of the line through (x, y) [m/s] with
unit direction (dx, dy) are permitted.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled

AGENT_HORIZON = 2.0
"""Time for which a velocity must be free of collisions with people and robots [s]."""

STATIC_HORIZON = 1.0
"""The same for obstacles and walls [s]."""

NEIGHBOUR_DISTANCE = 5.0
"""Centre distance beyond which people and robots are not considered [m]."""

_SLACK = 1e-6
"""By which a wall has to be out of reach at least to be left out unmeasured [m]."""
_PARALLEL = 1e-9
"""Sine of the angle below which two lines count as parallel."""


@compiled()
def orca_velocities(
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    preferred: NDArray[np.float64],
    max_speed: NDArray[np.float64],
    radius: NDArray[np.float64],
    seen: NDArray[np.bool_],
    robot_position: NDArray[np.float64],
    robot_velocity: NDArray[np.float64],
    robot_radius: float,
    responsibility: float,
    obstacles: NDArray[np.float64],
    walls: NDArray[np.float64],
    step: float,
    out: NDArray[np.float64],
) -> None:
    """Write the ORCA velocity of every pedestrian into ``out``.

    All pedestrians decide from the same snapshot. Arrays are float64 and C-contiguous, in the
    world frame.

    Args:
        position: (P, 2) centres [m].
        velocity: (P, 2) current velocities [m/s].
        preferred: (P, 2) velocities they would like to have [m/s].
        max_speed: (P,) [m/s].
        radius: (P,) [m].
        seen: (P, R) which pedestrian takes which robot into account.
        robot_position: (R, 2) [m].
        robot_velocity: (R, 2) [m/s].
        robot_radius: of every robot [m].
        responsibility: share of an evasion that a pedestrian takes on when meeting a robot;
            between pedestrians it is 1/2, with obstacles and walls 1.
        obstacles: (K, 3) x, y, radius of static discs [m].
        walls: (S, 4) segments x1, y1, x2, y2 [m].
        step: time until the next decision; overlaps are to be resolved within it [s].
        out: (P, 2) new velocities [m/s].
    """
    orca_velocities_with(
        AGENT_HORIZON,
        STATIC_HORIZON,
        NEIGHBOUR_DISTANCE,
        position,
        velocity,
        preferred,
        max_speed,
        radius,
        seen,
        robot_position,
        robot_velocity,
        robot_radius,
        responsibility,
        obstacles,
        walls,
        step,
        out,
    )


@compiled(inline="always")
def orca_velocities_with(
    agent_horizon: float,
    static_horizon: float,
    neighbour_distance: float,
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    preferred: NDArray[np.float64],
    max_speed: NDArray[np.float64],
    radius: NDArray[np.float64],
    seen: NDArray[np.bool_],
    robot_position: NDArray[np.float64],
    robot_velocity: NDArray[np.float64],
    robot_radius: float,
    responsibility: float,
    obstacles: NDArray[np.float64],
    walls: NDArray[np.float64],
    step: float,
    out: NDArray[np.float64],
) -> None:
    """Do the work of ``orca_velocities`` with other horizons [s] and neighbour distance [m]."""
    people, robots = len(position), len(robot_position)
    lines = np.empty((len(walls) + len(obstacles) + people + robots, 4))
    projected = np.empty_like(lines)
    for p in range(people):
        x, y, vx, vy = position[p, 0], position[p, 1], velocity[p, 0], velocity[p, 1]
        count = np.int64(0)  # no literal: numba would compile everything below for it as well
        for s in range(len(walls)):
            if _wall_line(
                x, y, walls[s], radius[p], static_horizon, step, max_speed[p], lines[count]
            ):
                count += 1
        for k in range(len(obstacles)):
            dx, dy, reach = obstacles[k, 0] - x, obstacles[k, 1] - y, radius[p] + obstacles[k, 2]
            # A disc that cannot be reached within the horizon forbids nothing.
            if dx * dx + dy * dy < (reach + max_speed[p] * static_horizon) ** 2:
                _disc_line(dx, dy, vx, vy, 0.0, 0.0, reach, static_horizon, step, 1.0, lines[count])
                count += 1
        static = count
        for q in range(people):
            dx, dy = position[q, 0] - x, position[q, 1] - y
            if q != p and dx * dx + dy * dy < neighbour_distance * neighbour_distance:
                ux, uy, reach = velocity[q, 0], velocity[q, 1], radius[p] + radius[q]
                _disc_line(dx, dy, vx, vy, ux, uy, reach, agent_horizon, step, 0.5, lines[count])
                count += 1
        for r in range(robots):
            dx, dy = robot_position[r, 0] - x, robot_position[r, 1] - y
            if seen[p, r] and dx * dx + dy * dy < neighbour_distance * neighbour_distance:
                ux, uy, reach = robot_velocity[r, 0], robot_velocity[r, 1], radius[p] + robot_radius
                _disc_line(
                    dx,
                    dy,
                    vx,
                    vy,
                    ux,
                    uy,
                    reach,
                    agent_horizon,
                    step,
                    responsibility,
                    lines[count],
                )
                count += 1
        wx, wy = preferred[p, 0], preferred[p, 1]
        failed, rx, ry = _nearest_velocity(lines, count, max_speed[p], wx, wy, 0.0)
        if failed < count:
            rx, ry = _least_violation(lines, count, static, failed, max_speed[p], rx, ry, projected)
        out[p, 0], out[p, 1] = rx, ry


@compiled()
def _disc_line(dx, dy, vx, vy, ux, uy, reach, horizon, step, share, line):  # type: ignore[no-untyped-def]
    """Half-plane of a disc at (dx, dy) that moves with (ux, uy) (section 4 of the paper).

    The velocity obstacle in relative velocities is a cone with its apex at 0 that touches the disc
    of radius ``reach`` around (dx, dy), cut off by that disc scaled by 1 / horizon. The half-plane
    touches it at the boundary point nearest to the relative velocity, after moving by ``share`` of
    the way there.
    """
    rx, ry = vx - ux, vy - uy
    distance2, reach2 = dx * dx + dy * dy, reach * reach
    overlap = distance2 <= reach2
    inverse = 1.0 / step if overlap else 1.0 / horizon
    # From the centre of the cut-off disc to the relative velocity.
    wx, wy = rx - inverse * dx, ry - inverse * dy
    along = wx * dx + wy * dy
    w2 = wx * wx + wy * wy
    if overlap or (along < 0.0 and along * along > reach2 * w2):
        w = math.sqrt(w2)
        if w > 0.0:
            nx, ny = wx / w, wy / w
        elif distance2 > 0.0:
            distance = math.sqrt(distance2)
            nx, ny = -dx / distance, -dy / distance
        else:
            nx, ny = 1.0, 0.0
        size = reach * inverse - w
        line[2], line[3] = ny, -nx
        cx, cy = size * nx, size * ny
    else:
        leg = math.sqrt(distance2 - reach2)
        if dx * wy - dy * wx > 0.0:
            line[2] = (dx * leg - dy * reach) / distance2
            line[3] = (dx * reach + dy * leg) / distance2
        else:
            line[2] = -(dx * leg + dy * reach) / distance2
            line[3] = -(dy * leg - dx * reach) / distance2
        dot = rx * line[2] + ry * line[3]
        cx, cy = dot * line[2] - rx, dot * line[3] - ry
    line[0], line[1] = vx + share * cx, vy + share * cy


@compiled(inline="always")
def _wall_line(x, y, wall, radius, horizon, step, max_speed, line):  # type: ignore[no-untyped-def]
    """Half-plane of a wall (section 5.3: static obstacles, with optimisation velocity 0).

    The speed towards the nearest point of the segment may not use up the gap within the horizon.
    A segment is convex, so this separates from all of it, and standing still stays permitted.
    Returns whether the wall is near enough to matter.
    """
    far = radius + max_speed * horizon + _SLACK
    if (
        max(wall[0], wall[2]) < x - far
        or min(wall[0], wall[2]) > x + far
        or max(wall[1], wall[3]) < y - far
        or min(wall[1], wall[3]) > y + far
    ):
        return False
    ex, ey = wall[2] - wall[0], wall[3] - wall[1]
    length2 = ex * ex + ey * ey
    t = ((x - wall[0]) * ex + (y - wall[1]) * ey) / length2 if length2 > 0.0 else 0.0
    t = min(1.0, max(0.0, t))
    nx, ny = wall[0] + t * ex - x, wall[1] + t * ey - y
    distance = math.hypot(nx, ny)
    gap = distance - radius
    if gap > max_speed * horizon or distance == 0.0:
        return False
    nx, ny = nx / distance, ny / distance
    speed = gap / horizon if gap >= 0.0 else gap / step
    line[0], line[1], line[2], line[3] = speed * nx, speed * ny, -ny, nx
    return True


@compiled(inline="always")
def _on_line(lines, i, max_speed, wx, wy, as_direction):  # type: ignore[no-untyped-def]
    """Best permitted velocity on line i given lines 0..i-1: (feasible, x, y)."""
    px, py, dx, dy = lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3]
    along = px * dx + py * dy
    inside = along * along + max_speed * max_speed - px * px - py * py
    if inside < 0.0:
        return False, 0.0, 0.0
    root = math.sqrt(inside)
    low, high = -along - root, -along + root
    for j in range(i):
        cross = dx * lines[j, 3] - dy * lines[j, 2]
        offset = lines[j, 2] * (py - lines[j, 1]) - lines[j, 3] * (px - lines[j, 0])
        if abs(cross) <= _PARALLEL:
            if offset < 0.0:
                return False, 0.0, 0.0
            continue
        t = offset / cross
        if cross >= 0.0:
            high = min(high, t)
        else:
            low = max(low, t)
        if low > high:
            return False, 0.0, 0.0
    if as_direction > 0.0:
        t = high if wx * dx + wy * dy > 0.0 else low
    else:
        t = min(high, max(low, dx * (wx - px) + dy * (wy - py)))
    return True, px + t * dx, py + t * dy


@compiled()
def _nearest_velocity(lines, count, max_speed, wx, wy, as_direction):  # type: ignore[no-untyped-def]
    """Permitted velocity nearest to (wx, wy), or farthest along it if that is a direction.

    ``as_direction`` is 1.0 or 0.0: for a bool numba would compile this once for either value.
    Returns (i, x, y): i is the first line that cannot be satisfied together with those before it,
    ``count`` if there is none; (x, y) satisfies all lines before i.
    """
    speed = math.hypot(wx, wy)
    if speed > max_speed or (as_direction > 0.0 and speed > 0.0):
        x, y = wx * max_speed / speed, wy * max_speed / speed
    else:
        x, y = wx, wy
    for i in range(count):
        if lines[i, 2] * (lines[i, 1] - y) - lines[i, 3] * (lines[i, 0] - x) > 0.0:
            feasible, nx, ny = _on_line(lines, i, max_speed, wx, wy, as_direction)
            if not feasible:
                return i, x, y
            x, y = nx, ny
    return count, x, y


@compiled(inline="always")
def _least_violation(lines, count, static, begin, max_speed, x, y, projected):  # type: ignore[no-untyped-def]
    """Velocity whose largest violation of a moving neighbour's half-plane is least.

    The half-planes before ``static`` stay hard. Each line violated more than the worst so far
    becomes the worst; where its violation equals that of an earlier one is again a line, which
    bounds a problem in 2D.
    """
    worst = 0.0
    for i in range(begin, count):
        px, py, dx, dy = lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3]
        if dx * (py - y) - dy * (px - x) <= worst:
            continue
        kept = np.int64(0)
        for j in range(static):
            for column in range(4):  # assigning the row compiles numpy's message about shapes too
                projected[kept, column] = lines[j, column]
            kept += 1
        for j in range(static, i):
            qx, qy, ex, ey = lines[j, 0], lines[j, 1], lines[j, 2], lines[j, 3]
            cross = dx * ey - dy * ex
            if abs(cross) <= _PARALLEL:
                if dx * ex + dy * ey > 0.0:
                    continue
                projected[kept, 0], projected[kept, 1] = 0.5 * (px + qx), 0.5 * (py + qy)
            else:
                t = (ex * (py - qy) - ey * (px - qx)) / cross
                projected[kept, 0], projected[kept, 1] = px + t * dx, py + t * dy
            fx, fy = ex - dx, ey - dy
            norm = math.hypot(fx, fy)
            projected[kept, 2], projected[kept, 3] = fx / norm, fy / norm
            kept += 1
        failed, nx, ny = _nearest_velocity(projected, kept, max_speed, -dy, dx, 1.0)
        if failed == kept:
            x, y = nx, ny
        worst = dx * (py - y) - dy * (px - x)
    return x, y
