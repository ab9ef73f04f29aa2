"""Random walls and discs between a start and a goal, and a search on a grid for the way."""

import math

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

RADIUS = 0.15
START, GOAL = np.array([0.0, 0.0]), np.array([4.0, 0.0])


def random_scene(seed):
    """Walls and discs between start and goal that leave both of them free."""
    rng = np.random.default_rng(seed)
    discs = np.concatenate(
        [rng.uniform([0.6, -1.0], [3.4, 1.0], (5, 2)), rng.uniform(0.1, 0.4, (5, 1))], axis=1
    )
    begin = rng.uniform([0.3, -1.0], [3.7, 1.0], (2, 2))
    walls = np.concatenate([begin, begin + rng.uniform(-1, 1, (2, 2))], axis=1)
    walls[:, 2] = np.clip(walls[:, 2], 0.3, 3.7)
    return walls, discs


def pillar_scene(seed, pillars=14):
    """Edges of square pillars, turned at random, and two walls with a gap: 58 walls, no discs."""
    rng = np.random.default_rng(seed)
    edges = [(2.0, -2.4, 2.0, -0.4), (2.0, 0.3, 2.0, 2.4)]
    while len(edges) < 2 + 4 * pillars:
        x, y = rng.uniform([0.5, -2.2], [3.5, 2.2])
        turn = rng.uniform(0, math.pi / 2) + np.arange(5) * math.pi / 2
        corners = np.column_stack([x + 0.2 * np.cos(turn), y + 0.2 * np.sin(turn)])
        if abs(x - 2.0) > 0.7:
            edges += np.hstack([corners[:-1], corners[1:]]).tolist()
    return np.array(edges), np.empty((0, 3))


def grid_search(walls, discs, spacing=0.025):
    """Dijkstra on a grid with 32 directions; moves are checked every quarter of the spacing."""
    xs, ys = np.arange(-0.5, 4.5 + 1e-9, spacing), np.arange(-2.5, 2.5 + 1e-9, spacing)
    shape = len(xs), len(ys)
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    moves = [
        (i, j) for i in range(-3, 4) for j in range(4) if math.gcd(i, j) == 1 and (j > 0 or i > 0)
    ]
    begin, end, cost = [], [], []
    for i, j in moves:
        first = index[max(0, -i) : shape[0] - max(0, i), : shape[1] - j]
        second = index[max(0, i) : shape[0] + min(0, i), j:]
        p = np.stack([xs[first // shape[1]], ys[first % shape[1]]], axis=-1)
        free = np.ones(first.shape, dtype=bool)
        samples = math.ceil(4 * math.hypot(i, j))
        for k in range(samples + 1):
            free &= is_free(p + spacing * np.array([i, j]) * k / samples, walls, discs)
        begin.append(first[free])
        end.append(second[free])
        cost.append(np.full(np.count_nonzero(free), spacing * math.hypot(i, j)))
    graph = coo_array(
        (np.concatenate(cost), (np.concatenate(begin), np.concatenate(end))),
        shape=(index.size, index.size),
    )
    origin, target = (
        index[np.argmin(abs(xs - x)), np.argmin(abs(ys - y))] for x, y in (START, GOAL)
    )
    return float(dijkstra(graph.tocsr(), directed=False, indices=origin)[target])


def is_free(points, walls, discs, clearance=RADIUS):
    free = np.ones(points.shape[:-1], dtype=bool)
    for x, y, radius in discs:
        free &= np.hypot(points[..., 0] - x, points[..., 1] - y) >= radius + clearance
    for x1, y1, x2, y2 in walls:
        dx, dy = x2 - x1, y2 - y1
        t = ((points[..., 0] - x1) * dx + (points[..., 1] - y1) * dy) / (dx * dx + dy * dy)
        t = np.clip(t, 0, 1)
        near = np.hypot(points[..., 0] - x1 - t * dx, points[..., 1] - y1 - t * dy)
        free &= near >= clearance
    return free
