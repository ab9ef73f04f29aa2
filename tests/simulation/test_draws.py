"""What compiled code draws for itself, against distributions of scipy."""

import itertools

import numpy as np
import pytest
from scipy import stats

from crowdbench.simulation import draws

COUNT = 200_000


def drawn(draw, *key):
    """``COUNT`` numbers of a sequence."""
    return np.array([draw(*key, index) for index in range(COUNT)])


def test_splitmix64_is_the_published_one():
    """The first numbers that its authors' C program prints for the seed 1234567."""
    found = [int(draws.splitmix64(np.uint64(1234567), index)) for index in range(5)]
    assert found == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]


@pytest.mark.parametrize("seed", [0, 2**63 + 11])
def test_normal_numbers_are(seed):
    numbers = drawn(draws.normal, np.uint64(seed))
    assert stats.kstest(numbers, "norm").pvalue > 1e-3
    # Where the ziggurat's lowest block ends and its tail begins.
    edge = 3.442619855899
    far = np.abs(numbers)[np.abs(numbers) > edge]
    assert stats.binomtest(len(far), COUNT, 2 * stats.norm.sf(edge)).pvalue > 1e-3
    assert stats.kstest(far, stats.truncnorm(edge, np.inf).cdf).pvalue > 1e-3
    assert stats.binomtest(int((numbers > 0).sum()), COUNT).pvalue > 1e-3


def test_normal_numbers_do_not_hang_together():
    """Neighbours in a sequence, and the same place of sequences whose seeds are neighbours."""
    one, other = (drawn(draws.normal, np.uint64(seed)) for seed in (5, 6))
    for left, right in ((one[1:], one[:-1]), (one, other), (np.abs(one), np.abs(other))):
        assert stats.pearsonr(left, right).pvalue > 1e-3


@pytest.mark.parametrize("share", [0.01, 0.3, 0.9])
def test_gaps_are_geometric(share):
    gaps = drawn(draws.gap, share, np.uint64(3))
    values, counts = np.unique(gaps, return_counts=True)
    likely = stats.geom.pmf(values + 1, share) * COUNT
    kept = likely > 5
    assert (
        stats.chisquare(
            [*counts[kept], COUNT - counts[kept].sum()], [*likely[kept], COUNT - likely[kept].sum()]
        ).pvalue
        > 1e-3
    )


def test_the_ends_of_a_share():
    assert {draws.gap(1.0, np.uint64(4), index) for index in range(1000)} == {0.0}
    assert min(draws.gap(1e-300, np.uint64(4), index) for index in range(1000)) > 1e200


def test_purposes_and_keys_have_sequences_of_their_own():
    purposes = draws.ATTENTION, draws.STOPS, draws.SERVICE, draws.LOST_BEAMS, draws.SCAN_NOISE
    seeds = [
        int(draws.sequence(np.uint64(key), purpose))
        for key, purpose in itertools.product((0, 1, 2**64 - 1), purposes)
    ]
    assert len(set(seeds)) == len(seeds)
    numbers = {draws.between(np.array([2.0, 5.0]), np.uint64(8), p, 0) for p in purposes}
    assert len(numbers) == len(purposes)
    assert all(2.0 <= number < 5.0 for number in numbers)
