from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench.evaluation.resampling import bootstrap_mean, sign_flip_p
from crowdbench.evaluation.statistics import bootstrap_interval, paired_permutation_test


@pytest.mark.parametrize("n", [12, 100, 500])
@pytest.mark.parametrize("kind", ["normal", "exponential", "binary"])
def test_intervals_agree_with_those_of_the_statistics_module(n, kind):
    rng = np.random.default_rng(n)
    sample = {
        "normal": rng.normal(3, 2, n),
        "exponential": rng.exponential(1, n),
        "binary": (rng.random(n) < 0.8).astype(float),
    }[kind]
    fast, slow = bootstrap_mean(sample), bootstrap_interval(sample, np.random.default_rng(1))
    width = slow.high - slow.low
    assert fast.mean == pytest.approx(slow.mean)
    assert fast.n == slow.n
    assert (fast.low, fast.high) == pytest.approx((slow.low, slow.high), abs=0.05 * width)


@pytest.mark.parametrize(("n", "shift"), [(50, 0.2), (100, 0.25), (500, 0.1)])
def test_p_values_agree_with_those_of_the_statistics_module(n, shift):
    rng = np.random.default_rng(n)
    a, b = rng.normal(shift, 1, n), rng.normal(0, 1, n)
    p = paired_permutation_test(a, b, np.random.default_rng(1))
    error = 4 * math.sqrt(p * (1 - p) / 9999) + 2e-4
    assert sign_flip_p(a - b) == pytest.approx(p, abs=error)


def test_few_pairs_are_enumerated():
    # All ten positive: of 2^10 ways to swap, only this one and its opposite are as extreme.
    assert sign_flip_p(np.arange(1.0, 11.0)) == 2 / 1024
    # 1 - 2 + 4 = 3: sums are +-7, +-5, +-3, +-1; six of eight are at least 3 in size.
    assert sign_flip_p(np.array([1.0, -2.0, 4.0])) == 6 / 8


def test_equal_sums_count_as_equal_whatever_the_rounding():
    # 0.1 + 0.2 - 0.3 is not quite zero: all 8 sums of size 0 or more are as extreme.
    assert sign_flip_p(np.array([0.1, 0.2, -0.3])) == 1.0


def test_what_cannot_be_said_is_nan():
    assert bootstrap_mean(np.array([])).n == 0
    assert math.isnan(bootstrap_mean(np.array([])).mean)
    single = bootstrap_mean(np.array([2.0, np.nan]))
    assert (single.mean, single.n) == (2.0, 1)
    assert math.isnan(single.low) and math.isnan(single.high)
    assert math.isnan(sign_flip_p(np.array([np.nan])))


def test_equal_values_have_an_interval_of_no_width():
    assert bootstrap_mean(np.full(7, 0.3))[:3] == (0.3, 0.3, 0.3)
    assert sign_flip_p(np.zeros(50)) == 1.0
    rounded = np.arange(50) * 0.01 + 0.1 - np.arange(50) * 0.01  # 0.1, but for the last bits
    assert bootstrap_mean(rounded)[:3] == pytest.approx((0.1, 0.1, 0.1))


@settings(deadline=None, max_examples=30)
@given(
    values=st.lists(st.floats(-5, 5), min_size=20, max_size=20),
    factor=st.floats(0.1, 100),
    shift=st.floats(-100, 100),
)
def test_intervals_move_and_scale_with_the_sample(values, factor, shift):
    sample = np.array(values)
    if np.ptp(sample) < 1e-3:
        return
    before, after = bootstrap_mean(sample), bootstrap_mean(factor * sample + shift)
    expected = [factor * x + shift for x in before[:3]]
    assert after[:3] == pytest.approx(expected, abs=1e-6 * (1 + abs(shift) + factor))


def test_p_is_the_same_for_both_directions_and_every_scale():
    sample = np.random.default_rng(3).normal(0.2, 1, 80)
    assert sign_flip_p(sample) == sign_flip_p(-sample) == sign_flip_p(1000 * sample)


def test_p_is_as_often_below_a_level_as_the_level_says():
    """Under the null hypothesis p-values are uniform."""
    rng = np.random.default_rng(5)
    p = np.array([sign_flip_p(rng.normal(0, 1, 60)) for _ in range(400)])
    for level in (0.05, 0.25, 0.5):
        error = 4 * math.sqrt(level * (1 - level) / len(p))
        assert np.mean(p <= level) == pytest.approx(level, abs=error)
