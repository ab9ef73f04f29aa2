"""Geometry of a rectangular differential-drive robot, in numba, shared by the search planners."""

from __future__ import annotations

import math

import numba
import numpy as np


@numba.njit(cache=True)
def advance(x, y, heading, v, w, duration):
    """Pose [m, m, rad] after driving the arc of (v [m/s], w [rad/s]) for ``duration`` [s]."""
    half_turn = 0.5 * w * duration
    chord = v * duration
    if abs(half_turn) > 1e-9:
        chord *= math.sin(half_turn) / half_turn
    middle = heading + half_turn
    return x + chord * math.cos(middle), y + chord * math.sin(middle), heading + w * duration


@numba.njit(cache=True)
def point_gap(x, y, cosine, sine, half_length, half_width, px, py):
    """Signed distance from a rectangle at (x, y) with heading (cosine, sine) to a point [m].

    Negative inside. Subtract a radius for the gap to a disc.
    """
    dx, dy = px - x, py - y
    ahead = abs(cosine * dx + sine * dy) - half_length
    aside = abs(cosine * dy - sine * dx) - half_width
    outside = math.hypot(max(ahead, 0.0), max(aside, 0.0))
    return outside + min(max(ahead, aside), 0.0)


@numba.njit(cache=True)
def wall_gap(x, y, cosine, sine, half_length, half_width, wall):
    """Distance from a rectangle to a segment (x1, y1, x2, y2) [m]; -1 when they cross."""
    ex, ey = wall[2] - wall[0], wall[3] - wall[1]
    length2 = max(ex * ex + ey * ey, 1e-12)
    gap = min(
        point_gap(x, y, cosine, sine, half_length, half_width, wall[0], wall[1]),
        point_gap(x, y, cosine, sine, half_length, half_width, wall[2], wall[3]),
    )
    side = ex * (y - wall[1]) - ey * (x - wall[0])
    for i in range(4):
        ahead = half_length if i % 2 == 0 else -half_length
        aside = half_width if i < 2 else -half_width
        cx, cy = x + cosine * ahead - sine * aside, y + sine * ahead + cosine * aside
        t = ((cx - wall[0]) * ex + (cy - wall[1]) * ey) / length2
        if 0.0 <= t <= 1.0 and side * (ex * (cy - wall[1]) - ey * (cx - wall[0])) < 0.0:
            return -1.0
        t = min(1.0, max(0.0, t))
        gap = min(gap, math.hypot(cx - wall[0] - t * ex, cy - wall[1] - t * ey))
    return gap


@numba.njit(cache=True)
def arc_gap(v, w, duration, checks, half_length, half_width, lidar, beam_cos, beam_sin, reach):
    """Least distance from the robot to what a scan shows while it drives an arc [m].

    The arc (v [m/s], w [rad/s]) begins where the scan was taken; what is seen is taken to stand
    still. inf where nothing is seen.
    """
    least = np.inf
    for i in range(1, checks + 1):
        x, y, heading = advance(0.0, 0.0, 0.0, v, w, duration * i / checks)
        cosine, sine = math.cos(heading), math.sin(heading)
        for b in range(len(lidar)):
            if lidar[b] < reach - 1e-3:
                px, py = lidar[b] * beam_cos[b], lidar[b] * beam_sin[b]
                gap = point_gap(x, y, cosine, sine, half_length, half_width, px, py)
                least = min(least, gap)
    return least
