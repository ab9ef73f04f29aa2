"""Shortest collision-free path of a disc among round obstacles and wall segments, exactly.

Grown by the disc's radius, an obstacle is a larger disc and a wall is a capsule (the points nearer
to the segment than the radius). A shortest path among such shapes consists of arcs on their round
parts and of straight lines that touch them (Chang et al. 2005, "Shortest path amidst disc
obstacles is computable"), so it is a shortest path in the graph whose nodes are points of
tangency: no grid, no discretisation.

Both shapes are written alike: a core segment (of length zero for an obstacle) and a reach, the
distance that the path must keep from the core.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.libm import atan2

Array = NDArray[np.float64]

_TOLERANCE = 1e-9
"""Depth at which a path still counts as touching, not entering [m]."""
_TURN = 2 * np.pi
_BLOCK = 8
"""Cores with which arcs are compared at once."""


class _Lines(NamedTuple):
    begin: Array
    """(E, 2)"""
    end: Array
    """(E, 2)"""


class _Arcs(NamedTuple):
    centre: Array
    """(A, 2)"""
    radius: Array
    """(A,)"""
    angle: Array
    """(A,) direction from the centre to the clockwise end [rad]"""
    sweep: Array
    """(A,) counter-clockwise extent, 0 to 2 pi [rad]"""


class Route(NamedTuple):
    """The shortest path.

    Attributes:
        length: [m]; infinite when there is none.
        heading: direction in which it leaves the start [rad]; NaN when it leads nowhere.
        turning: how far it turns on the way, left and right added up [rad].
    """

    length: float
    heading: float = np.nan
    turning: float = 0.0


def shortest_path(
    start: Array, goal: Array, walls: Array, obstacles: Array, clearance: float
) -> float:
    """Length of ``shortest_route`` [m]; infinite when there is no such path."""
    return shortest_route(start, goal, walls, obstacles, clearance).length


def shortest_route(
    start: Array, goal: Array, walls: Array, obstacles: Array, clearance: float
) -> Route:
    """The shortest path from start to goal that keeps its distance.

    Obstacles are taken into account only once a path would enter them: the shortest path among
    some of the obstacles is never longer than the one among all, so as soon as it enters none of
    the others it is the answer.

    Args:
        start: (2,) [m].
        goal: (2,) [m].
        walls: (S, 4) segments x1, y1, x2, y2 [m].
        obstacles: (K, 3) x, y, radius [m].
        clearance: least distance from walls and from the edges of obstacles [m].
    """
    if np.array_equal(start, goal):
        return Route(0.0)
    cores = np.concatenate([walls, obstacles[:, [0, 1, 0, 1]]])
    reach = np.concatenate([np.full(len(walls), clearance), obstacles[:, 2] + clearance])
    straight = _Lines(start[None], goal[None])
    relevant = _enters(_line_gaps(straight, cores), reach)
    if not relevant.any():
        return Route(_lengths(straight).item(), _heading(straight))
    while True:
        length, lines, arcs = _path_among(start, goal, cores[relevant], reach[relevant])
        entered = _enters(_line_gaps(lines, cores), reach) | _enters(_arc_gaps(arcs, cores), reach)
        if np.isinf(length):
            return Route(length)
        if not np.any(entered & ~relevant):
            return Route(length, _heading(lines), float(arcs.sweep.sum()))
        relevant |= entered


def _path_among(
    start: Array, goal: Array, cores: Array, reach: Array
) -> tuple[float, _Lines, _Arcs]:
    """Shortest path in the graph of tangents to all of ``cores``.

    Returns:
        Its length, and its lines and its arcs from the goal back to the start.
    """
    # Start and goal are circles of radius 0. A core of length zero has one round end, others two.
    twin = np.any(cores[:, :2] != cores[:, 2:], axis=1)
    centre = np.concatenate([start[None], goal[None], cores[:, :2], cores[twin, 2:]])
    radius = np.concatenate([[0.0, 0.0], reach, reach[twin]])
    # Walls that meet in a corner share a circle there.
    _, first = np.unique(np.column_stack([centre, radius]), axis=0, return_index=True)
    distinct = np.sort(np.concatenate([[0, 1], first[first > 1]]))
    centre, radius = centre[distinct], radius[distinct]

    tail, tail_turn, head, head_turn, lines = _tangents(centre, radius)
    free = _clear_lines(lines, cores, reach)
    tail, tail_turn, head, head_turn = tail[free], tail_turn[free], head[free], head_turn[free]
    lines = _Lines(lines.begin[free], lines.end[free])

    # Nodes: 0 is the start, 1 the goal, then where each line leaves a circle, where it arrives.
    count = len(tail)
    leave = np.where(tail == 0, 0, 2 + np.arange(count))
    arrive = np.where(head == 1, 1, 2 + count + np.arange(count))

    on_circle = np.concatenate([tail, head]) > 1
    node = np.concatenate([leave, arrive])[on_circle]
    circle = np.concatenate([tail, head])[on_circle]
    turn = np.concatenate([tail_turn, head_turn])[on_circle]
    point = np.concatenate([lines.begin, lines.end])[on_circle]
    first, second, arcs = _arcs_between(circle, turn, point, centre, radius)
    free = _clear_arcs(arcs, cores, reach)
    arcs = _Arcs(*(part[free] for part in arcs))

    begin = np.concatenate([leave, node[first[free]]])
    end = np.concatenate([arrive, node[second[free]]])
    length = np.concatenate([_lengths(lines), arcs.radius * arcs.sweep])
    size = 2 + 2 * count
    # Half a second to import, in every process that loads this module and mostly needs no detour.
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    distance, previous = dijkstra(
        csr_array((length, (begin, end)), shape=(size, size)), indices=0, return_predecessors=True
    )
    used: list[int] = []
    here = 1
    while previous[here] >= 0:
        used += np.flatnonzero((begin == previous[here]) & (end == here)).tolist()
        here = int(previous[here])
    edges = np.array(used, dtype=np.int64)
    straight, bent = edges[edges < count], edges[edges >= count] - count
    return (
        float(distance[1]),
        _Lines(lines.begin[straight], lines.end[straight]),
        _Arcs(*(part[bent] for part in arcs)),
    )


def _tangents(
    centre: Array, radius: Array
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64], Array, _Lines]:
    """All directed lines that leave one circle and arrive at another without a kink.

    A path turns about a circle counter-clockwise (turn s = 1, the centre on its left) or clockwise
    (s = -1), so with travel direction u and its right-hand normal n it leaves circle i at
    c_i + s_i r_i n and arrives at circle j at c_j + s_j r_j n. For d = c_j - c_i that gives
    d = l u + k n with k = s_i r_i - s_j r_j and l^2 = |d|^2 - k^2.

    Returns:
        Circle and turn that each line leaves, circle and turn at which it arrives, the lines.
    """
    turn = np.array([1.0, -1.0])
    d = centre[None, :] - centre[:, None]
    d2 = np.sum(d**2, axis=2)[:, :, None, None]
    k = (turn[:, None] * radius[:, None, None, None]) - turn * radius[:, None, None]
    l2 = d2 - k**2
    exists = (l2 > -_TOLERANCE) & (d2 > 0)
    exists[1] = exists[:, 0] = False  # nothing leaves the goal or arrives at the start
    exists[0, :, 1] = exists[:, 1, :, 1] = False  # a point has no turn: keep one of two
    i, j, s, e = np.nonzero(exists)
    length, k, d = np.sqrt(np.maximum(l2[i, j, s, e], 0.0)), k[i, j, s, e], d[i, j]
    # u rotated clockwise by 90 degrees, from d = l u + k n solved for u
    normal = np.stack([length * d[:, 1] + k * d[:, 0], k * d[:, 1] - length * d[:, 0]], axis=1)
    normal /= d2[i, j, 0]
    lines = _Lines(
        centre[i] + (turn[s] * radius[i])[:, None] * normal,
        centre[j] + (turn[e] * radius[j])[:, None] * normal,
    )
    return i, turn[s], j, turn[e], lines


def _arcs_between(
    circle: NDArray[np.int64], turn: Array, point: Array, centre: Array, radius: Array
) -> tuple[NDArray[np.int64], NDArray[np.int64], _Arcs]:
    """Link each point of tangency to the next one on the same circle in the same turn.

    Returns:
        Indices of the points where each arc begins and ends, and the arcs.
    """
    offset = point - centre[circle]
    angle = atan2(offset[:, 1], offset[:, 0])
    phase = (turn * angle) % _TURN
    ring = 2 * circle + (turn > 0)
    first = np.lexsort((phase, ring))
    starts = np.flatnonzero(np.diff(ring[first], prepend=-1))
    ends = np.append(starts[1:], len(first)) - 1
    second = np.roll(first, -1)
    second[ends[: len(starts)]] = first[starts]
    several = first != second
    first, second = first[several], second[several]
    arcs = _Arcs(
        centre[circle[first]],
        radius[circle[first]],
        np.where(turn[first] > 0, angle[first], angle[second]),
        (phase[second] - phase[first]) % _TURN,
    )
    return first, second, arcs


def _lengths(lines: _Lines) -> Array:
    """(E,) [m]"""
    return np.asarray(np.linalg.norm(lines.end - lines.begin, axis=1))


def _heading(path: _Lines) -> float:
    """Direction of the first line of a path that is written from its end [rad]."""
    x, y = (path.end[-1] - path.begin[-1]).tolist()
    return math.atan2(y, x)


def _enters(gaps: Array, reach: Array) -> NDArray[np.bool_]:
    """(M,) which of the cores any of the pieces comes too near to, from (N, M) distances."""
    return np.any(gaps < reach - _TOLERANCE, axis=0)


def _clear_lines(lines: _Lines, cores: Array, reach: Array) -> NDArray[np.int64]:
    """Indices of the lines that come too near to no core."""
    # It brings numba, and most episodes need no detour.
    from crowdbench.simulation.clearance import find_clear

    below = np.minimum(cores[:, :2], cores[:, 2:]) - reach[:, None]
    above = np.maximum(cores[:, :2], cores[:, 2:]) + reach[:, None]
    clear = np.empty(len(lines.begin), dtype=np.bool_)
    find_clear(*lines, np.hstack([cores, below, above]), reach, clear)
    return np.flatnonzero(clear)


def _clear_arcs(arcs: _Arcs, cores: Array, reach: Array) -> NDArray[np.int64]:
    """The same for arcs.

    Most enter one of the first cores, and need not be compared with the rest.
    """
    kept = np.arange(len(arcs.radius))
    for first in range(0, len(cores), _BLOCK):
        block = slice(first, first + _BLOCK)
        some = _Arcs(*(part[kept] for part in arcs))
        kept = kept[~np.any(_arc_gaps(some, cores[block]) < reach[block] - _TOLERANCE, axis=1)]
    return kept


def _line_gaps(lines: _Lines, cores: Array) -> Array:
    """(E, M) distances between lines and core segments [m]."""
    p, q = lines.begin[:, None], lines.end[:, None]
    return _segment_gaps(p, q, cores[None, :, :2], cores[None, :, 2:])


def _segment_gaps(p: Array, q: Array, a: Array, b: Array) -> Array:
    """Distances between the segments p-q and a-b [m]; shapes broadcast over (..., 2)."""
    gaps = np.minimum(
        np.minimum(_point_gaps(p, a, b), _point_gaps(q, a, b)),
        np.minimum(_point_gaps(a, p, q), _point_gaps(b, p, q)),
    )
    crossing = (_side(p, q, a) * _side(p, q, b) < 0) & (_side(a, b, p) * _side(a, b, q) < 0)
    return np.where(crossing, 0.0, gaps)


def _arc_gaps(arcs: _Arcs, cores: Array) -> Array:
    """(A, M) distances between arcs and core segments [m].

    The nearest pair lies at an end of the arc, towards an end of the segment, towards the foot of
    the perpendicular from the circle's centre, or where the two cross.
    """
    a, b = cores[None, :, :2], cores[None, :, 2:]
    centre, radius = arcs.centre[:, None], arcs.radius[:, None]
    gaps = np.full((len(arcs.radius), len(cores)), np.inf)
    for angle in (arcs.angle, arcs.angle + arcs.sweep):
        direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]
        gaps = np.minimum(gaps, _point_gaps(centre + radius[..., None] * direction, a, b))

    def spans(target: Array) -> NDArray[np.bool_]:
        offset = target - centre
        angle = atan2(offset[..., 1], offset[..., 0])
        return np.asarray((angle - arcs.angle[:, None]) % _TURN <= arcs.sweep[:, None])

    foot = _nearest_on(centre, a, b)
    for target in (a, b, foot):
        apart = np.abs(np.linalg.norm(target - centre, axis=2) - radius)
        gaps = np.where(spans(target), np.minimum(gaps, apart), gaps)

    along = b - a
    # |a + x along - centre| = radius, a quadratic in x
    aa, ab = np.sum(along**2, axis=2), np.sum(along * (a - centre), axis=2)
    discriminant = ab**2 - aa * (np.sum((a - centre) ** 2, axis=2) - radius**2)
    crosses = (discriminant >= 0) & (aa > 0)
    root = np.sqrt(np.where(crosses, discriminant, 0.0))
    for sign in (-1.0, 1.0):
        x = (sign * root - ab) / np.where(aa > 0, aa, 1.0)
        hit = crosses & (x >= 0) & (x <= 1) & spans(a + x[..., None] * along)
        gaps = np.where(hit, 0.0, gaps)
    return gaps


def _nearest_on(point: Array, a: Array, b: Array) -> Array:
    """The point of the segment a-b nearest to a point; shapes broadcast over (..., 2)."""
    along = b - a
    square = np.sum(along**2, axis=-1)
    share = np.sum((point - a) * along, axis=-1) / np.where(square > 0, square, 1.0)
    return a + np.clip(share, 0.0, 1.0)[..., None] * along


def _point_gaps(point: Array, a: Array, b: Array) -> Array:
    """Distance from points to segments; shapes broadcast over (..., 2)."""
    return np.asarray(np.linalg.norm(point - _nearest_on(point, a, b), axis=-1))


def _side(a: Array, b: Array, point: Array) -> Array:
    """Positive where a point lies to the left of the line from a to b."""
    d, e = b - a, point - a
    return np.asarray(d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0])
