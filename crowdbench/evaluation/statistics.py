"""How sure a number is, and whether two agents really differ: the one place that says so.

Proportions get Wilson's interval, other means the BCa bootstrap. The mean of a rate is all events
over all that it is per, a ratio of sums, whose values enter ``linearised``. Agents that ran the
same seeds are compared seed by seed: the permutation test asks how often a difference as large as
the measured one would arise if, on every seed, it were a coin toss which agent produced which
value.

Resampling is the same every time, and its draws belong to places: the same values in the same
order have the same interval wherever it is printed. All callers go by seed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from crowdbench.evaluation.metric import Metric
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.resampling import CONFIDENCE, bootstrap_limits, sign_flip_p


class PairingError(ValueError):
    """Two tables that cannot be compared seed by seed; the message names what is missing."""


class Estimate(NamedTuple):
    """A mean with its 95 % interval over n values; NaN where nothing can be said."""

    mean: float
    low: float
    high: float
    n: int


class Difference(NamedTuple):
    """A mean paired difference over n pairs with its 95 % interval and p-value."""

    mean: float
    low: float
    high: float
    n: int
    p: float


Sample = tuple[Metric, ArrayLike, ArrayLike | None]
"""What ``estimate`` takes: a metric, its values and, if it is weighted, its weights."""


def estimate(metric: Metric, values: ArrayLike, weights: ArrayLike | None = None) -> Estimate:
    """Mean and interval of a metric, as everything that is printed has it.

    Args:
        metric: whose kind decides on the interval.
        values: (n,) one per episode, in the order of the seeds; NaN is left out. A proportion that
            was averaged over the robots of an episode is a mean like any other.
        weights: (n,) values of the metric that this one is weighted by, if it is.
    """
    return estimate_all([(metric, values, weights)])[0]


def estimates(
    metrics: Mapping[str, Metric], values: Mapping[str, ArrayLike]
) -> dict[str, Estimate]:
    """``estimate`` of several metrics.

    Args:
        metrics: by name.
        values: for each of them, and for each that weighs one of them, (n,) as ``estimate`` takes
            them.
    """
    return dict(zip(metrics, estimate_all(samples_of(metrics, values)), strict=True))


def samples_of(metrics: Mapping[str, Metric], values: Mapping[str, ArrayLike]) -> list[Sample]:
    """What ``estimate_all`` takes, in the order of the metrics; arguments as of ``estimates``."""
    return [
        (metric, values[name], values[metric.weight] if metric.weight else None)
        for name, metric in metrics.items()
    ]


def estimate_all(samples: Iterable[Sample]) -> list[Estimate]:
    """``estimate`` of each, to the last bit, which is faster than one by one."""
    found: list[Estimate | None] = []
    means: list[NDArray[np.float64]] = []
    for metric, values, weights in samples:
        sample = _defined(values if weights is None else linearised(values, weights))
        share = metric.kind == "proportion" and np.isin(sample, (0.0, 1.0)).all()
        found.append(wilson_interval(sample) if share else None)
        means += [] if share else [sample]
    intervals = iter(_mean_intervals(means))
    return [next(intervals) if one is None else one for one in found]


def linearised(values: ArrayLike, weights: ArrayLike) -> NDArray[np.float64]:
    """Values whose plain mean is the weighted one, and whose spread is that of the weighted mean.

    With r = sum w v / sum w they are r + (v - r) w / mean(w), the linearised ratio of two sums
    (Cochran 1977, section 6.3). Equal weights give the values themselves.

    Args:
        values: (n,) rates; NaN where they are not defined.
        weights: (n,) what they are per, >= 0.

    Returns:
        (n,) NaN where a rate is not defined or weighs nothing.
    """
    v, w = np.asarray(values, dtype=float), np.asarray(weights, dtype=float)
    counts = ~np.isnan(v) & (w > 0)
    found = np.full(len(v), np.nan)
    if counts.any():
        v, w = v[counts], w[counts]
        mean = np.sum(v * w) / np.sum(w)
        found[counts] = mean + (v - mean) * w / w.mean()
    return found


def wilson_interval(values: ArrayLike) -> Estimate:
    """Share of ones with Wilson's score interval (Wilson 1927).

    Args:
        values: (n,) zeros and ones; NaN is left out.

    Raises:
        ValueError: another value.
    """
    sample = _defined(values)
    if not np.isin(sample, (0.0, 1.0)).all():
        raise ValueError("wilson_interval: values must be 0 or 1")
    n, ones = len(sample), int(sample.sum())
    if n == 0:
        return Estimate(np.nan, np.nan, np.nan, 0)
    return Estimate(ones / n, *_wilson_limits(ones, n), n)


def mean_interval(values: ArrayLike) -> Estimate:
    """Mean with its BCa bootstrap interval (Efron 1987).

    One value says nothing about its spread: its interval is NaN. Equal values give an interval of
    width zero.

    Args:
        values: (n,) NaN is left out.
    """
    return _mean_intervals([_defined(values)])[0]


def paired_difference(differences: ArrayLike) -> Difference:
    """Mean of paired differences: BCa interval and two-sided paired permutation test.

    Args:
        differences: (n,) one per seed, in the order of the seeds; NaN is left out.
    """
    return paired_differences([differences])[0]


def paired_differences(several: Iterable[ArrayLike]) -> list[Difference]:
    """``paired_difference`` of several samples, which is faster than one by one."""
    samples = [_defined(differences) for differences in several]
    return [
        Difference(*interval, p)
        for interval, p in zip(_mean_intervals(samples), sign_flip_p(samples), strict=True)
    ]


def per_episode(rows: pd.DataFrame, metrics: Iterable[str]) -> pd.DataFrame:
    """One row per scenario and seed, in that order, with the means over the episode's robots.

    The robots of one episode are no independent observations.

    Args:
        rows: one per episode and robot, with columns ``scenario``, ``seed`` and the metrics.
        metrics: those to keep, and with them what weighs them; NaN where the rows are older than
            the metric.
    """
    episode = ["scenario", "seed"]
    weights = {name: weight for name in metrics if (weight := _weight(name))}
    names = dict.fromkeys([*metrics, *weights.values()])
    kept = rows.reindex(columns=[*episode, *names])
    means = kept.groupby(episode, as_index=False).mean()
    if len(means) < len(kept):
        for name, weight in weights.items():
            counts = kept[weight].where(kept[name].notna())
            sums = kept[episode].assign(events=kept[name] * counts, exposure=counts)
            total = sums.groupby(episode, as_index=False).sum()
            means[name] = total["events"] / total["exposure"].where(total["exposure"] > 0)
    return means


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


def compare(a: pd.DataFrame, b: pd.DataFrame, metrics: Sequence[str] | None = None) -> pd.DataFrame:
    """Compare two agents on the seeds both ran, per scenario and metric.

    Args:
        a: one row per episode with columns ``scenario``, ``seed`` and the metrics.
        b: the same for the other agent.
        metrics: which to compare; by default all of ``METRICS`` that both tables have. Of those
            that are weighted, the tables have the weights too.

    Returns:
        One row per scenario that both ran and metric: ``scenario``, ``metric``, ``n`` (pairs with
        both values defined), ``mean_a``, ``mean_b`` (over those pairs), ``difference`` (a - b)
        with ``low`` and ``high``, ``p``, and ``p_holm``, corrected over the whole table.

    Raises:
        PairingError: a seed that occurs twice, or nothing in common; names the seeds.
    """
    if metrics is None:
        metrics = [name for name in METRICS if name in a and name in b]
    needed = [*metrics, *filter(None, map(_weight, metrics))]
    for side, table in (("first", a), ("second", b)):
        _check(table, side, needed)
    known = set(b["scenario"])
    scenarios = [name for name in dict.fromkeys(a["scenario"]) if name in known]
    if not scenarios:
        raise PairingError(
            f"no scenario in common: the first has {_listed(a['scenario'])}, "
            f"the second {_listed(b['scenario'])}"
        )
    pairs = {}
    for scenario in scenarios:
        one, other = _paired(a, b, scenario)
        for metric in metrics:
            pairs[scenario, metric] = defined_pairs(metric, one, other)
    rows = []
    differences = paired_differences([x - y for x, y in pairs.values()])
    for ((scenario, metric), (x, y)), difference in zip(pairs.items(), differences, strict=True):
        rows.append(
            {
                "scenario": scenario,
                "metric": metric,
                "n": difference.n,
                "mean_a": x.mean() if len(x) else np.nan,
                "mean_b": y.mean() if len(y) else np.nan,
                "difference": difference.mean,
                "low": difference.low,
                "high": difference.high,
                "p": difference.p,
            }
        )
    table = pd.DataFrame(rows)
    table["p_holm"] = holm(table["p"])
    return table


def defined_pairs(
    metric: str,
    one: Mapping[str, ArrayLike] | pd.DataFrame,
    other: Mapping[str, ArrayLike] | pd.DataFrame,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The values of two tables (of columns) with the same seeds where both are defined, (n,) each.

    Those of a weighted metric are linearised.
    """
    x, y = (np.asarray(table[metric], dtype=float) for table in (one, other))
    weight = _weight(metric)
    if not weight:
        both = ~(np.isnan(x) | np.isnan(y))
        return x[both], y[both]
    u, w = (np.asarray(table[weight], dtype=float) for table in (one, other))
    both = ~(np.isnan(x) | np.isnan(y)) & (u > 0) & (w > 0)
    return linearised(x[both], u[both]), linearised(y[both], w[both])


def _weight(metric: str) -> str:
    """The metric that weighs another one; empty for none."""
    return METRICS[metric].weight if metric in METRICS else ""


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


def _mean_intervals(samples: Sequence[NDArray[np.float64]]) -> list[Estimate]:
    """Of samples without NaN."""
    return [
        Estimate(float(sample.mean()) if len(sample) else np.nan, *limits, len(sample))
        for sample, limits in zip(samples, bootstrap_limits(samples), strict=True)
    ]


def _wilson_limits(ones: int, n: int) -> tuple[float, float]:
    """Equation 4 of Wilson (1927), in the form of Newcombe (1998)."""
    z, share = float(ndtri((1 + CONFIDENCE) / 2)), ones / n
    whole = 2 * (n + z**2)
    centre = (2 * n * share + z**2) / whole
    reach = z / whole * math.sqrt(4 * n * share * (1 - share) + z**2)
    # At the ends rounding would leave the limit next to 0 or 1.
    return centre - reach if ones > 0 else 0.0, centre + reach if ones < n else 1.0


def _defined(values: ArrayLike) -> NDArray[np.float64]:
    sample = np.asarray(values, dtype=float)
    return sample[~np.isnan(sample)]
