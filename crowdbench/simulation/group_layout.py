"""Where groups begin: the first of each anywhere, the others around it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

_BATCH, _ATTEMPTS = 64, 20
_NEAR, _PER_MEMBER = 0.6, 0.35
"""How far the others of a group are from the first, at most: this and as much for each of them
[m]."""

PlaceOne = Callable[[NDArray[np.float64], int], int]
IsFree = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]


def place_together(
    rng: np.random.Generator,
    group: NDArray[np.int64],
    discs: NDArray[np.float64],
    fixed: int,
    place_one: PlaceOne,
    is_free: IsFree,
) -> int:
    """Place all but the first ``fixed`` of ``discs`` (N, 3), groups together.

    Args:
        rng: where draws come from.
        group: (N - fixed,) of each, -1 for none; those of a group one after another.
        discs: x, y, radius [m]; x and y are written.
        fixed: those that have their place.
        place_one: places all discs from an index on, anywhere; returns how many it has placed.
        is_free: (K,) whether walls leave places (K, 2) free, and the way there from a first one
            (2,) [m].

    Returns:
        How many have their place.
    """
    done = fixed
    while done < len(discs):
        g = group[done - fixed]
        size = int(np.count_nonzero(group == g)) if g >= 0 else 1
        for _ in range(_ATTEMPTS):
            if not place_one(discs[: done + 1], done):
                return done - fixed
            if _surrounded(rng, discs, done, size, is_free):
                break
        else:
            return done - fixed
        done += size
    return done - fixed


def _surrounded(
    rng: np.random.Generator,
    discs: NDArray[np.float64],
    first: int,
    size: int,
    is_free: IsFree,
) -> bool:
    """Place the ``size - 1`` discs after the first near it; whether all found a place."""
    reach = _NEAR + _PER_MEMBER * size
    for p in range(first + 1, first + size):
        off = rng.uniform(-reach, reach, (_BATCH, 2))
        places, taken = discs[first, :2] + off, discs[:p]
        dx, dy = places[:, :1] - taken[:, 0], places[:, 1:] - taken[:, 1]
        free = (np.sqrt(dx * dx + dy * dy) > taken[:, 2] + discs[p, 2]).all(axis=1)
        free &= (off * off).sum(axis=1) < reach * reach
        free &= is_free(discs[first, :2], places)
        if not free.any():
            return False
        discs[p, :2] = places[np.argmax(free)]
    return True
