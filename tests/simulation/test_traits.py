"""What people are like: against scipy, whoever drives and however many there are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import truncnorm

from crowdbench import Scenario, ScenarioError
from crowdbench.simulation.traits import preferred_speeds
from crowdbench.simulation.world import World

CROWD = Scenario(name="crowd", pedestrians={"count": 8, "speed": [0.5, 1.5]})


@given(
    mean=st.floats(0.5, 1.5), deviation=st.floats(0.05, 2.0),
    draws=st.lists(st.floats(0, 1, exclude_max=True), min_size=1, max_size=9),
)  # fmt: skip
@settings(deadline=None, max_examples=60)
def test_speeds_are_quantiles_of_the_normal_distribution_within_the_bounds(mean, deviation, draws):
    normal = {"pedestrians.speed_mean": mean, "pedestrians.speed_deviation": deviation}
    found = preferred_speeds(CROWD.override(normal).pedestrians, np.array(draws))
    ends = (0.5 - mean) / deviation, (1.5 - mean) / deviation
    expected = truncnorm.ppf(draws, *ends, loc=mean, scale=deviation)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert ((found >= 0.5) & (found <= 1.5)).all()


def test_without_a_mean_speeds_are_uniform_within_the_bounds():
    found = preferred_speeds(CROWD.pedestrians, np.array([0.0, 0.25, 0.5]))
    np.testing.assert_allclose(found, [0.5, 0.75, 1.0])


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            {"speed_mean": 1.6, "speed_deviation": 0.2},
            r"speed_mean: 1\.6 m/s .* >= 0\.5 and <= 1\.5",
        ),
        ({"speed_mean": 1.0}, "speed_mean: given without speed_deviation"),
        ({"speed_deviation": 1.0}, "speed_deviation: given without speed_mean"),
        (
            {"speed_mean": 1.0, "speed_deviation": 0},
            r"speed_deviation: 0 .* allowed: a number >= 0",
        ),
        ({"acceleration": 0}, "acceleration: 0 is out of range; allowed: a number >= 0.001"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_the_field(changes, told):
    with pytest.raises(ScenarioError, match=rf"pedestrians\.{told}"):
        CROWD.override({"pedestrians": changes})


@pytest.mark.parametrize("model", ["orca", "social_force", "straight"])
def test_nobody_changes_velocity_faster_than_the_limit(model):
    """By the scenario's own goals, the models and the shoving of bodies aside."""
    world = World(CROWD.override({"pedestrians": {"model": model, "acceleration": 0.8}}), 3)
    hardest = 0.0
    for _ in range(60):
        before = world.pedestrians.velocity.copy()
        world.step(np.zeros((1, 2)))
        change = np.linalg.norm(world.pedestrians.chosen - before, axis=1)
        hardest = max(hardest, change.max())
    assert hardest == pytest.approx(0.8 * 0.2)


def test_a_limit_that_nobody_reaches_changes_nothing():
    limited = World(CROWD.override({"pedestrians.acceleration": 100}), 5)
    free = World(CROWD, 5)
    for _ in range(40):
        limited.step(np.zeros((1, 2))), free.step(np.zeros((1, 2)))
    np.testing.assert_array_equal(limited.pedestrians.position, free.pedestrians.position)


def test_a_steered_pedestrian_cannot_do_more_either():
    world = World(CROWD.override({"pedestrians.acceleration": 1.0}), 0)
    before = world.pedestrians.velocity[2].copy()
    world.step(np.zeros((1, 2)), {2: before + [2.0, 0.0]})
    np.testing.assert_allclose(world.pedestrians.chosen[2], before + [0.2, 0.0])
