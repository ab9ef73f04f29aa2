"""Spreading: where people in streams are when an episode begins, anywhere along their way."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.scenario.streams import MOST_VIA
from crowdbench.simulation.following import PLACE, length_of, place_of
from crowdbench.simulation.map_layout import CrowdedError
from crowdbench.simulation.routes import Regions, Routes
from crowdbench.simulation.vacancy import is_off_discs
from crowdbench.simulation.ways import Network, lengths_to, next_point

_BATCH, _BATCHES = 16, 20
_DRAWS = 1 + (MOST_VIA + 2) * PLACE
"""Numbers that are drawn for a place: the share of the way, the start, then all stops."""


def spread(
    rng: np.random.Generator,
    routes: Routes,
    order: NDArray[np.int64],
    discs: NDArray[np.float64],
    fixed: int,
    stage: NDArray[np.int64],
) -> int:
    """Place everybody who walks in a stream, without overlap.

    Each is a share of the way, drawn like the way itself, between a place of the stream's start
    and one of its goal.

    Args:
        rng: where draws come from.
        routes: of the scenario.
        order: (N,) numbers of the people to be placed, those in streams first.
        discs: (fixed + N, 3) x, y, radius; x and y of people in streams are written [m].
        fixed: the first ones that are taken.
        stage: (P,) written: how many regions on the way each has passed.

    Returns:
        How many walk in streams.

    Raises:
        CrowdedError: somebody found no place.
    """
    for i, p in enumerate(order.tolist()):
        stream = routes.member[p]
        if stream < 0:
            return i
        for _ in range(_BATCHES):
            draws = rng.random((_BATCH, _DRAWS))
            stage[p] = _place_along(draws, discs, fixed + i, stream, routes.network, routes.regions)
            if stage[p] >= 0:
                break
        else:
            raise CrowdedError(
                f"pedestrian {p + 1} of {len(stage)} found no place in its stream",
                "pedestrians.count, pedestrians.streams or pedestrians.spawn_clearance",
            )
    return len(order)


@compiled()
def _place_along(
    draws: NDArray[np.float64],
    discs: NDArray[np.float64],
    last: int,
    stream: int,
    network: Network,
    regions: Regions,
) -> int:
    """Place disc ``last`` at the first place that is free of those before it.

    Returns:
        How many regions lie behind it; -1: no place is free.
    """
    row = regions.streams[stream]
    stops, lengths = np.empty((MOST_VIA + 2, 2)), np.empty(MOST_VIA + 1)
    for k in range(len(draws)):
        total = 0.0
        for stop in range(row[1] + 1):
            place = place_of(draws[k], 1 + stop * PLACE, row[2 + stop], regions)
            stops[stop, 0], stops[stop, 1] = place
            if stop > 0:
                a, b = stops[stop - 1], stops[stop]
                lengths[stop - 1] = length_of(a[0], a[1], b[0], b[1], network)
                total += lengths[stop - 1]
        left, stage = draws[k, 0] * total, 0
        while stage < row[1] - 1 and left > lengths[stage]:
            left -= lengths[stage]
            stage += 1
        x, y = _point_on_way(stops[stage], stops[stage + 1], left, network)
        if is_off_discs(x, y, discs, last):
            discs[last, 0], discs[last, 1] = x, y
            return stage
    return -1


@compiled()
def _point_on_way(start, end, left, network):  # type: ignore[no-untyped-def]
    """The point of the way between two points (2,) that lies ``left`` [m] from its beginning."""
    lengths = np.empty(len(network.nodes))
    lengths_to(end[0], end[1], network, lengths)
    x, y = start[0], start[1]
    while x != end[0] or y != end[1]:
        nx, ny, _ = next_point(x, y, end[0], end[1], lengths, network)
        dx, dy = nx - x, ny - y
        distance = math.sqrt(dx * dx + dy * dy)
        if distance >= left:
            return x + left / distance * dx, y + left / distance * dy
        left -= distance
        x, y = nx, ny
    return x, y
