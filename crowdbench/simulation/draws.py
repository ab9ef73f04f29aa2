"""Random numbers that compiled code draws for itself, each by its key, purpose and index.

SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014):
every number is a function of what it is for, so nothing depends on what else has been drawn.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled

ATTENTION, STOPS, SERVICE, LOST_BEAMS, SCAN_NOISE = range(5)
"""Purposes, each with a sequence of its own for every key."""

_STEP, _FIRST, _SECOND = (
    np.uint64(number) for number in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
)
_PURPOSE = np.uint64(0xD1342543DE82EF95)
_30, _27, _31, _11, _1, _LAST = (np.uint64(bits) for bits in (30, 27, 31, 11, 1, 127))


@compiled()
def splitmix64(seed, index):  # type: ignore[no-untyped-def]
    """The number (64 bits) at ``index``, from 0, of the sequence of a seed."""
    number = seed + (np.uint64(index) + _1) * _STEP
    number = (number ^ (number >> _30)) * _FIRST
    number = (number ^ (number >> _27)) * _SECOND
    return number ^ (number >> _31)


@compiled()
def sequence(key, purpose):  # type: ignore[no-untyped-def]
    """The seed of a key's sequence for a purpose."""
    return splitmix64(key, np.uint64(purpose) * _PURPOSE)


@compiled()
def uniform(seed, index):  # type: ignore[no-untyped-def]
    """A number within [0, 1), uniform, at ``index`` of a sequence."""
    return np.float64(splitmix64(seed, index) >> _11) * 2.0**-53


@compiled()
def between(bounds, key, purpose, index):  # type: ignore[no-untyped-def]
    """A number drawn from an interval (2,), which is uniform there.

    Args:
        bounds: lowest and highest.
        key: of whom it is drawn for.
        purpose: what for, one of those above.
        index: which of the numbers for that purpose, from 0.
    """
    return bounds[0] + (bounds[1] - bounds[0]) * uniform(sequence(key, purpose), index)


@compiled()
def gap(share, seed, index):  # type: ignore[no-untyped-def]
    """How many things stay before the next that is hit, if each is with probability ``share``.

    Geometric, by its quantile; a float, since for small shares it has no bound.
    """
    return np.floor(math.log1p(-uniform(seed, index)) / math.log1p(-share))


_BLOCKS = 128
_TAIL, _AREA = 3.442619855899, 9.91256303526217e-3
"""Where the normal density's tail begins, and the area of each block below it."""


def _block_edges() -> NDArray[np.float64]:
    """(_BLOCKS + 1,) right edges of the blocks, from the lowest, which has the tail, to 0."""
    edges = [_AREA / math.exp(-_TAIL * _TAIL / 2), _TAIL]
    while len(edges) < _BLOCKS:
        edges.append(
            math.sqrt(-2 * math.log(_AREA / edges[-1] + math.exp(-edges[-1] * edges[-1] / 2)))
        )
    return np.array([*edges, 0.0])


_EDGES = _block_edges()
_WITHIN = _EDGES[1:] / _EDGES[:-1]


@compiled()
def normal(seed, index):  # type: ignore[no-untyped-def]
    """A number of the standard normal distribution, at ``index`` of a sequence.

    By the ziggurat of Marsaglia and Tsang (Journal of Statistical Software 5, 2000) as improved in
    Doornik, "An improved ziggurat method to generate normal random samples" (2005).
    """
    drawn = splitmix64(seed, index)
    while True:
        # The last 11 bits do not go into the number.
        block, edge = drawn & _LAST, np.float64(drawn >> _11) * 2.0**-52 - 1.0
        if abs(edge) < _WITHIN[block]:
            return edge * _EDGES[block]
        if block == 0:
            return _beyond(drawn) if edge > 0.0 else -_beyond(drawn)
        x = edge * _EDGES[block]
        low = math.exp((x * x - _EDGES[block] ** 2) / 2.0)
        high = math.exp((x * x - _EDGES[block + 1] ** 2) / 2.0)
        if high + uniform(drawn, 0) * (low - high) < 1.0:
            return x
        drawn = splitmix64(drawn, 1)


@compiled()
def _beyond(seed):  # type: ignore[no-untyped-def]
    """A number of the tail, after Marsaglia (Technometrics 6, 1964)."""
    index = 0
    while True:
        x = -math.log(1.0 - uniform(seed, index)) / _TAIL
        if -2.0 * math.log(1.0 - uniform(seed, index + 1)) >= x * x:
            return _TAIL + x
        index += 2
