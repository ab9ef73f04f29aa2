"""Lengths of shortest paths among walls, on a grid: the eikonal equation by fast sweeping.

Zhao, "A fast sweeping method for Eikonal equations", Mathematics of Computation 74, 2005. Where the
goal can be seen, lengths are exact; behind corners they are a few per cent too long.
"""

from __future__ import annotations

import math

import numpy as np

from crowdbench.compiled import compiled

CELL = 0.1
"""Grid spacing [m]."""
UNREACHABLE = 1e4
"""Length from places without a way [m]; what is added to it leads back to where there is one."""


@compiled()
def lengths_among(goal, obstacles, walls, clearance, origin, values):
    """Write the length of the shortest path from each grid point to a goal.

    Args:
        goal: (2,) [m].
        obstacles: (K, 3) x, y, radius [m].
        walls: (S, 4) x1, y1, x2, y2 [m].
        clearance: distance that the way keeps from both [m].
        origin: (2,) of the grid [m].
        values: (X, Y) written [m]. Nearer than ``clearance``, the way out costs double.
    """
    free = np.empty(values.shape, dtype=np.bool_)
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            x, y = origin[0] + i * CELL, origin[1] + j * CELL
            free[i, j] = _gap(x, y, x, y, obstacles, walls) >= clearance
            values[i, j] = UNREACHABLE
            dx, dy = goal[0] - x, goal[1] - y
            near = dx * dx + dy * dy <= 2.0 * CELL * CELL
            if near or (free[i, j] and _gap(x, y, goal[0], goal[1], obstacles, walls) >= clearance):
                values[i, j] = math.sqrt(dx * dx + dy * dy)
    changed = True
    while changed:
        changed = _sweep(values, free, CELL, True)
    changed = True
    while changed:
        changed = _sweep(values, free, 2.0 * CELL, False)


@compiled()
def _sweep(values, free, cost, which):
    """Go through the grid in all four orders, over the points that are free or not (``which``).

    Returns whether something became nearer by more than a tenth of a millimetre.
    """
    rows, columns = values.shape
    changed = False
    for order in range(4):
        for k in range(rows):
            i = k if order < 2 else rows - 1 - k
            for m in range(columns):
                j = m if order % 2 == 0 else columns - 1 - m
                if free[i, j] != which:
                    continue
                a = _least(values, i - 1, j, i + 1, j)
                b = _least(values, i, j - 1, i, j + 1)
                length = min(a, b) + cost
                if abs(a - b) < cost:
                    length = 0.5 * (a + b + math.sqrt(2.0 * cost * cost - (a - b) * (a - b)))
                if length < values[i, j]:
                    changed = changed or length < values[i, j] - 1e-4
                    values[i, j] = length
    return changed


@compiled()
def _least(values, i, j, k, m):
    """The lesser of two entries; those outside the grid do not count."""
    least = UNREACHABLE
    if 0 <= i < values.shape[0] and 0 <= j < values.shape[1]:
        least = values[i, j]
    if 0 <= k < values.shape[0] and 0 <= m < values.shape[1]:
        least = min(least, values[k, m])
    return least


@compiled()
def _gap(x1, y1, x2, y2, obstacles, walls):
    """Least distance of a segment from obstacles and walls [m]."""
    least = math.inf
    for k in range(len(obstacles)):
        least = min(
            least, _apart(obstacles[k, 0], obstacles[k, 1], x1, y1, x2, y2) - obstacles[k, 2]
        )
    for s in range(len(walls)):
        x3, y3, x4, y4 = walls[s, 0], walls[s, 1], walls[s, 2], walls[s, 3]
        if _side(x1, y1, x2, y2, x3, y3) * _side(x1, y1, x2, y2, x4, y4) < 0.0 and (
            _side(x3, y3, x4, y4, x1, y1) * _side(x3, y3, x4, y4, x2, y2) < 0.0
        ):
            return 0.0
        least = min(least, _apart(x1, y1, x3, y3, x4, y4), _apart(x2, y2, x3, y3, x4, y4))
        least = min(least, _apart(x3, y3, x1, y1, x2, y2), _apart(x4, y4, x1, y1, x2, y2))
    return least


@compiled()
def _side(x1, y1, x2, y2, x, y):
    """Twice the area that a segment spans with a point, positive to its left."""
    return (x2 - x1) * (y - y1) - (y2 - y1) * (x - x1)


@compiled()
def _apart(x, y, x1, y1, x2, y2):
    """Distance of a point from a segment [m]."""
    ex, ey = x2 - x1, y2 - y1
    t = ((x - x1) * ex + (y - y1) * ey) / max(ex * ex + ey * ey, 1e-12)
    t = min(1.0, max(0.0, t))
    dx, dy = x1 + t * ex - x, y1 + t * ey - y
    return math.sqrt(dx * dx + dy * dy)
