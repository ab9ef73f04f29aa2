"""Intervals and paired tests: how sure a number is, and whether two agents really differ.

Proportions get Wilson's interval, means the BCa bootstrap. Agents that ran the same seeds are
compared seed by seed: the permutation test asks how often a difference as large as the measured
one would arise if, on every seed, it were a coin toss which agent produced which value.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from crowdbench.evaluation.metrics import METRICS

CONFIDENCE = 0.95
RESAMPLES = 9999
_BATCH = 1_000_000
"""Values drawn at a time; bounds the memory of resampling."""


class PairingError(ValueError):
    """Two tables that cannot be compared seed by seed; the message names what is missing."""


class Estimate(NamedTuple):
    """A mean with its confidence interval; NaN where nothing can be said."""

    mean: float
    low: float
    high: float
    n: int


def wilson_interval(values: ArrayLike, confidence: float = CONFIDENCE) -> Estimate:
    """Share of ones with Wilson's score interval (Wilson 1927).

    Args:
        values: (n,) zeros and ones; NaN is left out.
        confidence: between 0 and 1.
    """
    sample = _defined(values)
    if np.any((sample != 0) & (sample != 1)):
        raise ValueError("wilson_interval: values must be 0 or 1")
    n = len(sample)
    if n == 0:
        return Estimate(np.nan, np.nan, np.nan, 0)
    p = float(sample.mean())
    z = float(stats.norm.ppf((1 + confidence) / 2))
    centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    # Exact at 0 and 1, where centre and half cancel up to a rounding error.
    low = 0.0 if p == 0 else float(centre - half)
    high = 1.0 if p == 1 else float(centre + half)
    return Estimate(p, low, high, n)


def bootstrap_interval(
    values: ArrayLike,
    rng: np.random.Generator,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
) -> Estimate:
    """Mean with its BCa bootstrap interval (Efron 1987).

    One value says nothing about its spread: its interval is NaN. Equal values give an interval of
    width zero.

    Args:
        values: (n,) NaN is left out.
        rng: source of the resampling.
        confidence: between 0 and 1.
        resamples: how often to resample.
    """
    sample = _defined(values)
    n = len(sample)
    mean = float(sample.mean()) if n else np.nan
    if n < 2:
        return Estimate(mean, np.nan, np.nan, n)
    spread = float(np.ptp(sample))
    if spread == 0:
        return Estimate(mean, mean, mean, n)
    # BCa moves and scales with the sample; near one its moments neither vanish nor overflow.
    interval = stats.bootstrap(
        ((sample - mean) / spread,),
        np.mean,
        confidence_level=confidence,
        n_resamples=resamples,
        method="BCa",
        rng=rng,
        batch=max(1, _BATCH // n),
    ).confidence_interval
    return Estimate(mean, mean + spread * interval.low, mean + spread * interval.high, n)


def paired_permutation_test(
    a: ArrayLike, b: ArrayLike, rng: np.random.Generator, resamples: int = RESAMPLES
) -> float:
    """Two-sided p-value of the mean difference of paired values.

    Exact when the 2^n ways to swap pairs are no more than ``resamples``, else drawn at random.

    Args:
        a: (n,) one agent's values; a pair with a NaN is left out.
        b: (n,) the other's, in the same order.
        rng: source of the permutations.
        resamples: how many permutations at most.

    Returns:
        NaN without pairs; 1 for a single pair or when all pairs are equal.
    """
    difference = _defined(np.asarray(a, dtype=float) - np.asarray(b, dtype=float))
    if not len(difference):
        return np.nan
    if len(difference) == 1 or not np.any(difference):
        return 1.0
    # Swapping a pair changes the sign of its difference.
    result = stats.permutation_test(
        (difference,),
        np.mean,
        permutation_type="samples",
        n_resamples=resamples,
        rng=rng,
        batch=max(1, _BATCH // len(difference)),
    )
    return float(result.pvalue)


def holm(p_values: ArrayLike) -> NDArray[np.float64]:
    """P-values adjusted for being one of many (Holm 1979); NaN stays NaN and is not counted.

    Args:
        p_values: (m,).

    Returns:
        (m,) the k-th smallest becomes the largest of (m - j) p_(j), j = 0..k, at most 1.
    """
    p = np.asarray(p_values, dtype=float)
    order = np.argsort(p)[: np.count_nonzero(~np.isnan(p))]
    adjusted = np.full(len(p), np.nan)
    scaled = p[order] * np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return adjusted


def compare(
    a: pd.DataFrame,
    b: pd.DataFrame,
    metrics: Sequence[str] | None = None,
    seed: int = 0,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
) -> pd.DataFrame:
    """Compare two agents on the seeds both ran, per scenario and metric.

    Args:
        a: one row per episode with columns ``scenario``, ``seed`` and the metrics.
        b: the same for the other agent.
        metrics: which to compare; by default all of ``METRICS`` that both tables have.
        seed: of the resampling; the same for every row, so rows do not depend on each other.
        confidence: of the intervals.
        resamples: of each interval and test.

    Returns:
        One row per scenario that both ran and metric: ``scenario``, ``metric``, ``n`` (pairs with
        both values defined), ``mean_a``, ``mean_b`` (over those pairs), ``difference`` (a - b)
        with ``low`` and ``high``, ``p``, and ``p_holm``, corrected over the whole table.

    Raises:
        PairingError: a seed that occurs twice, or nothing in common; names the seeds.
    """
    if metrics is None:
        metrics = [name for name in METRICS if name in a and name in b]
    for side, table in (("first", a), ("second", b)):
        _check(table, side, metrics)
    known = set(b["scenario"])
    scenarios = [name for name in dict.fromkeys(a["scenario"]) if name in known]
    if not scenarios:
        raise PairingError(
            f"no scenario in common: the first has {_listed(a['scenario'])}, "
            f"the second {_listed(b['scenario'])}"
        )
    rows = []
    for scenario in scenarios:
        one, other = _paired(a, b, scenario)
        for metric in metrics:
            x, y = one[metric].to_numpy(dtype=float), other[metric].to_numpy(dtype=float)
            both = ~(np.isnan(x) | np.isnan(y))
            x, y = x[both], y[both]
            interval = bootstrap_interval(x - y, np.random.default_rng(seed), confidence, resamples)
            rows.append(
                {
                    "scenario": scenario,
                    "metric": metric,
                    "n": interval.n,
                    "mean_a": x.mean() if len(x) else np.nan,
                    "mean_b": y.mean() if len(y) else np.nan,
                    "difference": interval.mean,
                    "low": interval.low,
                    "high": interval.high,
                    "p": paired_permutation_test(x, y, np.random.default_rng(seed), resamples),
                }
            )
    table = pd.DataFrame(rows)
    table["p_holm"] = holm(table["p"])
    return table


def _check(table: pd.DataFrame, side: str, metrics: Sequence[str]) -> None:
    for column in ("scenario", "seed", *metrics):
        if column not in table:
            raise PairingError(f"the {side} table has no column {column!r}")
    twice = table[table.duplicated(["scenario", "seed"])]
    if len(twice):
        scenario, seed = twice.iloc[0]["scenario"], twice.iloc[0]["seed"]
        raise PairingError(f"the {side} table has seed {seed} of {scenario!r} more than once")


def _paired(a: pd.DataFrame, b: pd.DataFrame, scenario: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The rows of the seeds that both have, in the order of the seeds."""
    one = a[a["scenario"] == scenario].set_index("seed")
    other = b[b["scenario"] == scenario].set_index("seed")
    shared = one.index.intersection(other.index).sort_values()
    if not len(shared):
        raise PairingError(
            f"scenario {scenario!r}: no seed in common; the first lacks {_listed(other.index)}, "
            f"the second lacks {_listed(one.index)}"
        )
    return one.loc[shared], other.loc[shared]


def _listed(items: pd.Series | pd.Index, most: int = 10) -> str:
    known = list(dict.fromkeys(items))
    more = f" and {len(known) - most} more" if len(known) > most else ""
    return ", ".join(str(item) for item in known[:most]) + more


def _defined(values: ArrayLike) -> NDArray[np.float64]:
    sample = np.asarray(values, dtype=float)
    return sample[~np.isnan(sample)]
