"""Random numbers that compiled code draws for itself, each by its key, purpose and index.

SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014):
every number is a function of what it is for, so nothing depends on what else has been drawn.
"""

from __future__ import annotations

import numpy as np

from crowdbench.compiled import compiled

ATTENTION, STOPS, SERVICE = range(3)
"""Purposes, each with a sequence of its own for every key."""

_STEP, _FIRST, _SECOND = (
    np.uint64(number) for number in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
)
_PURPOSE = np.uint64(0xD1342543DE82EF95)
_30, _27, _31, _11, _1 = (np.uint64(bits) for bits in (30, 27, 31, 11, 1))


@compiled()
def splitmix64(seed, index):  # type: ignore[no-untyped-def]
    """The number (64 bits) at ``index``, from 0, of the sequence of a seed."""
    number = seed + (np.uint64(index) + _1) * _STEP
    number = (number ^ (number >> _30)) * _FIRST
    number = (number ^ (number >> _27)) * _SECOND
    return number ^ (number >> _31)


@compiled()
def between(bounds, key, purpose, index):  # type: ignore[no-untyped-def]
    """A number drawn from an interval (2,), which is uniform there.

    Args:
        bounds: lowest and highest.
        key: of whom it is drawn for.
        purpose: what for, one of those above.
        index: which of the numbers for that purpose, from 0.
    """
    own = splitmix64(key, np.uint64(purpose) * _PURPOSE)
    share = np.float64(splitmix64(own, index) >> _11) * 2.0**-53
    return bounds[0] + (bounds[1] - bounds[0]) * share
