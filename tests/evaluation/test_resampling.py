from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from crowdbench.evaluation import resampling
from crowdbench.evaluation.resampling import bootstrap_limits, sign_flip_p


@pytest.mark.parametrize("n", [12, 100, 500])
@pytest.mark.parametrize("kind", ["normal", "exponential", "binary"])
def test_limits_agree_with_scipys_bootstrap(n, kind):
    rng = np.random.default_rng(n)
    sample = {
        "normal": rng.normal(3, 2, n),
        "exponential": rng.exponential(1, n),
        "binary": (rng.random(n) < 0.8).astype(float),
    }[kind]
    expected = stats.bootstrap((sample,), np.mean, method="BCa", rng=rng).confidence_interval
    width = expected.high - expected.low
    (found,) = bootstrap_limits([sample])
    assert found == pytest.approx(tuple(expected), abs=0.05 * width)


@pytest.mark.parametrize(("n", "shift"), [(8, 0.5), (50, 0.2), (100, 0.25), (500, 0.1)])
def test_p_values_agree_with_scipys_permutation_test(n, shift):
    rng = np.random.default_rng(n)
    differences = rng.normal(shift, 1, n) - rng.normal(0, 1, n)
    p = stats.permutation_test(
        (differences,), np.mean, permutation_type="samples", rng=rng
    ).pvalue  # fmt: skip
    error = 4 * math.sqrt(p * (1 - p) / 9999) + 2e-4
    assert sign_flip_p([differences])[0] == pytest.approx(p, abs=error if n > 13 else 1e-12)


def test_few_pairs_are_enumerated():
    # All ten positive: of 2^10 ways to swap, only this one and its opposite are as extreme.
    assert sign_flip_p([np.arange(1.0, 11.0)]) == [2 / 1024]
    # 1 - 2 + 4 = 3: sums are +-7, +-5, +-3, +-1; six of eight are at least 3 in size.
    assert sign_flip_p([np.array([1.0, -2.0, 4.0])]) == [6 / 8]


def test_equal_sums_count_as_equal_whatever_the_rounding():
    # 0.1 + 0.2 - 0.3 is not quite zero: all 8 sums of size 0 or more are as extreme.
    assert sign_flip_p([np.array([0.1, 0.2, -0.3])]) == [1.0]


def test_what_cannot_be_said_is_nan():
    for limits in bootstrap_limits([np.array([]), np.array([2.0])]):
        assert all(math.isnan(limit) for limit in limits)
    assert math.isnan(sign_flip_p([np.array([])])[0])


def test_equal_values_have_an_interval_of_no_width():
    assert bootstrap_limits([np.full(7, 0.3)]) == [(0.3, 0.3)]
    assert sign_flip_p([np.zeros(50)]) == [1.0]
    rounded = np.arange(50) * 0.01 + 0.1 - np.arange(50) * 0.01  # 0.1, but for the last bits
    assert bootstrap_limits([rounded])[0] == pytest.approx((0.1, 0.1))


def test_draws_do_not_depend_on_how_many_are_made_at_a_time(monkeypatch):
    sample = np.random.default_rng(2).normal(0.1, 1, 300)
    (limits,), p = bootstrap_limits([sample]), sign_flip_p([sample])
    monkeypatch.setattr(resampling, "_BLOCK", 2000)
    assert bootstrap_limits([sample])[0] == pytest.approx(limits, rel=1e-12)
    assert sign_flip_p([sample]) == p


def test_samples_have_the_same_limits_together_and_alone():
    rng = np.random.default_rng(4)
    samples = [*rng.normal(size=(3, 120)), np.full(120, 0.5), rng.random(120), rng.random(70)]
    samples += [rng.normal(size=9), rng.normal(size=70), np.zeros(9)]
    for several in (bootstrap_limits, sign_flip_p):
        assert several(samples) == [one for sample in samples for one in several([sample])]
        assert several([]) == []


def test_memory_does_not_grow_with_the_sample():
    sample = np.random.default_rng(2).normal(0.1, 1, 6000)
    tracemalloc.start()
    bootstrap_limits([sample])
    sign_flip_p([sample])
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 20e6, "the draws are 60 MB, in one byte each"


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
    before, after = bootstrap_limits([sample, factor * sample + shift])
    expected = [factor * x + shift for x in before]
    assert after == pytest.approx(expected, abs=1e-6 * (1 + abs(shift) + factor))


def test_p_is_the_same_for_both_directions_and_every_scale():
    sample = np.random.default_rng(3).normal(0.2, 1, 80)
    one, reversed_, scaled = sign_flip_p([sample, -sample, 1000 * sample])
    assert one == reversed_ == scaled


def test_p_is_as_often_below_a_level_as_the_level_says():
    """Under the null hypothesis p-values are uniform."""
    rng = np.random.default_rng(5)
    p = np.array(sign_flip_p(rng.normal(0, 1, (400, 60))))
    for level in (0.05, 0.25, 0.5):
        error = 4 * math.sqrt(level * (1 - level) / len(p))
        assert np.mean(p <= level) == pytest.approx(level, abs=error)
