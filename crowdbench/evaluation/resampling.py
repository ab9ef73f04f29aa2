"""Bootstrap and permutations of samples: hundreds in a second, in bounded memory.

A report has hundreds of samples of few sizes, and drawing is nearly all of the work. So all samples
of one size that are asked for together share their draws: a matrix, made a block of rows at a time,
whose product with a sample is everything that is asked of it. What comes out is the same to the
last bit as one by one.

The draws belong to places in the sample: give values in the order of their seeds, and the same
episodes have the same interval wherever it is printed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

CONFIDENCE = 0.95
RESAMPLES = 9999

_SEED = 0
_BLOCK = 100_000
"""Numbers of a block: it stays in the processor's cache while samples are multiplied with it."""
_TOGETHER = 128
"""Samples whose products are held at the same time: 10 MB."""
_SAME = 1e-12
"""Values this close, relative to the largest, differ by rounding alone."""
_TIE = 1e-9
"""Sums that differ by less than this share of their terms are equal, whatever the rounding."""

Array = NDArray[np.float64]
Draws = Callable[[int], Iterator[Array]]


def bootstrap_limits(samples: Sequence[Array]) -> list[tuple[float, float]]:
    """The BCa bootstrap interval of each sample's mean (Efron 1987, sections 2 and 7).

    One value or none says nothing about the spread: NaN. Equal values give a width of zero.

    Args:
        samples: (n,) each, without NaN, of any sizes.

    Returns:
        Both limits of each, for ``CONFIDENCE``.
    """
    limits: list[tuple[float, float]] = []
    deviations: dict[int, Array] = {}
    for number, sample in enumerate(samples):
        mean = float(sample.mean()) if len(sample) else np.nan
        limits.append((mean, mean) if len(sample) > 1 else (np.nan, np.nan))
        if len(sample) > 1 and np.ptp(sample) > _SAME * np.abs(sample).max():
            deviations[number] = (sample - mean) / float(np.ptp(sample))
    for number, total in _products(_counts, deviations):
        low, high = _bca(total / len(samples[number]), deviations[number])
        mean, spread = float(samples[number].mean()), float(np.ptp(samples[number]))
        limits[number] = mean + spread * low, mean + spread * high
    return limits


def _bca(means: Array, deviation: Array) -> tuple[float, float]:
    """Limits from resampled means of deviations from a mean."""
    # Bias: where the mean stands among the resampled ones, ties counting half.
    below = (np.mean(means < -_TIE) + np.mean(means <= _TIE)) / 2
    z0 = ndtri(below)
    # Acceleration, from the jackknife: leaving out x_i moves the mean by (mean - x_i) / (n - 1).
    acceleration = np.sum(deviation**3) / (6 * np.sum(deviation**2) ** 1.5)
    z = z0 + ndtri([(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    low, high = np.quantile(means, ndtr(z0 + z / (1 - acceleration * z)))
    return float(low), float(high)


def sign_flip_p(samples: Sequence[Array]) -> list[float]:
    """Two-sided p-values of means of paired differences, each pair swapped or not.

    Exact when the 2^n ways to swap are no more than ``RESAMPLES``, else drawn at random.

    Args:
        samples: differences (n,) each, without NaN, of any sizes.

    Returns:
        NaN without pairs; 1 for a single pair or when all pairs are equal.
    """
    p = [1.0 if len(sample) else np.nan for sample in samples]
    differ = {k: sample for k, sample in enumerate(samples) if len(sample) > 1 and sample.any()}
    few = {k: sample for k, sample in differ.items() if len(sample) < RESAMPLES.bit_length()}
    many = {k: sample for k, sample in differ.items() if k not in few}
    for draws, chosen in ((_all_signs, few), (_signs, many)):
        for number, sums in _products(draws, chosen):
            sample = samples[number]
            least = abs(sample.sum()) - _TIE * np.abs(sample).sum()
            as_extreme = np.count_nonzero(np.abs(sums) >= least)
            drawn = int(draws is _signs)  # the pairs as they are count as one of the draws
            p[number] = float((drawn + as_extreme) / (drawn + len(sums)))
    return p


def _products(draws: Draws, samples: dict[int, Array]) -> Iterator[tuple[int, Array]]:
    """(m,) each draw's product with a sample, for each of those, by size."""
    by_size: dict[int, list[int]] = {}
    for number, sample in samples.items():
        by_size.setdefault(len(sample), []).append(number)
    for n, numbers in by_size.items():
        for first in range(0, len(numbers), _TOGETHER):
            together = numbers[first : first + _TOGETHER]
            products: list[list[Array]] = [[] for _ in together]
            for block in draws(n):
                for number, found in zip(together, products, strict=True):
                    found.append(block @ samples[number])
            for number, found in zip(together, products, strict=True):
                yield number, np.concatenate(found)


def _counts(n: int) -> Iterator[Array]:
    """(rows, n) how often each of n values is drawn in each resample, RESAMPLES rows in all."""
    rng, most = np.random.default_rng([_SEED, n]), max(1, _BLOCK // n)
    places = n * np.arange(most)[:, None]
    for block in _blocks(n, most):
        drawn = rng.integers(n, size=block.shape)
        drawn += places[: len(block)]
        block[:] = np.bincount(drawn.ravel(), minlength=block.size).reshape(block.shape)
        yield block


def _all_signs(n: int) -> Iterator[Array]:
    """(2^n, n) signs of the differences after each way to swap pairs."""
    swapped = np.arange(2**n)[:, None] >> np.arange(n) & 1
    yield np.where(swapped, -1.0, 1.0)


def _signs(n: int) -> Iterator[Array]:
    """(rows, n) the same for swaps drawn at random, RESAMPLES rows in all."""
    rng, width = np.random.default_rng([_SEED, n]), -(-n // 8)
    # The generator gives four bytes at a time: rows by fours leave none over between blocks.
    for block in _blocks(n, 4 * max(1, _BLOCK // (4 * n))):
        packed = np.frombuffer(rng.bytes(len(block) * width), np.uint8).reshape(-1, width)
        block[:] = np.unpackbits(packed, axis=1, count=n)
        block *= -2.0
        block += 1.0
        yield block


def _blocks(n: int, most: int) -> Iterator[Array]:
    """RESAMPLES rows of n numbers in blocks, which share their memory one after the other."""
    block = np.empty((most, n))
    for start in range(0, RESAMPLES, most):
        yield block[: RESAMPLES - start]
