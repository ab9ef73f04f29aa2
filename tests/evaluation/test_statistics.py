from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from crowdbench.evaluation.metric import Metric
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.statistics import (
    PairingError,
    compare,
    estimate,
    estimates,
    linearised,
    mean_interval,
    per_episode,
    wilson_interval,
)


def rng(seed=0):
    return np.random.default_rng(seed)


def ones(successes, n):
    return [1.0] * successes + [0.0] * (n - successes)


# Wilson


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        # Newcombe 1998, "Two-sided confidence intervals for the single proportion", Table I
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_agrees_with_the_published_table(successes, n, low, high):
    found = wilson_interval(ones(successes, n))
    assert found.mean == successes / n
    assert found.n == n
    assert (found.low, found.high) == pytest.approx((low, high), abs=5e-5)


@given(n=st.integers(1, 3000), share=st.floats(0, 1))
def test_wilson_is_scipys_to_the_last_bit(n, share):
    successes = round(share * n)
    expected = stats.binomtest(successes, n).proportion_ci(0.95, method="wilson")
    assert wilson_interval(ones(successes, n))[1:3] == tuple(expected)


@given(n=st.integers(1, 500), share=st.floats(0, 1))
def test_wilson_contains_the_share_and_is_symmetric(n, share):
    successes = round(share * n)
    found, opposite = (
        wilson_interval(ones(successes, n)),
        wilson_interval(ones(n - successes, n)),
    )
    assert 0 <= found.low <= found.mean <= found.high <= 1
    assert found.low == pytest.approx(1 - opposite.high, abs=1e-12)
    assert found.high - found.low < 1


@given(n=st.integers(2, 200), share=st.floats(0, 1))
def test_a_wilson_bound_is_a_share_whose_score_test_just_rejects(n, share):
    successes = round(share * n)
    found = wilson_interval(ones(successes, n))
    for bound in (found.low, found.high):
        if 0 < bound < 1:
            score = (found.mean - bound) / math.sqrt(bound * (1 - bound) / n)
            assert abs(score) == pytest.approx(1.959964, abs=1e-5)


@pytest.mark.parametrize("p", [0.05, 0.5, 0.9, 0.98])
def test_wilson_covers_the_true_share_as_often_as_promised(p):
    """Exactly, over the binomial distribution of 100 runs; Wilson is near 0.95 on average."""
    covered = [
        low <= p <= high for _, low, high, _ in (wilson_interval(ones(k, 100)) for k in range(101))
    ]
    coverage = stats.binom.pmf(np.arange(101), 100, p) @ np.array(covered)
    assert 0.93 < coverage < 0.98


def test_wilson_leaves_out_nan_and_knows_nothing_of_nothing():
    assert wilson_interval([1.0, math.nan, 0.0]) == wilson_interval([1.0, 0.0])
    assert all(math.isnan(x) for x in wilson_interval([])[:3])


def test_wilson_refuses_what_is_no_proportion():
    with pytest.raises(ValueError, match="0 or 1"):
        wilson_interval([0.5])


# Bootstrap


def test_the_bootstrap_agrees_with_students_interval_for_normal_values():
    values = rng(3).normal(10.0, 2.0, 200)
    found = mean_interval(values)
    half = stats.t.ppf(0.975, 199) * values.std(ddof=1) / math.sqrt(200)
    assert found.mean == pytest.approx(values.mean())
    assert found.low == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert found.high == pytest.approx(values.mean() + half, abs=0.1 * half)


def test_the_bootstrap_leans_towards_the_long_tail():
    mean, low, high, _ = mean_interval(rng(4).exponential(1.0, 30))
    assert high - mean > 1.1 * (mean - low)


def test_the_bootstrap_covers_the_true_mean_about_as_often_as_promised():
    covered = 0
    for seed in range(200):
        found = mean_interval(rng(seed).exponential(1.0, 40))
        covered += found.low <= 1.0 <= found.high
    # 0.95 less the known optimism for skewed samples of 40, with four standard errors of room
    assert 0.86 < covered / 200 <= 1.0


@given(values=st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=12))
@settings(max_examples=150, deadline=None)
def test_the_bootstraps_interval_lies_within_the_sample(values):
    found = mean_interval(values)
    slack = 1e-9 * (1 + max(map(abs, values)))
    assert min(values) - slack <= found.low <= found.high <= max(values) + slack


def test_the_bootstrap_depends_on_nothing_but_the_values():
    values = rng(5).normal(size=30)
    assert mean_interval(values) == mean_interval([*values, math.nan]) == mean_interval(values)


def test_equal_values_have_an_interval_of_width_zero():
    assert mean_interval([0.1] * 7) == (pytest.approx(0.1),) * 3 + (7,)


def test_one_value_or_none_has_no_interval():
    one = mean_interval([2.0])
    assert (one.mean, one.n) == (2.0, 1)
    assert math.isnan(one.low)
    assert math.isnan(one.high)
    none = mean_interval([math.nan])
    assert none.n == 0 and all(math.isnan(number) for number in none[:3])


# Which of the two


@pytest.mark.parametrize("name", METRICS)
def test_the_kind_of_a_metric_decides_on_its_interval(name):
    values, weights = [*ones(9, 12), math.nan], np.arange(1.0, 14.0)
    entry = METRICS[name]
    if entry.weight:
        expected = mean_interval(linearised(values, weights))
        assert estimate(entry, values, weights) == expected != mean_interval(values)
    else:
        expected = wilson_interval if entry.kind == "proportion" else mean_interval
        assert estimate(entry, values) == expected(values)


def test_a_proportion_averaged_over_robots_is_a_mean():
    values = [1.0, 0.5, 0.0, 1.0]
    assert estimate(METRICS["success"], values) == mean_interval(values)


def test_the_robots_of_an_episode_are_one_observation():
    rows = pd.DataFrame(
        {
            "scenario": ["y", "x", "x", "x", "x"],
            "seed": [0, 5, 3, 5, 3],
            "robot": ["robot_0", "robot_0", "robot_0", "robot_1", "robot_1"],
            "success": [1.0, 1.0, 1.0, 0.0, 1.0],
            "jerk": [1.0, math.nan, 2.0, 3.0, 4.0],
        }
    )
    found = per_episode(rows, ["success", "jerk", "spl"])
    assert found["scenario"].tolist() == ["x", "x", "y"]
    assert found["seed"].tolist() == [3, 5, 0]
    assert found["success"].tolist() == [1.0, 0.5, 1.0]
    assert found["jerk"].tolist() == [3.0, 3.0, 1.0]
    assert found["spl"].isna().all(), "rows older than a metric do not have it"


# Rates


RATE = Metric(len, "1/min", "lower", "", "mean", weight="minutes")


@pytest.fixture
def rate(monkeypatch):
    monkeypatch.setitem(METRICS._known, "rate", RATE)
    monkeypatch.setitem(METRICS._known, "minutes", Metric(len, "min", "lower", "", "mean"))


def exposed(n, seed=0):
    """Events, and the minutes in which they happened."""
    rng = np.random.default_rng(seed)
    minutes = rng.uniform(0.05, 0.6, n)
    return rng.poisson(3 * minutes).astype(float), minutes


def test_the_mean_of_a_rate_is_all_events_over_all_time():
    # Two events in a minute and one in the three seconds before a collision: 3 in 1.05 min, while
    # the plain mean of 2 and 20 a minute is 11.
    found = estimate(RATE, [2.0, 20.0], [1.0, 0.05])
    assert found.mean == pytest.approx(3 / 1.05)


def test_a_rate_of_equal_times_is_a_mean_like_any_other():
    events, _ = exposed(40)
    weighted, plain = estimate(RATE, events, np.full(40, 0.5)), mean_interval(events)
    assert weighted == pytest.approx(plain)


def test_episodes_without_a_rate_or_without_time_are_left_out():
    values, weights = [2.0, np.nan, 4.0, np.nan], [1.0, 2.0, 3.0, 0.0]
    found = estimate(RATE, values, weights)
    assert (found.mean, found.n) == (pytest.approx(14 / 4), 2)
    assert np.isnan(estimate(RATE, [np.nan], [np.nan]).mean)


def test_the_interval_of_a_rate_is_that_of_a_ratio_of_sums():
    events, minutes = exposed(200)
    expected = stats.bootstrap(
        (events, minutes), lambda x, w, axis: x.sum(axis) / w.sum(axis), paired=True,
        vectorized=True, method="BCa", rng=np.random.default_rng(1),
    ).confidence_interval  # fmt: skip
    found = estimate(RATE, events / minutes, minutes)
    width = expected.high - expected.low
    assert found[1:3] == pytest.approx(tuple(expected), abs=0.05 * width)


def test_rates_are_compared_by_events_over_time(rate):
    (x, u), (y, w) = exposed(50, 1), exposed(50, 2)
    a, b = (
        pd.DataFrame(
            {"scenario": "s", "seed": range(50), "rate": events / minutes, "minutes": minutes}
        )
        for events, minutes in ((x, u), (y, w))
    )
    (line,) = compare(a, b, ["rate"]).itertuples()
    assert line.mean_a == pytest.approx(x.sum() / u.sum())
    assert line.difference == pytest.approx(x.sum() / u.sum() - y.sum() / w.sum())
    assert line.low < line.difference < line.high
    with pytest.raises(PairingError, match="'minutes'"):
        compare(a.drop(columns="minutes"), b, ["rate"])


def test_the_rate_of_an_episode_is_that_of_all_its_robots(rate):
    rows = pd.DataFrame(
        {
            "scenario": "s",
            "seed": [0, 0, 1, 1],
            "rate": [2.0, 8.0, np.nan, 5.0],
            "minutes": [1.0, 0.5, 0.0, 2.0],
        }
    )
    found = per_episode(rows, ["rate"])
    assert found["rate"].tolist() == pytest.approx([6 / 1.5, 5.0])
    assert estimates({"rate": RATE}, found)["rate"].mean == pytest.approx(16 / 3.5)
