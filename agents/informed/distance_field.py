"""Lengths of the shortest paths to a goal past obstacles and walls, tabulated on a grid."""

from __future__ import annotations

import math

import numpy as np
from crowdbench_agents.informed.eikonal import CELL, UNREACHABLE, lengths_among

from crowdbench.compiled import compiled

MARGIN = 2.0
"""How far the grid reaches beyond everything of interest [m]."""
CORNERS = 12
"""Way points around each obstacle."""


class DistanceField:
    """Shortest-path lengths to one goal, past discs and walls.

    Attributes:
        origin: (2,) position of the first grid point [m].
        values: (X, Y) length of the shortest path from each grid point [m]; empty without
            obstacles, where the straight line is the shortest path.
        winds: whether ways may lead around walls.
    """

    def __init__(self, goal, start, obstacles, walls, clearance):
        """Tabulate.

        Args:
            goal, start: (2,) [m].
            obstacles: (K, 3) x, y, radius [m].
            walls: (S, 4) x1, y1, x2, y2 [m].
            clearance: distance that the way keeps from both [m].
        """
        self.winds = not _beside(walls)
        places = np.vstack([goal, start, obstacles[:, :2]])
        if self.winds:
            places = np.vstack([places, walls[:, :2], walls[:, 2:]])
        self.origin = places.min(axis=0) - MARGIN
        self.values = np.empty((0, 0))
        if len(obstacles) or self.winds:
            size = np.ceil((places.max(axis=0) + MARGIN - self.origin) / CELL).astype(int) + 1
            self.values = np.empty(tuple(size))
        if self.winds:
            for margin in (clearance, clearance / 2):
                lengths_among(
                    np.asarray(goal, dtype=float),
                    obstacles,
                    walls,
                    margin,
                    self.origin,
                    self.values,
                )
                if look_up(*start, *goal, self.origin, self.values) < UNREACHABLE:
                    break
        elif len(obstacles):
            discs = obstacles + np.array([0.0, 0.0, clearance])
            _fill(np.asarray(goal, dtype=float), discs, walls, clearance, self.origin, self.values)


def _beside(walls):
    """Whether walls only bound a corridor: none, or two alike beside each other."""
    if len(walls) != 2:
        return len(walls) == 0
    one, other = walls
    along = one[2:] - one[:2]
    return bool((one[[0, 2]] == other[[0, 2]]).all() and along[1] == 0.0 and other[1] == other[3])


@compiled()
def look_up(x, y, goal_x, goal_y, origin, values):
    """Length of the shortest path from (x, y) to the goal [m], interpolated."""
    straight = math.hypot(goal_x - x, goal_y - y)
    i, j = (x - origin[0]) / CELL, (y - origin[1]) / CELL
    if values.size == 0 or not (0 <= i < len(values) - 1 and 0 <= j < values.shape[1] - 1):
        return straight
    a, b = int(i), int(j)
    s, t = i - a, j - b
    near = (1 - s) * ((1 - t) * values[a, b] + t * values[a, b + 1])
    return max(straight, near + s * ((1 - t) * values[a + 1, b] + t * values[a + 1, b + 1]))


@compiled()
def _fill(goal, discs, walls, clearance, origin, values):
    """A visibility graph over way points around the discs, then its nearest node per cell."""
    nodes = np.empty((1 + CORNERS * len(discs), 2))
    nodes[0] = goal
    count = 1
    for k in range(len(discs)):
        # On the circle around the polygon's corners its edges clear the disc.
        reach = discs[k, 2] / math.cos(math.pi / CORNERS) + 1e-6
        for c in range(CORNERS):
            angle = 2 * math.pi * c / CORNERS
            x, y = discs[k, 0] + reach * math.cos(angle), discs[k, 1] + reach * math.sin(angle)
            if _blocked(x, y, x, y, discs) or _at_wall(x, y, goal, walls, clearance):
                continue
            nodes[count, 0], nodes[count, 1] = x, y
            count += 1
    length = np.full(count, np.inf)
    length[0] = 0.0
    settled = np.zeros(count, dtype=np.bool_)
    for _ in range(count):
        best = -1
        for n in range(count):
            if not settled[n] and length[n] < np.inf and (best < 0 or length[n] < length[best]):
                best = n
        if best < 0:
            break
        settled[best] = True
        for n in range(count):
            if not settled[n]:
                step = math.hypot(nodes[n, 0] - nodes[best, 0], nodes[n, 1] - nodes[best, 1])
                if length[best] + step < length[n] and not _blocked(
                    nodes[n, 0], nodes[n, 1], nodes[best, 0], nodes[best, 1], discs
                ):
                    length[n] = length[best] + step
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            x, y, depth = _outside(origin[0] + i * CELL, origin[1] + j * CELL, discs)
            best_length = np.inf
            for n in range(count):
                through = length[n] + math.hypot(nodes[n, 0] - x, nodes[n, 1] - y)
                if through < best_length and not _blocked(x, y, nodes[n, 0], nodes[n, 1], discs):
                    best_length = through
            straight = math.hypot(goal[0] - x, goal[1] - y)
            values[i, j] = (best_length if best_length < np.inf else straight) + 2.0 * depth


@compiled()
def _outside(x, y, discs):
    """The nearest point on the rim of the disc a point is in, and how deep it is in [m].

    Depth costs double, or the way through an obstacle's margin would look like a short cut.
    """
    for k in range(len(discs)):
        dx, dy = x - discs[k, 0], y - discs[k, 1]
        distance = max(math.hypot(dx, dy), 1e-9)
        if distance < discs[k, 2]:
            scale = (discs[k, 2] + 1e-6) / distance
            return discs[k, 0] + scale * dx, discs[k, 1] + scale * dy, discs[k, 2] - distance
    return x, y, 0.0


@compiled()
def _blocked(x1, y1, x2, y2, discs):
    """Whether a segment enters a disc; discs around its first point do not count."""
    dx, dy = x2 - x1, y2 - y1
    length2 = max(dx * dx + dy * dy, 1e-12)
    for k in range(len(discs)):
        radius2 = discs[k, 2] * discs[k, 2]
        px, py = discs[k, 0] - x1, discs[k, 1] - y1
        if px * px + py * py < radius2 and length2 > 1e-12:
            continue
        t = min(1.0, max(0.0, (px * dx + py * dy) / length2))
        ex, ey = px - t * dx, py - t * dy
        if ex * ex + ey * ey < radius2:
            return True
    return False


@compiled()
def _at_wall(x, y, goal, walls, clearance):
    """Whether a point is too near to a wall or on the other side of it."""
    for s in range(len(walls)):
        ex, ey = walls[s, 2] - walls[s, 0], walls[s, 3] - walls[s, 1]
        length = max(math.hypot(ex, ey), 1e-9)
        side = (ex * (y - walls[s, 1]) - ey * (x - walls[s, 0])) / length
        goal_side = (ex * (goal[1] - walls[s, 1]) - ey * (goal[0] - walls[s, 0])) / length
        if side * goal_side < 0.0 or abs(side) < clearance:
            return True
    return False
