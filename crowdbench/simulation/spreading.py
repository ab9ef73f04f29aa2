"""Spreading: where people in streams are when an episode begins, anywhere along their way."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.scenario.streams import MOST_VIA
from crowdbench.simulation.following import PLACE, length_of, place_of
from crowdbench.simulation.map_layout import NoPlaceError
from crowdbench.simulation.routes import Routes
from crowdbench.simulation.ways import lengths_to, next_point

_BATCH, _BATCHES = 16, 20
_GOAL, _VIA = PLACE, 2 * PLACE
_SHARE = _VIA + MOST_VIA * PLACE
"""Where in a row of draws those of the goal, of the regions on the way and of the share of the way
begin; the first ones are of the start."""


def spread(
    rng: np.random.Generator,
    routes: Routes,
    discs: NDArray[np.float64],
    fixed: int,
    stage: NDArray[np.int64],
) -> int:
    """Place everybody who walks in a stream, without overlap; these are the first ones.

    Each is a share of the way, drawn like the way itself, between a place of the stream's start
    and one of its goal.

    Args:
        rng: where draws come from.
        routes: of the scenario.
        discs: (fixed + P, 3) x, y, radius; x and y of people in streams are written [m].
        fixed: the first ones that are taken.
        stage: (P,) written: how many regions on the way each has passed.

    Returns:
        How many walk in streams.

    Raises:
        NoPlaceError: somebody found no place.
    """
    for p, stream in enumerate(routes.member.tolist()):
        if stream < 0:
            return p
        for _ in range(_BATCHES):
            draws = rng.random((_BATCH, _SHARE + 1))
            stage[p] = _place_along(draws, discs, fixed + p, stream, routes)
            if stage[p] >= 0:
                break
        else:
            raise NoPlaceError(f"pedestrian {p + 1} of {len(stage)} found no place in its stream")
    return len(stage)


@compiled()
def _place_along(
    draws: NDArray[np.float64],
    discs: NDArray[np.float64],
    last: int,
    stream: int,
    routes: Routes,
) -> int:
    """Place disc ``last`` at the first place that is free of those before it.

    Returns:
        How many regions lie behind it; -1: no place is free.
    """
    row = routes.streams[stream]
    stops, lengths = np.empty((MOST_VIA + 2, 2)), np.empty(MOST_VIA + 1)
    count = row[2] + 1
    for k in range(len(draws)):
        for stop in range(count + 1):
            table, first = row[2 + stop], _VIA + (stop - 1) * PLACE
            if stop == 0:
                table, first = row[0], 0
            elif stop == count:
                table, first = row[1], _GOAL
            stops[stop, 0], stops[stop, 1] = place_of(draws[k], first, table, routes)
        total = 0.0
        for stage in range(count):
            a, b = stops[stage], stops[stage + 1]
            lengths[stage] = length_of(a[0], a[1], b[0], b[1], routes)
            total += lengths[stage]
        left, stage = draws[k, _SHARE] * total, 0
        while stage < count - 1 and left > lengths[stage]:
            left -= lengths[stage]
            stage += 1
        a, b = stops[stage], stops[stage + 1]
        x, y = _point_on_way(a[0], a[1], b[0], b[1], left, routes)
        free = True
        for i in range(last):
            dx, dy = x - discs[i, 0], y - discs[i, 1]
            free = free and math.sqrt(dx * dx + dy * dy) > discs[i, 2] + discs[last, 2]
        if free:
            discs[last, 0], discs[last, 1] = x, y
            return stage
    return -1


@compiled()
def _point_on_way(x, y, to_x, to_y, left, routes):  # type: ignore[no-untyped-def]
    """The point of the way to (to_x, to_y) that lies ``left`` [m] from its beginning."""
    lengths = np.empty(len(routes.nodes))
    lengths_to(to_x, to_y, routes.nodes, routes.between, routes.cores, routes.reach, lengths)
    while x != to_x or y != to_y:
        nx, ny, _ = next_point(x, y, to_x, to_y, lengths, routes.nodes, routes.cores, routes.reach)
        dx, dy = nx - x, ny - y
        distance = math.sqrt(dx * dx + dy * dy)
        if distance >= left:
            return x + left / distance * dx, y + left / distance * dy
        left -= distance
        x, y = nx, ny
    return x, y
