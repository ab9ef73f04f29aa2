from __future__ import annotations

import itertools
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
    holm,
    linearised,
    mean_interval,
    paired_difference,
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


# Permutation test


def enumerated(a, b):
    """Share of all 2^n swaps of pairs with a mean difference at least as far from zero."""
    difference = np.asarray(a) - np.asarray(b)
    signs = np.array(list(itertools.product([1, -1], repeat=len(difference))))
    sums = np.abs(signs @ difference)
    return np.mean(sums >= abs(difference.sum()) - 1e-9)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 9), binary=st.booleans())
def test_the_permutation_test_is_exact_for_few_pairs(seed, n, binary):
    draw = rng(seed)
    a, b = draw.integers(0, 2, (2, n)) if binary else draw.normal(size=(2, n))
    assert paired_difference(a - b).p == pytest.approx(enumerated(a, b))


def test_the_permutation_test_is_near_the_enumeration_for_more_pairs():
    a = rng(6).normal(0.4, 1.0, 16)
    b = np.zeros(16)
    drawn = paired_difference(a - b).p
    assert drawn == pytest.approx(enumerated(a, b), abs=0.02)
    assert drawn == paired_difference(a - b).p


def test_the_permutation_test_of_successes_is_mcnemars():
    # 12 seeds where only a succeeds, 3 where only b does: a sign test on 15 discordant pairs.
    a, b = ones(12 + 30, 50), [0.0] * 12 + [1.0] * 30 + [1.0] * 3 + [0.0] * 5
    expected = stats.binomtest(3, 15).pvalue
    assert paired_difference(np.subtract(a, b)).p == pytest.approx(expected, abs=0.008)


def test_pairs_without_a_difference_give_one_and_no_pairs_give_nan():
    assert paired_difference([0.0, 0.0]).p == paired_difference([3.0]).p == 1.0
    nothing = paired_difference([math.nan])
    assert nothing.n == 0 and math.isnan(nothing.p)


def test_two_agents_that_do_not_differ_are_rarely_told_apart():
    p = []
    for seed in range(200):
        a, b = rng(seed).normal(size=(2, 12))
        p.append(paired_difference(a - b).p)
    assert np.mean(np.array(p) < 0.05) < 0.1


# Holm


def test_holm_by_hand():
    # Sorted 0.005, 0.01, 0.03, 0.04 times 4, 3, 2, 1: 0.02, 0.03, 0.06, 0.04, and never falling.
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_holm_stays_below_one_and_ignores_nan():
    assert holm([0.6, math.nan, 0.7]) == pytest.approx([1.0, math.nan, 1.0], nan_ok=True)
    assert holm([0.04]) == pytest.approx([0.04])
    assert len(holm([])) == 0


@given(st.lists(st.floats(0, 1), min_size=1, max_size=20))
def test_holm_rejects_what_stepping_down_rejects(p):
    """Holm's own procedure: from the smallest on, reject while p_(k) <= alpha / (m - k)."""
    alpha = 0.05
    rejected = set()
    for k, i in enumerate(sorted(range(len(p)), key=lambda i: p[i])):
        if p[i] * (len(p) - k) > alpha:
            break
        rejected.add(i)
    assert set(np.flatnonzero(holm(p) <= alpha)) == rejected


# Comparing two agents


def table(scenario="open", seeds=range(8), **columns):
    return pd.DataFrame({"scenario": scenario, "seed": list(seeds), **columns})


def test_pairs_are_made_by_seed_not_by_row():
    a = table(spl=[float(s) for s in range(8)])
    b = table(spl=[s + 0.5 for s in range(8)]).sample(frac=1.0, random_state=1)
    row = compare(a, b).iloc[0]
    assert (row["n"], row["mean_a"], row["mean_b"]) == (8, 3.5, 4.0)
    assert (row["difference"], row["low"], row["high"]) == (-0.5, -0.5, -0.5)
    assert row["p"] == pytest.approx(2 / 2**8)


def test_the_order_of_the_rows_does_not_matter():
    x, y = rng(1).normal(size=(2, 20))
    a, b = table(seeds=range(20), jerk=x), table(seeds=range(20), jerk=y)
    one, other = a.sample(frac=1.0, random_state=1), b.sample(frac=1.0, random_state=2)
    pd.testing.assert_frame_equal(compare(one, other), compare(a, b))


def test_a_row_is_the_interval_and_test_of_the_differences():
    x, y = rng(1).normal(size=(2, 20))
    row = compare(table(seeds=range(20), jerk=x), table(seeds=range(20), jerk=y)).iloc[0]
    assert tuple(row[["difference", "low", "high", "n", "p"]]) == paired_difference(x - y)


def test_only_shared_seeds_count():
    a = table(seeds=range(0, 8), spl=np.arange(8.0))
    b = table(seeds=range(4, 12), spl=np.arange(4.0, 12.0) - 1.0)
    row = compare(a, b).iloc[0]
    assert (row["n"], row["difference"], row["mean_a"]) == (4, 1.0, 5.5)


def test_pairs_with_an_undefined_value_are_left_out():
    a = table(seeds=range(3), time_to_goal=[10.0, math.nan, 12.0])
    b = table(seeds=range(3), time_to_goal=[11.0, 9.0, math.nan])
    row = compare(a, b).iloc[0]
    assert (row["n"], row["mean_a"], row["mean_b"], row["p"]) == (1, 10.0, 11.0, 1.0)
    assert math.isnan(row["low"])


def test_every_scenario_and_metric_is_a_row_and_holm_covers_them_all():
    values = rng(2).normal(size=(4, 8))
    a = pd.concat([table("x", spl=values[0], jerk=values[1]), table("y", spl=values[2], jerk=1.0)])
    b = pd.concat([table("y", spl=values[3], jerk=0.0), table("x", spl=0.0, jerk=0.0)])
    result = compare(a, b)
    assert list(zip(result["scenario"], result["metric"], strict=True)) == [
        ("x", "spl"), ("x", "jerk"), ("y", "spl"), ("y", "jerk"),
    ]  # fmt: skip
    assert result["p_holm"].to_numpy() == pytest.approx(holm(result["p"]))
    assert compare(a, b, metrics=["jerk"])["metric"].tolist() == ["jerk", "jerk"]


def test_no_shared_seed_names_the_missing_ones():
    with pytest.raises(PairingError, match=r"first lacks 5, 6, the second lacks 0, 1"):
        compare(table(seeds=[0, 1], spl=0.0), table(seeds=[5, 6], spl=0.0))


def test_many_missing_seeds_are_counted():
    with pytest.raises(PairingError, match=r"second lacks 0, 1, .*, 9 and 90 more"):
        compare(table(seeds=range(100), spl=0.0), table(seeds=[100], spl=0.0))


def test_no_shared_scenario_names_both():
    with pytest.raises(PairingError, match="first has x, the second y"):
        compare(table("x", spl=0.0), table("y", spl=0.0))


def test_a_seed_that_occurs_twice_is_refused():
    with pytest.raises(PairingError, match="second table has seed 3 of 'open' more than once"):
        compare(table(spl=0.0), table(seeds=[3, 3], spl=0.0))


def test_a_missing_column_is_named():
    with pytest.raises(PairingError, match="second table has no column 'spl'"):
        compare(table(spl=0.0), table(), metrics=["spl"])


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
