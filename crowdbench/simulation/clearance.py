"""Clearance: how near straight lines come to walls.

Walls are *cores*, rows x1, y1, x2, y2 [m], then x_min, y_min, x_max, y_max of the box around what
is nearer to each than its reach. Nothing here is rounded differently by another processor.
"""

from __future__ import annotations

import math

from crowdbench.compiled import compiled

TOLERANCE = 1e-9
"""Depth at which a way still counts as touching, not entering; ways this alike are equal [m]."""


@compiled()
def sees(ax, ay, bx, by, cores, reach, share):  # type: ignore[no-untyped-def]
    """Whether the straight line from a to b keeps ``share`` of the reach from all cores.

    An end that is nearer to a core than that may be left, and reached, as near as it is. ``reach``
    may be smaller than that of the ``Ways``, never larger.
    """
    low_x, high_x = min(ax, bx), max(ax, bx)
    low_y, high_y = min(ay, by), max(ay, by)
    for i in range(len(cores)):
        if (
            cores[i, 4] > high_x
            or cores[i, 5] > high_y
            or cores[i, 6] < low_x
            or cores[i, 7] < low_y
        ):
            continue
        x1, y1, x2, y2 = cores[i, 0], cores[i, 1], cores[i, 2], cores[i, 3]
        keep = reach[i] * share
        if _beside(ax, ay, bx, by, x1, y1, x2, y2, keep) or _beside(
            x1, y1, x2, y2, ax, ay, bx, by, keep
        ):
            continue
        between = gap_between(ax, ay, bx, by, x1, y1, x2, y2)
        if between < keep - TOLERANCE:
            nearer = min(distance(ax, ay, x1, y1, x2, y2), distance(bx, by, x1, y1, x2, y2))
            if between < nearer - TOLERANCE:
                return False
    return True


@compiled()
def _beside(ax, ay, bx, by, x1, y1, x2, y2, keep):  # type: ignore[no-untyped-def]
    """Whether a segment lies beside the line through a and b, farther from it than ``keep``."""
    ex, ey = bx - ax, by - ay
    one, two = ex * (y1 - ay) - ey * (x1 - ax), ex * (y2 - ay) - ey * (x2 - ax)
    least = keep * keep * (ex * ex + ey * ey)
    return one * two > 0.0 and one * one > least and two * two > least


@compiled()
def is_free(x, y, cores, reach):  # type: ignore[no-untyped-def]
    """Whether a point keeps its distance from all cores."""
    for i in range(len(cores)):
        gap = distance(x, y, cores[i, 0], cores[i, 1], cores[i, 2], cores[i, 3])
        if gap < reach[i] - TOLERANCE:
            return False
    return True


@compiled()
def gap_between(ax, ay, bx, by, x1, y1, x2, y2):  # type: ignore[no-untyped-def]
    """Distance between two segments."""
    one = (bx - ax) * (y1 - ay) - (by - ay) * (x1 - ax)
    two = (bx - ax) * (y2 - ay) - (by - ay) * (x2 - ax)
    if one * two < 0.0:
        one = (x2 - x1) * (ay - y1) - (y2 - y1) * (ax - x1)
        two = (x2 - x1) * (by - y1) - (y2 - y1) * (bx - x1)
        if one * two < 0.0:
            return 0.0
    return min(
        min(distance(ax, ay, x1, y1, x2, y2), distance(bx, by, x1, y1, x2, y2)),
        min(distance(x1, y1, ax, ay, bx, by), distance(x2, y2, ax, ay, bx, by)),
    )


@compiled()
def distance(x, y, x1, y1, x2, y2):  # type: ignore[no-untyped-def]
    """Distance of a point from a segment."""
    ex, ey = x2 - x1, y2 - y1
    square = ex * ex + ey * ey
    t = ((x - x1) * ex + (y - y1) * ey) / square if square > 0.0 else 0.0
    t = min(1.0, max(0.0, t))
    dx, dy = x1 + t * ex - x, y1 + t * ey - y
    return math.sqrt(dx * dx + dy * dy)


@compiled()
def find_clear(begin, end, cores, reach, clear):  # type: ignore[no-untyped-def]
    """Write into ``clear`` (N,) which lines from ``begin`` to ``end`` (N, 2) keep the reach.

    All of it, also where an end is nearer.
    """
    last = 0
    for i in range(len(begin)):
        ax, ay, bx, by = begin[i, 0], begin[i, 1], end[i, 0], end[i, 1]
        clear[i] = True
        for k in range(-1, len(cores)):
            j = last if k < 0 else k  # what the line before comes too near to is often in the way
            if (
                min(ax, bx) <= cores[j, 6]
                and max(ax, bx) >= cores[j, 4]
                and min(ay, by) <= cores[j, 7]
                and max(ay, by) >= cores[j, 5]
            ):
                x1, y1, x2, y2 = cores[j, 0], cores[j, 1], cores[j, 2], cores[j, 3]
                if gap_between(ax, ay, bx, by, x1, y1, x2, y2) < reach[j] - TOLERANCE:
                    clear[i], last = False, j
                    break
