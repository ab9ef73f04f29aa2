"""Shortest ways of a disc among walls and round obstacles, as way points.

Grown by the disc's radius, every corner of the walls is round. Here it is the polygon around that
arc, with a way point at each of its corners, so a way is straight from point to point and never
nearer to a wall than the disc's radius. A shortest way among such polygons turns at their corners
only: it is found in the graph of those that see each other (Lozano-Perez and Wesley 1979). It is at
most 5.5 % of the arcs longer than the exact one (``crowdbench.evaluation.shortest_path``).

Nothing here is rounded differently by another processor: people follow these ways.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from crowdbench.compiled import compiled
from crowdbench.simulation.clearance import TOLERANCE, gap_between, is_free, sees
from crowdbench.simulation.visibility import Visibility, cell_at, visibility

Array = NDArray[np.float64]

PART = math.pi / 4
"""Largest part of an arc that one way point stands for [rad]."""
_SMALLEST_PART = PART / 8
"""Where other things are near, parts are halved, but not below this [rad]."""
SQUEEZED = 0.1
"""Share of the clearance that is kept by those who cannot keep all of it."""


class Network(NamedTuple):
    """Where ways lead, as compiled functions take it.

    Attributes:
        nodes: (N, 2) way points [m].
        between: (N, N) lengths of the shortest ways between them, inf where there is none [m].
        cores: (M, 8) walls, then obstacles as segments of no length, with the boxes around them as
            in ``crowdbench.simulation.clearance`` [m].
        reach: (M,) distance to keep from each core [m].
        visibility: which way points may be seen from where.
        necks: (K, 4) shortest lines across openings that are too narrow even to be squeezed
            through [m].
    """

    nodes: Array
    between: Array
    cores: Array
    reach: Array
    visibility: Visibility
    necks: Array


class Ways:
    """All shortest ways among fixed walls and obstacles.

    Attributes:
        network: where they lead.
    """

    def __init__(
        self,
        walls: Array,
        obstacles: Array,
        clearance: float,
        bounds: tuple[float, float, float, float] | None = None,
        narrowest: float = 0.0,
    ) -> None:
        """Find the way points and what lies between them.

        Args:
            walls: (S, 4) segments x1, y1, x2, y2 [m].
            obstacles: (K, 3) x, y, radius [m].
            clearance: least distance from walls and from the edges of obstacles [m].
            bounds: x_min, y_min, x_max, y_max that no way leaves [m].
            narrowest: width of an opening through which a way may lead from a place where the
                clearance cannot be kept, at most twice the clearance [m].
        """
        cores = np.concatenate([walls, obstacles[:, [0, 1, 0, 1]]])
        reach = np.concatenate([np.full(len(walls), float(clearance)), obstacles[:, 2] + clearance])
        ends, grown = cores.reshape(-1, 2, 2), reach[:, None]
        cores = np.hstack([cores, ends.min(axis=1) - grown, ends.max(axis=1) + grown])
        nodes = _way_points(cores, reach)
        if bounds is not None:
            low, high = np.array(bounds[:2]), np.array(bounds[2:])
            nodes = nodes[((nodes >= low) & (nodes <= high)).all(axis=1)]
        edges = np.zeros((len(nodes), len(nodes)))
        _connect(nodes, cores, reach, edges)
        between = np.asarray(dijkstra(csr_array(edges)))
        necks = _necks(cores, reach - clearance + narrowest / 2)
        seen = visibility(nodes, cores, reach)
        self.network = Network(nodes, between, cores, reach, seen, necks)

    def is_free(self, point: Array) -> bool:
        """Whether the disc fits at a point (2,) [m]."""
        cores, reach = self.network.cores, self.network.reach
        return bool(is_free(float(point[0]), float(point[1]), cores, reach))

    def remaining(self, goal: Array) -> Array:
        """(N,) length of the way from every way point to a goal (2,); inf: there is none [m]."""
        lengths = np.empty(len(self.network.nodes))
        lengths_to(float(goal[0]), float(goal[1]), self.network, lengths)
        return lengths

    def path(self, start: Array, goal: Array) -> Array:
        """(N, 2) way points of the shortest way, both ends included [m]; (0, 2): there is none.

        An end that is too near to a wall is left, or reached, without coming nearer to that wall.
        """
        remaining = self.remaining(goal)
        points = [(float(start[0]), float(start[1]))]
        end = (float(goal[0]), float(goal[1]))
        while points[-1] != end:
            x, y, length = next_point(*points[-1], *end, remaining, self.network)
            if length == math.inf or len(points) > len(remaining) + 1:
                return np.empty((0, 2))
            points.append((x, y))
        return np.array(points)

    def next_points(self, start: Array, goals: Array, remaining: Array) -> Array:
        """Where the shortest ways from one place to many goals lead next.

        Args:
            start: (2,) [m].
            goals: (K, 2) [m].
            remaining: (K, N) what ``remaining`` returns for each of them [m].

        Returns:
            (K, 3) x, y of the next point and the length of the whole way [m]. Without a way: the
            goal and inf.
        """
        found = np.empty((len(goals), 3))
        _next_points(float(start[0]), float(start[1]), goals, remaining, self.network, found)
        return found

    def length(self, start: Array, goal: Array) -> float:
        """Length of the shortest way [m]; inf: there is none."""
        ends = float(start[0]), float(start[1]), float(goal[0]), float(goal[1])
        return float(next_point(*ends, self.remaining(goal), self.network)[2])


def _way_points(cores: Array, reach: Array) -> Array:
    """(N, 2) corners of the polygons around what is round of the grown cores, where one can be.

    Where segments end in one point, at most one arc is left between them: opposite to them, if they
    leave more than half a turn.
    """
    ends: dict[tuple[float, float], list[int]] = {}
    for i, (x1, y1, x2, y2) in enumerate(cores[:, :4].tolist()):
        for end in {(x1, y1), (x2, y2)}:
            ends.setdefault(end, []).append(i)
    found: set[tuple[float, float]] = set()
    for end, incident in ends.items():
        # Segments of no length are circles, whatever else ends in their centre.
        discs = [i for i in incident if (cores[i, :2] == cores[i, 2:4]).all()]
        segments = [i for i in incident if i not in discs]
        for i in discs:
            found |= _corners(end, float(reach[i]), 0.0, 2 * math.pi, cores, reach)
        if segments:
            arc = _free_arc(*end, cores[segments, :4])
            around = _corners(end, float(reach[segments[0]]), *arc, cores, reach)
            # An end on another wall needs no way around it.
            others = np.delete(cores[:, :4], incident, axis=0).tolist()
            found |= {
                corner
                for corner in around
                if not any(gap_between(*end, *corner, *core) < TOLERANCE for core in others)
            }
    return np.array(sorted(found), dtype=np.float64).reshape(-1, 2)


def _necks(cores: Array, room: Array) -> Array:
    """(K, 4) shortest lines between two cores that are nearer than their ``room`` (M,) [m]."""
    low, high = cores[:, 4:6], cores[:, 6:8]
    i, j = np.nonzero(np.triu(((low[:, None] <= high) & (high[:, None] >= low)).all(axis=2), 1))
    ends = cores[:, :4].reshape(-1, 2, 2)
    one, other = (ends[[i, i, j, j], [[0], [1], [0], [1]]], ends[[j, j, i, i]])
    along, to = other[..., 1, :] - other[..., 0, :], one - other[..., 0, :]
    square = along[..., 0] * along[..., 0] + along[..., 1] * along[..., 1]
    dot = to[..., 0] * along[..., 0] + to[..., 1] * along[..., 1]
    share = np.clip(dot / np.where(square > 0.0, square, 1.0), 0.0, 1.0)[..., None]
    lines = np.concatenate([one, other[..., 0, :] + share * along], axis=2)  # (4, P, 4)
    dx, dy = lines[..., 2] - lines[..., 0], lines[..., 3] - lines[..., 1]
    gaps, pairs = np.sqrt(dx * dx + dy * dy), np.arange(len(i))
    nearest = gaps.argmin(axis=0)
    gap = gaps[nearest, pairs]
    narrow = (gap > 0.0) & (gap < room[i] + room[j])
    return np.asarray(lines[nearest, pairs][narrow])


def _free_arc(x: float, y: float, segments: Array) -> tuple[float, float]:
    """Begin and extent of the directions at right angles or more to all segments from a point."""
    angles = []
    for x1, y1, x2, y2 in segments.tolist():
        far = (x2, y2) if (x1, y1) == (x, y) else (x1, y1)
        angles.append(math.atan2(far[1] - y, far[0] - x))
    angles.sort()
    following = [*angles[1:], angles[0] + 2 * math.pi]
    gap, begin = max((b - a, a) for a, b in zip(angles, following, strict=True))
    return begin + math.pi / 2, max(0.0, gap - math.pi)


def _corners(
    centre: tuple[float, float],
    radius: float,
    begin: float,
    sweep: float,
    cores: Array,
    reach: Array,
) -> set[tuple[float, float]]:
    """Corners of the polygon that touches an arc at equal parts, where the disc can be.

    A part whose corner is taken may be free near the arc, so it is halved down to the smallest.
    """
    parts = max(1, math.ceil(sweep / PART - TOLERANCE))
    part = sweep / parts
    found = set()
    for k in range(parts if sweep > TOLERANCE else 0):
        angle, distance = begin + (k + 0.5) * part, radius / math.cos(part / 2)
        x, y = centre[0] + distance * math.cos(angle), centre[1] + distance * math.sin(angle)
        if is_free(x, y, cores, reach):
            found.add((x, y))
        elif part > _SMALLEST_PART:
            for half in (begin + k * part, begin + (k + 0.5) * part):
                found |= _corners(centre, radius, half, part / 2, cores, reach)
    return found


@compiled()
def _connect(nodes: Array, cores: Array, reach: Array, edges: Array) -> None:
    """Write the distances of way points that see each other into ``edges`` (N, N)."""
    for i in range(len(nodes)):
        for j in range(i):
            dx, dy = nodes[i, 0] - nodes[j, 0], nodes[i, 1] - nodes[j, 1]
            if sees(nodes[i, 0], nodes[i, 1], nodes[j, 0], nodes[j, 1], cores, reach, 1.0):
                edges[i, j] = edges[j, i] = math.sqrt(dx * dx + dy * dy)


@compiled()
def lengths_to(x, y, network, lengths):  # type: ignore[no-untyped-def]
    """Write the lengths of the ways from all way points to a goal (x, y) into ``lengths`` (N,)."""
    nodes, between, cores, reach = network.nodes, network.between, network.cores, network.reach
    seen, begin = network.visibility.seen, network.visibility.begin
    cell = cell_at(x, y, network.visibility)
    count = len(nodes)
    for i in range(count):
        lengths[i] = math.inf
    for j in range(begin[cell], begin[cell + 1]):
        k = seen[j]
        if sees(x, y, nodes[k, 0], nodes[k, 1], cores, reach, 1.0):
            dx, dy = nodes[k, 0] - x, nodes[k, 1] - y
            last = math.sqrt(dx * dx + dy * dy)
            for i in range(count):
                lengths[i] = min(lengths[i], last + between[k, i])


@compiled()
def _next_points(x, y, goals, remaining, network, found):  # type: ignore[no-untyped-def]
    """Write what ``next_point`` returns for goals (K, 2) into ``found`` (K, 3)."""
    for k in range(len(goals)):
        to_x, to_y, length = next_point(x, y, goals[k, 0], goals[k, 1], remaining[k], network)
        found[k, 0], found[k, 1], found[k, 2] = to_x, to_y, length


@compiled()
def _leads_through(ax, ay, bx, by, necks):  # type: ignore[no-untyped-def]
    """Whether the straight line from a to b crosses one of the necks."""
    for i in range(len(necks)):
        if gap_between(ax, ay, bx, by, necks[i, 0], necks[i, 1], necks[i, 2], necks[i, 3]) == 0.0:
            return True
    return False


@compiled()
def next_point(x, y, goal_x, goal_y, lengths, network):  # type: ignore[no-untyped-def]
    """Where the shortest way from (x, y) to a goal leads next, and how long all of it is.

    Args:
        x, y, goal_x, goal_y: [m].
        lengths: (N,) from the way points to the goal, as ``lengths_to`` writes them [m].
        network: of the ``Ways``.

    Returns:
        x, y of the next way point or of the goal, and the whole length [m]. Without a way: the
        goal and inf.
    """
    nodes, cores, reach = network.nodes, network.cores, network.reach
    seen, begin = network.visibility.seen, network.visibility.begin
    dx, dy = goal_x - x, goal_y - y
    if sees(x, y, goal_x, goal_y, cores, reach, 1.0):
        return goal_x, goal_y, math.sqrt(dx * dx + dy * dy)
    cell, share = cell_at(x, y, network.visibility), 1.0
    for _ in range(2):
        first = begin[cell]
        count = begin[cell + 1] - first
        values = np.empty(count)
        for j in range(count):
            k = seen[first + j]
            dx, dy = nodes[k, 0] - x, nodes[k, 1] - y
            values[j] = math.sqrt(dx * dx + dy * dy) + lengths[k]
        while True:
            best = np.int64(-1)
            for j in range(count):
                if values[j] == math.inf:
                    continue
                # Of equal ways the one whose next point is farther along: not the place itself.
                if (
                    best < 0
                    or values[j] < values[best] - TOLERANCE
                    or (
                        values[j] < values[best] + TOLERANCE
                        and lengths[seen[first + j]] < lengths[seen[first + best]]
                    )
                ):
                    best = j
            if best < 0:
                break
            k = seen[first + best]
            if sees(x, y, nodes[k, 0], nodes[k, 1], cores, reach, share) and (
                share == 1.0 or not _leads_through(x, y, nodes[k, 0], nodes[k, 1], network.necks)
            ):
                return nodes[k, 0], nodes[k, 1], values[best]
            values[best] = math.inf
        # Who cannot keep all of the distance squeezes past walls, but not through every opening.
        cell, share = network.visibility.columns * network.visibility.rows, SQUEEZED
    return goal_x, goal_y, math.inf
