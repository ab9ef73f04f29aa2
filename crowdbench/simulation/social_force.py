"""Social force: pedestrians as particles that are pulled to their goals and repelled by others.

Helbing and Molnar, "Social force model for pedestrian dynamics", Phys. Rev. E 51, 1995, with the
interaction that Moussaid et al. measured between walking people ("Experimental study of the
behavioural mechanisms underlying self-organization in human crowds", Proc. R. Soc. B 276, 2009):
people decelerate along, and swerve across, the direction of interaction. Symbols as there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled

RELAXATION_TIME = 0.54
"""tau: time in which the preferred velocity is regained [s]."""

INTERACTION_STRENGTH = 4.5
"""A [m/s^2]."""

INTERACTION_RANGE = 0.35
"""gamma: B = gamma |D|, how far an interaction reaches [s]."""

SWERVE_WIDTH = 2.0
"""n: how narrowly swerving concentrates on neighbours ahead."""

BRAKE_WIDTH = 3.0
"""n': how narrowly braking concentrates on neighbours ahead."""

VELOCITY_WEIGHT = 2.0
"""lambda: D = lambda (v_i - v_j) + e_ij."""

BOUNDARY_STRENGTH = 3.0
"""a: repulsion at the surface of a wall or obstacle [m/s^2]."""

BOUNDARY_RANGE = 0.1
"""b: distance over which it falls to 1/e [m]."""

NEIGHBOUR_DISTANCE = 5.0
"""Centre distance beyond which people and robots are not considered [m]."""


@compiled()
def social_force_velocities(
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
    """Write the velocity of every pedestrian after ``step`` seconds of social forces into ``out``.

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
        responsibility: weight of a robot against a person: 1/2 repels like a person, 1 twice
            as much, 0 not at all.
        obstacles: (K, 3) x, y, radius of static discs [m].
        walls: (S, 4) segments x1, y1, x2, y2 [m]; those with common ends are one wall.
        step: time for which the forces act [s].
        out: (P, 2) new velocities [m/s].
    """
    people, robots = len(position), len(robot_position)
    for p in range(people):
        x, y, vx, vy = position[p, 0], position[p, 1], velocity[p, 0], velocity[p, 1]
        ax = (preferred[p, 0] - vx) / RELAXATION_TIME
        ay = (preferred[p, 1] - vy) / RELAXATION_TIME
        for q in range(people):
            if q != p:
                fx, fy = _interaction(
                    position[q, 0] - x,
                    position[q, 1] - y,
                    vx - velocity[q, 0],
                    vy - velocity[q, 1],
                    radius[q] - radius[p],
                )
                ax += fx
                ay += fy
        for r in range(robots):
            if seen[p, r]:
                fx, fy = _interaction(
                    robot_position[r, 0] - x,
                    robot_position[r, 1] - y,
                    vx - robot_velocity[r, 0],
                    vy - robot_velocity[r, 1],
                    robot_radius - radius[p],
                )
                ax += 2.0 * responsibility * fx
                ay += 2.0 * responsibility * fy
        for k in range(len(obstacles)):
            fx, fy = _repulsion(
                x - obstacles[k, 0], y - obstacles[k, 1], radius[p] + obstacles[k, 2]
            )
            ax += fx
            ay += fy
        for s in range(len(walls)):
            t = _share_along(x, y, walls[s])
            if (t == 0.0 or t == 1.0) and _is_of_another(x, y, s, t, walls):
                continue
            ex, ey = walls[s, 2] - walls[s, 0], walls[s, 3] - walls[s, 1]
            fx, fy = _repulsion(x - walls[s, 0] - t * ex, y - walls[s, 1] - t * ey, radius[p])
            ax += fx
            ay += fy
        wx, wy = vx + step * ax, vy + step * ay
        speed = math.hypot(wx, wy)
        scale = max_speed[p] / speed if speed > max_speed[p] else 1.0
        out[p, 0], out[p, 1] = scale * wx, scale * wy


@compiled()
def _share_along(x, y, wall):  # type: ignore[no-untyped-def]
    """Where on a wall, between 0 and 1, the point nearest to (x, y) is."""
    ex, ey = wall[2] - wall[0], wall[3] - wall[1]
    length2 = ex * ex + ey * ey
    t = ((x - wall[0]) * ex + (y - wall[1]) * ey) / length2 if length2 > 0.0 else 0.0
    return min(1.0, max(0.0, t))


@compiled()
def _is_of_another(x, y, s, t, walls):  # type: ignore[no-untyped-def]
    """Whether the end ``t`` of wall ``s``, nearest to (x, y), belongs to a wall that repels there.

    A wall in pieces, or the corner of a polygon, so repels once: by the piece that comes nearest,
    or by the first one where that is the common end.
    """
    end_x, end_y = (walls[s, 0], walls[s, 1]) if t == 0.0 else (walls[s, 2], walls[s, 3])
    for other in range(len(walls)):
        for end in range(2):
            if walls[other, 2 * end] != end_x or walls[other, 2 * end + 1] != end_y:
                continue
            if other < s or (other > s and _share_along(x, y, walls[other]) != end):
                return True
    return False


@compiled()
def _interaction(dx, dy, rx, ry, extra):  # type: ignore[no-untyped-def]
    """Acceleration due to a neighbour at (dx, dy) [m], relative velocity v_i - v_j = (rx, ry).

    The parameters hold for centre distances between people; ``extra`` is how much larger the
    neighbour's radius is than one's own [m].
    """
    distance = math.hypot(dx, dy)
    if distance > NEIGHBOUR_DISTANCE or distance == 0.0:
        return 0.0, 0.0
    ex, ey = dx / distance, dy / distance
    Dx, Dy = VELOCITY_WEIGHT * rx + ex, VELOCITY_WEIGHT * ry + ey
    D = math.hypot(Dx, Dy)
    if D == 0.0:
        return 0.0, 0.0
    tx, ty = Dx / D, Dy / D
    theta = math.atan2(tx * ey - ty * ex, tx * ex + ty * ey)
    B = INTERACTION_RANGE * D
    strength = INTERACTION_STRENGTH * math.exp(-max(0.0, distance - extra) / B)
    brake = -strength * math.exp(-((BRAKE_WIDTH * B * theta) ** 2))
    swerve = strength * math.exp(-((SWERVE_WIDTH * B * theta) ** 2))
    # Away from the side the neighbour is on; straight ahead leaves no side to prefer.
    swerve *= -1.0 if theta > 0.0 else (1.0 if theta < 0.0 else 0.0)
    return brake * tx - swerve * ty, brake * ty + swerve * tx


@compiled()
def _repulsion(dx, dy, reach):  # type: ignore[no-untyped-def]
    """Acceleration away from a boundary point; (dx, dy) points from it to the pedestrian [m]."""
    distance = math.hypot(dx, dy)
    if distance == 0.0:
        return 0.0, 0.0
    force = BOUNDARY_STRENGTH * math.exp(-max(0.0, distance - reach) / BOUNDARY_RANGE)
    return force * dx / distance, force * dy / distance
