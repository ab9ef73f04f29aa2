"""Measures of walking people against what follows by hand."""

import numpy as np
import pytest

from crowdbench.people.likeness import (
    MEASURES,
    Frames,
    acceleration,
    densities,
    detour,
    lane_order,
    nearest_distance,
    passing_distance,
    time_to_collision,
)

PERIOD = 0.2


def frames(*ways):
    """People on given ways (T, 2)."""
    return Frames(np.stack(ways, axis=1), PERIOD)


def line(start, velocity, steps=41):
    times = PERIOD * np.arange(steps)[:, None]
    return np.array(start) + times * np.array(velocity)


def test_speed_is_that_of_a_straight_walk():
    walk = frames(line((0, 0), (0.6, 0.8)))
    known = walk.speed[np.isfinite(walk.speed)]
    assert known == pytest.approx(np.ones(41 - 4))


def test_density_counts_everybody_in_the_circle_oneself_included():
    density, speed = densities(
        frames(line((0, 0), (1, 0)), line((1, 0), (1, 0)), line((5, 0), (1, 0)))
    )
    assert sorted(set(np.round(density * np.pi * 1.5**2, 6))) == [1, 2]
    assert speed == pytest.approx(np.ones_like(speed))


def test_the_nearest_is_the_nearest():
    found = nearest_distance(
        frames(line((0, 0), (1, 0)), line((0, 0.7), (1, 0)), line((0, 2), (1, 0)))
    )
    assert sorted(set(np.round(found, 6))) == [0.7, 1.3]


def test_two_who_walk_at_each_other_collide_when_their_bodies_meet():
    # 8 m apart at 2 m/s: bodies of 0.2 m meet after (8 - 0.4) / 2 s.
    found = time_to_collision(frames(line((0, 0), (1, 0), 17), line((8, 0), (-1, 0), 17)))
    first = (8 - 0.4) / 2 - 2 * PERIOD
    assert found[0] == pytest.approx(first)
    assert np.diff(found[::2]) == pytest.approx(np.full(len(found) // 2 - 1, -PERIOD))


def test_bodies_that_overlap_and_meetings_far_ahead_are_no_times_to_collision():
    overlapping = frames(line((0, 0), (0.1, 0), 9), line((0.3, 0), (-0.1, 0), 9))
    assert len(time_to_collision(overlapping)) == 0
    later = frames(line((0, 0), (1, 0), 25), line((16, 0), (-1, 0), 25))
    # 7.8 s at first, and 3.4 s when their velocities are known for the last time.
    assert time_to_collision(later).min() == pytest.approx(3.4)
    assert time_to_collision(later).max() < 5.0


def test_who_is_passed_on_the_right_is_there_for_both():
    found = passing_distance(frames(line((-4, 0), (1, 0)), line((4, -0.8), (-1, 0))))
    assert found == pytest.approx([-0.8, -0.8])


@pytest.mark.parametrize(
    "other",
    [
        line((4, -2.1), (-1, 0)),  # too far to the side
        line((4, -0.8), (-0.2, 0)),  # hardly moves
        line((1.5, -4), (-0.5, 1)),  # crosses
        line((0, -0.8), (1, 0)),  # walks beside
    ],
)
def test_only_people_who_walk_the_other_way_nearby_are_passed(other):
    assert len(passing_distance(frames(line((-4, 0), (1, 0)), other))) == 0


def test_lanes_of_their_own_are_ordered_and_mixed_ones_are_not():
    apart = frames(
        line((0, 0), (1, 0)), line((2, 0), (1, 0)), line((5, 3), (-1, 0)), line((7, 3), (-1, 0))
    )
    assert lane_order(apart) == pytest.approx(1.0)
    mixed = frames(line((0, 0), (1, 0), 9), line((1, 0), (1, 0), 9), line((3, 0.2), (-1, 0), 9))
    order = lane_order(mixed)
    # The first two have one of each direction beside them; the third has two against itself.
    assert sorted(set(np.round(order, 6))) == [0.0, 1.0]


def test_lanes_are_made_by_people_who_walk_and_are_not_wider_than_they():
    beside = frames(line((0, 0), (1, 0), 9), line((1, 0.8), (1, 0), 9))
    assert len(lane_order(beside)) == 0
    standing = frames(line((0, 0), (1, 0), 9), line((3, 0.2), (-0.1, 0), 9))
    assert len(lane_order(standing)) == 0


def test_who_gets_less_than_a_metre_makes_no_detour():
    loop = np.vstack([line((0, 0), (1, 0), 16), line((3, 0.2), (0, 1), 20)])
    back = np.vstack([loop, loop[::-1][:-2]])
    assert len(detour(frames(back))) == 0


def test_a_way_around_a_corner_is_longer_than_the_straight_line():
    there = np.vstack([line((0, 0), (1, 0), 16), line((3, 0.2), (0, 1), 20)])
    assert detour(frames(there)) == pytest.approx((3 + 0.2 + 3.8) / np.hypot(3, 4), rel=1e-9)


def test_acceleration_of_a_circle_is_the_square_of_the_speed_by_its_radius():
    angle = 0.05 * np.arange(200)
    circle = 4 * np.column_stack([np.cos(angle), np.sin(angle)])
    speed = 4 * 0.05 / PERIOD
    assert acceleration(frames(circle)) == pytest.approx(speed**2 / 4, rel=0.01)


@pytest.mark.parametrize("name", MEASURES)
def test_nobody_and_one_alone_have_no_values_of_others(name):
    measure, _ = MEASURES[name]
    assert len(measure(Frames(np.full((12, 2, 2), np.nan), PERIOD))) == 0
