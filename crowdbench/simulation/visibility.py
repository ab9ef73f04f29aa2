"""Visibility: which way points can be seen from where on a map, told by square cells.

Most of the way points that look near on a map lie behind walls. For every cell those are left out
that a single wall hides from everywhere in it, with the distance that is kept from the wall, so
that the others alone have to be looked for. What can be reached straight is never left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.simulation.clearance import gap_between

_SIDE = 0.5
"""Of a cell at least [m]."""
_MOST_WORK = 3e7
"""Cells times way points times walls; cells are larger where there are more."""
_SLACK = 1e-6
"""By which a line is nearer to a wall than it may be, at least, to count as blocked [m]."""

Array = NDArray[np.float64]


class Visibility(NamedTuple):
    """Way points that may be seen from each of C cells, as compiled functions take it.

    Attributes:
        corner: (2,) lowest x and y of all cells [m].
        side: of a cell [m].
        columns, rows: of the cells, C together.
        seen: numbers of the way points of all cells, ascending in each; at last all of them.
        begin: (C + 2,) where in ``seen`` each cell begins, then all way points, then the end.
    """

    corner: Array
    side: float
    columns: int
    rows: int
    seen: NDArray[np.int64]
    begin: NDArray[np.int64]


def visibility(nodes: Array, cores: Array, reach: Array) -> Visibility:
    """Find out what may be seen from where.

    Args:
        nodes: (N, 2) way points, each of them as far as the reach from all cores [m].
        cores: (M, 8) as in ``crowdbench.simulation.clearance`` [m].
        reach: (M,) distance to keep from each core [m].
    """
    points = np.vstack([nodes, cores[:, 4:6], cores[:, 6:8], np.zeros((1, 2))])
    corner, size = points.min(axis=0), np.ptp(points, axis=0)
    cells = max(1.0, _MOST_WORK / max(1, len(nodes) * len(cores)))
    side = max(_SIDE, math.sqrt(size[0] * size[1] / cells), size.max() / cells)
    columns, rows = (int(extent / side) + 1 for extent in size.tolist())
    may_see = np.ones((columns * rows + 1, len(nodes)), dtype=np.bool_)
    _leave_out_hidden(nodes, cores, reach, corner, side, columns, may_see[:-1])
    counts = np.count_nonzero(may_see, axis=1)
    begin = np.concatenate([[0], np.cumsum(counts)])
    return Visibility(corner, side, columns, rows, np.nonzero(may_see)[1], begin)


@compiled()
def cell_at(x, y, visibility):  # type: ignore[no-untyped-def]
    """The cell of a place; outside of all of them the one that sees everything."""
    column = math.floor((x - visibility.corner[0]) / visibility.side)
    row = math.floor((y - visibility.corner[1]) / visibility.side)
    if 0 <= column < visibility.columns and 0 <= row < visibility.rows:
        return row * visibility.columns + column
    return visibility.columns * visibility.rows


@compiled()
def _leave_out_hidden(
    nodes: Array,
    cores: Array,
    reach: Array,
    corner: Array,
    side: float,
    columns: int,
    may_see: NDArray[np.bool_],
) -> None:
    """Take out of ``may_see`` (C, N) what one core hides from a whole cell."""
    keep = np.empty(len(cores))
    for cell in range(len(may_see)):
        low_x = corner[0] + (cell % columns) * side - _SLACK
        low_y = corner[1] + (cell // columns) * side - _SLACK
        high_x, high_y = low_x + side + 2 * _SLACK, low_y + side + 2 * _SLACK
        for i in range(len(cores)):
            # Who is nearer to a wall than its reach may leave it without coming nearer.
            gap = _gap_to_box(cores[i], low_x, low_y, high_x, high_y)
            keep[i] = min(reach[i], gap) - _SLACK
        last = 0
        for k in range(len(nodes)):
            x, y = nodes[k, 0], nodes[k, 1]
            for j in range(-1, len(cores)):  # what hid the one before often hides this one
                i = last if j < 0 else j
                if _hides(cores[i], keep[i], x, y, low_x, low_y, high_x, high_y):
                    may_see[cell, k] = False
                    last = i
                    break


@compiled()
def _hides(core, keep, x, y, low_x, low_y, high_x, high_y):  # type: ignore[no-untyped-def]
    """Whether a core is nearer than ``keep`` to all lines from a point to places in a box.

    The places behind a wall, seen from a point, are convex: those between the corners are too.
    """
    if (
        keep <= 0.0
        or core[4] > max(x, high_x)
        or core[5] > max(y, high_y)
        or core[6] < min(x, low_x)
        or core[7] < min(y, low_y)
    ):
        return False
    x1, y1, x2, y2 = core[0], core[1], core[2], core[3]
    return (
        gap_between(x, y, low_x, low_y, x1, y1, x2, y2) < keep
        and gap_between(x, y, high_x, high_y, x1, y1, x2, y2) < keep
        and gap_between(x, y, low_x, high_y, x1, y1, x2, y2) < keep
        and gap_between(x, y, high_x, low_y, x1, y1, x2, y2) < keep
    )


@compiled()
def _gap_to_box(core, low_x, low_y, high_x, high_y):  # type: ignore[no-untyped-def]
    """Distance between a core and a box, 0 where they overlap."""
    x1, y1, x2, y2 = core[0], core[1], core[2], core[3]
    if low_x <= x1 <= high_x and low_y <= y1 <= high_y:
        return 0.0
    return min(
        min(
            gap_between(low_x, low_y, high_x, low_y, x1, y1, x2, y2),
            gap_between(low_x, high_y, high_x, high_y, x1, y1, x2, y2),
        ),
        min(
            gap_between(low_x, low_y, low_x, high_y, x1, y1, x2, y2),
            gap_between(high_x, low_y, high_x, high_y, x1, y1, x2, y2),
        ),
    )
