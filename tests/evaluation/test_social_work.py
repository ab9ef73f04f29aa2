from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, Point

from crowdbench.evaluation.social_work import (
    INTERACTION_STRENGTH,
    boundary_distance,
    social_force,
    social_work,
)
from crowdbench.simulation import social_force as walking

NOBODY = np.zeros((1, 0, 2))
NO_WALLS, NO_OBSTACLES = np.zeros((0, 4)), np.zeros((0, 3))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_force_is_that_of_the_walking_model_but_for_its_strength(seed):
    rng = np.random.default_rng(seed)
    position, velocity = rng.uniform(-1.5, 1.5, (2, 2)), rng.uniform(-1, 1, (2, 2))
    walked = np.empty((2, 2))
    walking.social_force_velocities(
        position, velocity, velocity, np.full(2, 1e9), np.full(2, 0.25),
        np.zeros((2, 0), dtype=bool), np.zeros((0, 2)), np.zeros((0, 2)), 0.25, 0.5,
        NO_OBSTACLES, NO_WALLS, 1.0, walked,
    )  # fmt: skip
    expected = (walked - velocity)[0] * INTERACTION_STRENGTH / walking.INTERACTION_STRENGTH
    force = social_force(position[1] - position[0], velocity[0] - velocity[1])
    assert force == pytest.approx(expected, abs=1e-9)
    back = social_force(position[0] - position[1], velocity[1] - velocity[0])
    assert back == pytest.approx(-force)


def test_nobody_is_pushed_by_who_stands_in_the_same_place():
    assert social_force(np.zeros(2), np.ones(2)).tolist() == [0.0, 0.0]
    assert social_force(np.array([1.0, 0.0]), np.array([-0.5, 0.0])).tolist() == [0.0, 0.0]


def test_forces_from_both_sides_leave_the_robot_but_not_the_people_at_ease():
    people = np.array([[[1.0, 0.0], [-1.0, 0.0]]])
    work = social_work(
        np.zeros((1, 2)), np.zeros((1, 2)), 0.25, people, np.zeros((1, 2, 2)), NO_WALLS,
        NO_OBSTACLES,
    )  # fmt: skip
    assert work == pytest.approx([2 * 2.1 * math.exp(-1 / 0.35)])


def test_the_nearest_boundary_pushes_the_robot():
    # 0.45 m from a wall with a radius of 0.25 m: 10 exp(-0.2 / 0.2). The obstacle is farther.
    work = social_work(
        np.zeros((1, 2)), np.zeros((1, 2)), 0.25, NOBODY, NOBODY,
        np.array([[-1.0, 0.45, 1.0, 0.45]]), np.array([[0.0, -1.0, 0.3]]),
    )  # fmt: skip
    assert work == pytest.approx([10 * math.exp(-1)])


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_boundary_distances_are_those_of_the_shapes(seed):
    rng = np.random.default_rng(seed)
    places, walls = rng.uniform(-3, 3, (4, 2)), rng.uniform(-3, 3, (2, 4))
    obstacles = np.column_stack([rng.uniform(-3, 3, (2, 2)), rng.uniform(0.1, 0.5, 2)])
    expected = [
        min(
            *(LineString([w[:2], w[2:]]).distance(Point(p)) for w in walls),
            *(Point(o[:2]).distance(Point(p)) - o[2] for o in obstacles),
        )
        for p in places
    ]
    assert boundary_distance(places, walls, obstacles) == pytest.approx(np.array(expected))
    assert np.isinf(boundary_distance(places, NO_WALLS, NO_OBSTACLES)).all()
