"""Reward terms against values worked out by hand from the paper's formulas."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crowdbench import Scenario
from crowdbench.simulation.kinematics import DIFFERENTIAL, make_drive
from crowdbench.simulation.lanes import world_of
from crowdbench.simulation.reward import collision_term, goal_term, social_term

SCENARIO = Scenario(name="weights")
WEIGHTS = world_of(SCENARIO, make_drive(SCENARIO), DIFFERENTIAL)


def social(pose, speed, position, velocity):
    return social_term(
        np.array(pose[:2], float),
        np.array([np.cos(pose[2]), np.sin(pose[2])]),
        speed,
        1.0,
        np.array(position, float).reshape(-1, 2),
        np.array(velocity, float).reshape(-1, 2),
        1.2,
        2.0,
    )


def test_goal_term_is_the_bonus_or_the_weighted_progress():
    assert goal_term(WEIGHTS, True, 0.1) == 20.0
    assert goal_term(WEIGHTS, False, 0.1) == pytest.approx(0.9)
    assert goal_term(WEIGHTS, False, -0.2) == pytest.approx(-1.8)


@pytest.mark.parametrize(
    ("nearest", "expected"), [(2.0, 0.0), (1.25, 0.0), (0.625, -0.2), (0.25, -0.32)]
)
def test_collision_term_grows_linearly_below_the_proximity_range(nearest, expected):
    assert collision_term(WEIGHTS, False, nearest) == pytest.approx(expected)


def test_contact_gives_the_collision_penalty_alone():
    assert collision_term(WEIGHTS, True, 0.1) == -60.0


def test_cutting_in_is_punished_by_how_near_it_comes():
    # The robot at 1 m/s crosses at t = 0.5 s; the walker at 1 m/s is then at x = 0.5, the robot at
    # (1, 0). Relative position from the walker (1, 0.5), relative velocity (-1, -1): nearest
    # (1, 0.5) + 0.75 (-1, -1) = (0.25, -0.25), a distance of 0.3536.
    value = social([1.0, 0.5, -np.pi / 2], 1.0, [0, 0], [1, 0])
    assert value == pytest.approx(-(1 - np.hypot(0.25, 0.25) / 1.2))


def test_slowing_down_for_the_same_conflict_is_rewarded_as_much():
    fast = social([1.0, 0.5, -np.pi / 2], 1.0, [0, 0], [1, 0])
    # At 0.3 m/s the path is crossed after 1.67 s, when the walker is past.
    assert social([1.0, 0.5, -np.pi / 2], 0.3, [0, 0], [1, 0]) == pytest.approx(-fast)


@pytest.mark.parametrize(
    ("pose", "speed", "position", "velocity"),
    [
        ([1.0, 0.5, -np.pi / 2], 1.0, [0, 0], [0.05, 0]),  # nobody walks
        ([1.0, 0.5, np.pi / 2], 1.0, [0, 0], [1, 0]),  # driving away from the path
        ([-1.0, 0.5, -np.pi / 2], 1.0, [0, 0], [1, 0]),  # passing behind even at top speed
        ([9.0, 0.5, -np.pi / 2], 1.0, [0, 0], [1, 0]),  # far ahead
    ],
)
def test_no_interaction_no_reward(pose, speed, position, velocity):
    assert social(pose, speed, position, velocity) == 0.0


@given(
    angle=st.floats(-3, 3),
    speed=st.floats(0, 1),
    position=st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    velocity=st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
)
def test_social_term_is_bounded_and_knows_no_direction(angle, speed, position, velocity):
    here = social([0.5, -0.3, 0.4], speed, position, velocity)
    assert -1.0 <= here <= 1.0
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = [*(turn @ [0.5, -0.3]), 0.4 + angle]
    there = social(turned, speed, turn @ position, turn @ velocity)
    # Rounding can only decide on the boundary of the interaction, where d_min is ambiguous.
    assert there == pytest.approx(here, abs=1e-6) or 0.0 in (here, there)
    mirror = [0.5, 0.3, -0.4]
    flipped = social(mirror, speed, np.multiply(position, [1, -1]), np.multiply(velocity, [1, -1]))
    assert flipped == pytest.approx(here, abs=1e-9)
