from __future__ import annotations

import itertools
import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from crowdbench.evaluation.statistics import (
    PairingError,
    compare,
    holm,
    paired_difference,
)


def rng(seed=0):
    return np.random.default_rng(seed)


def ones(successes, n):
    return [1.0] * successes + [0.0] * (n - successes)


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
