"""Traits: what a person is like for a whole episode, drawn before it begins."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Pedestrians
from crowdbench.simulation import streams

_LEAST, _MOST = 2.0**-1000, 1.0 - 2.0**-53
"""Probabilities between which a normal distribution has quantiles."""


def draw_radii(people: Pedestrians, seed: int) -> NDArray[np.float64]:
    """(P,) radii of everybody in an episode, uniform within ``radius`` [m]."""
    low, high = people.radii
    if low == high:
        return np.full(people.count, low)
    return np.array([streams.traits(seed, p).uniform(low, high) for p in range(people.count)])


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
