"""Traits: what a person is like for a whole episode, drawn before it begins.

Each person's come from a stream of its own: they depend on the seed and the person's number alone,
but for shares of the crowd, which the persons with the smallest draws make up.
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Pedestrians
from crowdbench.scenario.streams import stream_sizes
from crowdbench.simulation import streams

_LEAST, _MOST = 2.0**-1000, 1.0 - 2.0**-53
"""Probabilities between which a normal distribution has quantiles."""


class Traits(NamedTuple):
    """What P people are like.

    Attributes:
        radius: (P,) [m].
        queue: (P,) the queue that each belongs to, -1 for none.
        place: (P,) in it, from 0, -1 for those who are not in line; the first people are.
        group: (P,) the group that each walks with, -1 for none; its people follow each other.
        standing: (P,) who stands in a place of its own, in no queue, group or stream.
        facing: (P,) where somebody who stands looks at first [rad].
        attention: (P,) in [0, 1), by which those who look away at times are chosen.
        key: (P,) of what compiled code draws for each.
    """

    radius: NDArray[np.float64]
    queue: NDArray[np.int64]
    place: NDArray[np.int64]
    group: NDArray[np.int64]
    standing: NDArray[np.bool_]
    facing: NDArray[np.float64]
    attention: NDArray[np.float64]
    key: NDArray[np.uint64]

    @property
    def first(self) -> NDArray[np.int64]:
        """(P,) number of the first one of each person's group; the own one without a group."""
        first = np.arange(len(self.group))
        for g in range(int(self.group.max(initial=-1)) + 1):
            members = np.flatnonzero(self.group == g)
            first[members] = members[0]
        return first


def draw_traits(people: Pedestrians, seed: int) -> Traits:
    """Draw everybody's traits, radii uniform within ``radius``."""
    low, high = people.radii
    draws = np.zeros((people.count, 4))
    key = np.zeros(people.count, dtype=np.uint64)
    if _are_needed(people):
        for p in range(people.count):
            stream = streams.traits(seed, p)
            stream.random(out=draws[p])
            key[p] = stream.integers(2**64, dtype=np.uint64)
    queue, place = np.full((2, people.count), -1)
    lines = [(q, k) for q, line in enumerate(people.queues) for k in range(line.count)]
    for p, (q, k) in enumerate([*lines, *((q, -1) for q in range(len(people.queues)))]):
        queue[p], place[p] = q, k
    group = np.full(people.count, -1)
    sizes = _group_sizes(people, int(np.count_nonzero(queue < 0)), seed)
    walking = np.count_nonzero(queue >= 0)
    group[walking : walking + sum(sizes)] = np.repeat(np.arange(len(sizes)), sizes)
    alone = (queue < 0) & (group < 0)
    alone[walking : walking + sum(stream_sizes(people))] = False
    return Traits(
        radius=low + (high - low) * draws[:, 0],
        queue=queue,
        place=place,
        group=group,
        standing=smallest(draws[:, 1], alone, round(people.standing * people.count)),
        facing=2 * np.pi * draws[:, 2],
        attention=draws[:, 3],
        key=key,
    )


def _group_sizes(people: Pedestrians, available: int, seed: int) -> list[int]:
    """How many people each group has; together as many of the share as groups can hold."""
    low, high = people.groups.size

    def can_be(count: int) -> bool:
        return -(-count // high) <= count // low

    left = min(available, round(people.groups.share * people.count))
    while not can_be(left):
        left -= 1
    sizes: list[int] = []
    stream = streams.groups(seed)
    while left:
        fitting = [size for size in range(low, high + 1) if size <= left and can_be(left - size)]
        sizes.append(fitting[int(stream.random() * len(fitting))])
        left -= sizes[-1]
    return sizes


def places_in_line(people: Pedestrians) -> NDArray[np.float64]:
    """(N, 2) where those stand who queue, in the order of the pedestrians [m]."""
    places = [place for queue in people.queues for place in queue.places()]
    return np.array(places, dtype=np.float64).reshape(-1, 2)


def smallest(draws: NDArray[np.float64], among: NDArray[np.bool_], count: int) -> NDArray[np.bool_]:
    """(P,) ``count`` of those ``among`` whom to choose, the ones with the smallest draws."""
    chosen = np.zeros(len(draws), dtype=np.bool_)
    order = np.argsort(np.where(among, draws, np.inf), kind="stable")
    chosen[order[:count]] = True
    return chosen


def preferred_speeds(people: Pedestrians, draws: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P,) preferred speeds within ``speed`` [m/s], uniform or normal.

    Args:
        people: of the scenario. With ``speed_mean`` and ``speed_deviation`` speeds are normal, as
            Weidmann ("Transporttechnik der Fussgaenger", 1993) found them of adults in the open:
            1.34 +- 0.26 m/s; what lies outside ``speed`` is never drawn.
        draws: (P,) in [0, 1), one for each person.
    """
    low, high = people.speed
    if people.speed_mean is None or people.speed_deviation is None:
        return np.asarray(low + (high - low) * draws)
    normal = NormalDist(people.speed_mean, people.speed_deviation)
    # Not its own ``cdf``, which rounds otherwise in other versions of Python.
    below, up_to = (
        0.5 * math.erfc((normal.mean - bound) / (normal.stdev * math.sqrt(2.0)))
        for bound in (low, high)
    )
    within = up_to - below
    shares = [min(max(below + within * draw, _LEAST), _MOST) for draw in draws.tolist()]
    return np.array([min(max(normal.inv_cdf(share), low), high) for share in shares])


def _are_needed(people: Pedestrians) -> bool:
    return (
        people.radii[0] < people.radii[1]
        or people.standing > 0
        or len(people.queues) > 0
        or people.attention.away_share > 0
        or people.stops.share > 0
    )
