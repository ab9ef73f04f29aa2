"""Lengths and sums of products that every processor and compiler rounds the same.

Trajectories are published to the last bit. They were computed with ``math.hypot`` and with BLAS,
which round otherwise than the plain formulas do.
"""

from __future__ import annotations

import math
from typing import Any

from numba import types
from numba.extending import intrinsic

from crowdbench.compiled import compiled


@intrinsic
def _fused(context: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c, rounded once (fma of C99)."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


@compiled()
def sum_of_products(a, b, c, d):  # type: ignore[no-untyped-def]
    """A b + c d as BLAS adds it: only the first product is rounded by itself."""
    return _fused(c, d, a * b)


@compiled()
def length(x, y):  # type: ignore[no-untyped-def]
    """Length of (x, y) as ``math.hypot`` rounds it.

    Squares are added without loss, and the root is corrected by what is left of them after it.
    """
    largest = max(abs(x), abs(y))
    if largest == 0.0:
        return 0.0
    _, exponent = math.frexp(largest)
    scale = math.ldexp(1.0, -exponent)
    x, y = x * scale, y * scale
    total, low, lost = 1.0, 0.0, 0.0
    for factor, other in ((x, x), (y, y)):
        total, low, lost = _add_product(factor, other, total, low, lost)
    root = math.sqrt(total - 1.0 + (low + lost))
    total, low, lost = _add_product(-root, root, total, low, lost)
    root += (total - 1.0 + (low + lost)) / (2.0 * root)
    return root / scale


@compiled()
def _add_product(a, b, total, low, lost):  # type: ignore[no-untyped-def]
    """Add a b to ``total``; what this cannot hold goes to ``low`` and ``lost``."""
    high = a * b
    low += _fused(a, b, -high)
    after = total + high
    lost += (total - after) + high
    return after, low, lost
