"""Geometry of a rectangular robot, in numba, shared by the agents that look ahead."""

from __future__ import annotations

import math

import numpy as np

from crowdbench.compiled import compiled
from crowdbench.simulation.rounding import sum_of_products


@compiled()
def advance(x, y, heading, v, w, duration):
    """Pose [m, m, rad] after driving the arc of (v [m/s], w [rad/s]) for ``duration`` [s]."""
    half_turn = 0.5 * w * duration
    chord = v * duration
    if abs(half_turn) > 1e-9:
        chord *= math.sin(half_turn) / half_turn
    middle = heading + half_turn
    return x + chord * math.cos(middle), y + chord * math.sin(middle), heading + w * duration


@compiled()
def turned(points, cosine, sine):
    """(N, 2) vectors in a frame that is turned by an angle, counter-clockwise.

    What BLAS multiplies it rounds as the processor has it, and a single vector otherwise than two.
    """
    out = np.empty((len(points), 2))
    for i in range(len(points)):
        out[i, 0] = sum_of_products(points[i, 0], cosine, points[i, 1], sine)
        out[i, 1] = sum_of_products(points[i, 0], -sine, points[i, 1], cosine)
    return out


@compiled()
def _in_frame(x, y, cosine, sine, px, py):
    dx, dy = px - x, py - y
    return cosine * dx + sine * dy, cosine * dy - sine * dx


@compiled()
def point_gap(x, y, cosine, sine, half_length, half_width, px, py):
    """Signed distance from a rectangle at (x, y) with heading (cosine, sine) to a point [m].

    Negative inside. Subtract a radius for the gap to a disc.
    """
    ahead, aside = _in_frame(x, y, cosine, sine, px, py)
    ahead, aside = abs(ahead) - half_length, abs(aside) - half_width
    outside = math.hypot(max(ahead, 0.0), max(aside, 0.0))
    return outside + min(max(ahead, aside), 0.0)


@compiled()
def wall_gap(x, y, cosine, sine, half_length, half_width, wall):
    """Distance from a rectangle to a segment (x1, y1, x2, y2) [m]; -1 when they cross."""
    ax, ay = _in_frame(x, y, cosine, sine, wall[0], wall[1])
    bx, by = _in_frame(x, y, cosine, sine, wall[2], wall[3])
    ex, ey = bx - ax, by - ay
    enter, leave = 0.0, 1.0  # of the segment, between the rectangle's sides (Liang-Barsky)
    for start, change, half in ((ax, ex, half_length), (ay, ey, half_width)):
        if change != 0.0:
            one, two = (-half - start) / change, (half - start) / change
            enter, leave = max(enter, min(one, two)), min(leave, max(one, two))
        elif abs(start) > half:
            leave = -1.0
    if enter <= leave:
        return -1.0
    length2 = max(ex * ex + ey * ey, 1e-12)
    gap = min(
        point_gap(0.0, 0.0, 1.0, 0.0, half_length, half_width, ax, ay),
        point_gap(0.0, 0.0, 1.0, 0.0, half_length, half_width, bx, by),
    )
    for i in range(4):
        cx = half_length if i % 2 == 0 else -half_length
        cy = half_width if i < 2 else -half_width
        t = min(1.0, max(0.0, ((cx - ax) * ex + (cy - ay) * ey) / length2))
        gap = min(gap, math.hypot(cx - ax - t * ex, cy - ay - t * ey))
    return gap


@compiled()
def arc_gap(v, w, duration, checks, half_length, half_width, points):
    """Least distance from the robot to points (N, 2) while it drives an arc [m]; inf without any.

    The arc (v [m/s], w [rad/s]) begins at the origin.
    """
    least = np.inf
    for i in range(1, checks + 1):
        x, y, heading = advance(0.0, 0.0, 0.0, v, w, duration * i / checks)
        least = min(least, _points_gap(x, y, heading, half_length, half_width, points))
    return least


@compiled()
def line_gap(ahead, left, duration, checks, half_length, half_width, points):
    """The same as ``arc_gap`` for a robot that goes straight, at these speeds [m/s]."""
    least = np.inf
    for i in range(1, checks + 1):
        x, y = ahead * duration * i / checks, left * duration * i / checks
        least = min(least, _points_gap(x, y, 0.0, half_length, half_width, points))
    return least


@compiled()
def _points_gap(x, y, heading, half_length, half_width, points):
    """Distance from the robot at a pose to the nearest point [m]."""
    cosine, sine = math.cos(heading), math.sin(heading)
    least = np.inf
    for i in range(len(points)):
        gap = point_gap(x, y, cosine, sine, half_length, half_width, points[i, 0], points[i, 1])
        least = min(least, gap)
    return least
