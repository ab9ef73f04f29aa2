"""The order of scores, equal ones included, is that of numba's ``argsort``."""

import numba
import numpy as np
import pytest
from crowdbench_agents.informed.sorting import sort


@pytest.fixture(scope="module")
def argsort():
    return numba.njit(lambda scores: np.argsort(scores))


@pytest.mark.parametrize("size", [0, 1, 2, 15, 16, 17, 100, 1430])
@pytest.mark.parametrize("values", [2, 7, 10**9])
def test_scores_are_ordered_as_by_argsort(argsort, size, values):
    rng = np.random.default_rng([size, values])
    for _ in range(20):
        scores = rng.integers(values, size=size).astype(float)
        scores[rng.random(size) < 0.1] = np.inf
        for given in (scores, np.sort(scores), np.sort(scores)[::-1].copy()):
            order = np.empty(size, dtype=np.int64)
            sort(given, order)
            np.testing.assert_array_equal(order, argsort(given))


def test_scores_beyond_the_order_s_length_are_left_out():
    order = np.empty(3, dtype=np.int64)
    sort(np.array([2.0, 3.0, 1.0, 0.0]), order)
    assert order.tolist() == [2, 0, 1]
