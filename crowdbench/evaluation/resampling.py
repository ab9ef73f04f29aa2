"""Hundreds of intervals and paired tests in a second: one set of draws for all of the same size.

The methods are those of ``crowdbench.evaluation.statistics`` (BCa bootstrap, two-sided paired
permutation test), the numbers the same up to the chance of the draws. What differs is the cost: a
report has hundreds of samples of few sizes, and drawing is nearly all of the work. Draws as a
matrix turn each sample into one product of that matrix and the sample.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from crowdbench.evaluation.statistics import CONFIDENCE, RESAMPLES, Estimate

_SEED = 0
_BATCH = 1_000_000
"""Draws made at a time; bounds the memory they take."""
_SAME = 1e-12
"""Values this close, relative to the largest, differ by rounding alone."""
_TIE = 1e-9
"""Sums that differ by less than this share of their terms are equal, whatever the rounding."""


def bootstrap_mean(values: NDArray[np.float64]) -> Estimate:
    """Mean with its BCa bootstrap interval (Efron 1987, sections 2 and 7).

    One value has no interval (NaN), equal values have one of width zero.

    Args:
        values: (n,) NaN is left out.
    """
    sample = values[~np.isnan(values)]
    n = len(sample)
    if n == 0:
        return Estimate(np.nan, np.nan, np.nan, 0)
    mean, spread = float(sample.mean()), float(np.ptp(sample))
    if n == 1 or spread <= _SAME * np.abs(sample).max():
        limit = mean if n > 1 else np.nan
        return Estimate(mean, limit, limit, n)
    deviation = (sample - mean) / spread
    means = _counts(n) @ deviation / n
    # Bias: where the mean stands among the resampled ones, ties counting half.
    below = (np.mean(means < -_TIE) + np.mean(means <= _TIE)) / 2
    z0 = ndtri(below)
    # Acceleration, from the jackknife: leaving out x_i moves the mean by (mean - x_i) / (n - 1).
    acceleration = np.sum(deviation**3) / (6 * np.sum(deviation**2) ** 1.5)
    z = z0 + ndtri([(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    low, high = np.quantile(means, ndtr(z0 + z / (1 - acceleration * z)))
    return Estimate(mean, mean + spread * float(low), mean + spread * float(high), n)


def sign_flip_p(differences: NDArray[np.float64]) -> float:
    """Two-sided p-value of the mean of paired differences, each swapped or not.

    Exact when the 2^n ways to swap are no more than ``RESAMPLES``, else drawn at random.

    Args:
        differences: (n,) NaN is left out.

    Returns:
        NaN without pairs; 1 for a single pair or when all pairs are equal.
    """
    sample = differences[~np.isnan(differences)]
    if not len(sample):
        return np.nan
    if len(sample) == 1 or not np.any(sample):
        return 1.0
    signs = _signs(len(sample))
    as_extreme = np.abs(signs @ sample) >= abs(sample.sum()) - _TIE * np.abs(sample).sum()
    if len(signs) == 2 ** len(sample):
        return float(np.mean(as_extreme))
    return float((1 + np.count_nonzero(as_extreme)) / (1 + len(signs)))


@lru_cache(maxsize=4)
def _counts(n: int) -> NDArray[np.float64]:
    """(RESAMPLES, n) how often each of n values is drawn in each resample."""
    rng = np.random.default_rng([_SEED, n])
    counts = np.empty((RESAMPLES, n))
    step = max(1, _BATCH // n)
    for start in range(0, RESAMPLES, step):
        rows = min(step, RESAMPLES - start)
        drawn = rng.integers(n, size=(rows, n)) + n * np.arange(rows)[:, None]
        counts[start : start + rows] = np.bincount(drawn.ravel(), minlength=rows * n).reshape(-1, n)
    return counts


@lru_cache(maxsize=4)
def _signs(n: int) -> NDArray[np.float64]:
    """(m, n) signs of the differences after each swap: all 2^n, or RESAMPLES drawn ones."""
    if 2**n <= RESAMPLES:
        swapped = np.arange(2**n)[:, None] >> np.arange(n) & 1
        return 1.0 - 2.0 * swapped.astype(np.float64)
    packed = np.random.default_rng([_SEED, n]).bytes(RESAMPLES * -(-n // 8))
    bits = np.frombuffer(packed, np.uint8).reshape(RESAMPLES, -1)
    return 1.0 - 2.0 * np.unpackbits(bits, axis=1, count=n).astype(np.float64)
