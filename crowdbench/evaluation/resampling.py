"""Bootstrap and permutations of one sample: hundreds in a second, in bounded memory.

A report has hundreds of samples of few sizes, and drawing is nearly all of the work. So all samples
of one size share their draws: a matrix, kept in one byte per number, whose product with a sample is
everything that is asked of it. Samples of a size that is too large to keep are drawn for anew,
block by block.

The draws belong to places in the sample: give values in the order of their seeds, and the same
episodes have the same interval wherever it is printed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

CONFIDENCE = 0.95
RESAMPLES = 9999

_SEED = 0
_BLOCK = 100_000
"""Numbers drawn at a time."""
_LONGEST_KEPT = 4000
"""Values of a sample whose draws are kept: 40 MB."""
_SAME = 1e-12
"""Values this close, relative to the largest, differ by rounding alone."""
_TIE = 1e-9
"""Sums that differ by less than this share of their terms are equal, whatever the rounding."""

Draws = Callable[[int], Iterator[NDArray[np.integer]]]


def bootstrap_limits(sample: NDArray[np.float64]) -> tuple[float, float]:
    """The BCa bootstrap interval of a mean (Efron 1987, sections 2 and 7).

    One value or none says nothing about the spread: NaN. Equal values give a width of zero.

    Args:
        sample: (n,) without NaN.

    Returns:
        Both limits, for ``CONFIDENCE``.
    """
    return bootstrap_limits_of([sample])[0]


def bootstrap_limits_of(samples: Sequence[NDArray[np.float64]]) -> list[tuple[float, float]]:
    """``bootstrap_limits`` of samples of one size, to the last bit, which is faster.

    Args:
        samples: (n,) each.
    """
    limits: dict[int, tuple[float, float]] = {}
    deviations: dict[int, NDArray[np.float64]] = {}
    for number, sample in enumerate(samples):
        mean = float(sample.mean()) if len(sample) else np.nan
        if len(sample) < 2:
            limits[number] = np.nan, np.nan
        elif np.ptp(sample) <= _SAME * np.abs(sample).max():
            limits[number] = mean, mean
        else:
            deviations[number] = (sample - mean) / float(np.ptp(sample))
    sums = _products(_counts, list(deviations.values()))
    for (number, deviation), total in zip(deviations.items(), sums, strict=True):
        low, high = _bca(total / len(deviation), deviation)
        mean, spread = float(samples[number].mean()), float(np.ptp(samples[number]))
        limits[number] = mean + spread * low, mean + spread * high
    return [limits[number] for number in range(len(samples))]


def _bca(means: NDArray[np.float64], deviation: NDArray[np.float64]) -> tuple[float, float]:
    """Limits from resampled means of deviations from a mean."""
    # Bias: where the mean stands among the resampled ones, ties counting half.
    below = (np.mean(means < -_TIE) + np.mean(means <= _TIE)) / 2
    z0 = ndtri(below)
    # Acceleration, from the jackknife: leaving out x_i moves the mean by (mean - x_i) / (n - 1).
    acceleration = np.sum(deviation**3) / (6 * np.sum(deviation**2) ** 1.5)
    z = z0 + ndtri([(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    low, high = np.quantile(means, ndtr(z0 + z / (1 - acceleration * z)))
    return float(low), float(high)


def sign_flip_p(differences: NDArray[np.float64]) -> float:
    """Two-sided p-value of the mean of paired differences, each swapped or not.

    Exact when the 2^n ways to swap are no more than ``RESAMPLES``, else drawn at random.

    Args:
        differences: (n,) without NaN.

    Returns:
        NaN without pairs; 1 for a single pair or when all pairs are equal.
    """
    n = len(differences)
    if not n:
        return np.nan
    if n == 1 or not np.any(differences):
        return 1.0
    few = n < RESAMPLES.bit_length()
    (sums,) = np.abs(_products(_all_signs if few else _signs, [differences]))
    least = abs(differences.sum()) - _TIE * np.abs(differences).sum()
    as_extreme = np.count_nonzero(sums >= least)
    return float(as_extreme / len(sums) if few else (1 + as_extreme) / (1 + len(sums)))


def _products(draws: Draws, samples: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """(m,) each draw's product with a sample, for each of those, which have one size."""
    if not samples:
        return []
    n = len(samples[0])
    products: list[list[NDArray[np.float64]]] = [[] for _ in samples]
    for block in _kept(draws, n) if n <= _LONGEST_KEPT else draws(n):
        # Converting takes longer than multiplying, so it is done once for all samples.
        numbers = block.astype(np.float64)
        for sample, found in zip(samples, products, strict=True):
            found.append(numbers @ sample)
    return [np.concatenate(found) for found in products]


@lru_cache(maxsize=4)
def _kept(draws: Draws, n: int) -> list[NDArray[np.integer]]:
    return list(draws(n))


def _counts(n: int) -> Iterator[NDArray[np.integer]]:
    """(rows, n) how often each of n values is drawn in each resample, RESAMPLES rows in all."""
    rng = np.random.default_rng([_SEED, n])
    for rows in _rows(max(1, _BLOCK // n)):
        drawn = rng.integers(n, size=(rows, n)) + n * np.arange(rows)[:, None]
        counts = np.bincount(drawn.ravel(), minlength=rows * n).reshape(-1, n)
        # More than 255 times the same one of n > 255 values: less likely than 1e-500.
        yield counts.astype(np.uint8)


def _all_signs(n: int) -> Iterator[NDArray[np.integer]]:
    """(2^n, n) signs of the differences after each way to swap pairs."""
    swapped = np.arange(2**n)[:, None] >> np.arange(n) & 1
    yield (1 - 2 * swapped).astype(np.int8)


def _signs(n: int) -> Iterator[NDArray[np.integer]]:
    """(rows, n) the same for swaps drawn at random, RESAMPLES rows in all."""
    rng, width = np.random.default_rng([_SEED, n]), -(-n // 8)
    # The generator gives four bytes at a time: rows by fours leave none over between blocks.
    for rows in _rows(4 * max(1, _BLOCK // (4 * n))):
        packed = np.frombuffer(rng.bytes(rows * width), np.uint8).reshape(rows, width)
        yield 1 - 2 * np.unpackbits(packed, axis=1, count=n).astype(np.int8)


def _rows(most: int) -> Iterator[int]:
    """RESAMPLES in pieces."""
    for start in range(0, RESAMPLES, most):
        yield min(most, RESAMPLES - start)
