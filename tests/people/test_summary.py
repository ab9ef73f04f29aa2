"""People, density and speeds over time."""

import numpy as np
import pytest

from crowdbench.people.summary import most_people, over_time, whole


@pytest.fixture
def two(cleaned):
    """One walks for 4 s at 1 m/s, the other stands in the first of them."""
    walker = [(1, f, 0.1 * f + 0.01, 0.1) for f in range(41)]
    stander = [(2, f, 0.6, 0.1) for f in range(11)]
    return cleaned([*walker, *stander])


def test_people_are_counted_over_time(two):
    assert [span.people for span in over_time(two, 4)] == pytest.approx([2, 1, 1, 1])
    assert whole(two).people == pytest.approx(5 / 4)
    assert [span.begin for span in over_time(two, 4)] == pytest.approx([0, 1, 2, 3])
    assert over_time(two, 4)[-1].end == pytest.approx(4)


def test_density_is_people_by_the_area_walked_on(two):
    area = 9 * 0.25  # x from 0.01 to 4.01, in cells of half a metre
    assert two.area == pytest.approx(area)
    assert [span.density for span in over_time(two, 2)] == pytest.approx([1.5 / area, 1 / area])


def test_speeds_are_quantiles_of_everybody(two):
    first, *_, last = over_time(two, 4)
    assert last.speeds == pytest.approx((1, 1, 1))
    assert first.speeds == pytest.approx((0, 0.5, 1))


def test_a_part_without_anybody_has_no_speed(cleaned):
    early = [(1, f, 0.1 * f, 0.0) for f in range(10)]
    late = [(1, f, 0.1 * f, 0.0) for f in range(90, 100)]
    middle = over_time(cleaned([*early, *late]), 3)[1]
    assert middle.people == 0 and np.isnan(middle.speeds).all()


def test_the_most_people_at_a_time(cleaned, two):
    assert most_people(two) == 2
    spans = {1: range(0, 20), 2: range(10, 30), 3: range(19, 40), 4: range(30, 50)}
    rows = [(p, f, 0.1 * f, float(p)) for p, frames in spans.items() for f in frames]
    assert most_people(cleaned(rows)) == 3
