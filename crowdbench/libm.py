"""Functions of arrays as the C library rounds them, on every processor.

numpy has functions of its own for processors with AVX-512, which differ in the last digit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

_ATAN2 = np.frompyfunc(math.atan2, 2, 1)
_EXP = np.frompyfunc(math.exp, 1, 1)


def atan2(y: ArrayLike, x: ArrayLike) -> NDArray[np.float64]:
    """Direction of each (x, y) [rad], as ``math.atan2`` rounds it."""
    return np.asarray(_ATAN2(y, x), dtype=np.float64)


def exp(x: ArrayLike) -> NDArray[np.float64]:
    """The exponential of each number, as ``math.exp`` rounds it."""
    return np.asarray(_EXP(x), dtype=np.float64)
