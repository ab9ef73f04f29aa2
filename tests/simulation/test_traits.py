"""What people are like: against scipy, whoever drives and however many there are."""

import numpy as np
import pytest
from bodies import footprint
from hypothesis import given, settings
from hypothesis import strategies as st
from map_scenarios import hall
from scipy.stats import truncnorm
from shapely.geometry import Point

from crowdbench import Scenario, ScenarioError
from crowdbench.simulation.lanes import PROPRIOCEPTION
from crowdbench.simulation.layout import place
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
    np.testing.assert_allclose(found, expected, atol=1e-7)
    assert ((found >= 0.5) & (found <= 1.5)).all()


def test_without_a_mean_speeds_are_uniform_within_the_bounds():
    found = preferred_speeds(CROWD.pedestrians, np.array([0.0, 0.25, 0.5]))
    np.testing.assert_allclose(found, [0.5, 0.75, 1.0])


def test_radii_are_within_their_bounds_and_a_persons_own():
    some, more = (
        CROWD.override({"pedestrians": {"radius": [0.2, 0.3], "count": n}}) for n in (5, 9)
    )
    radii = np.array([place(more, seed).traits.radius for seed in range(200)])
    np.testing.assert_array_equal(radii[7, :5], place(some, 7).traits.radius)
    assert ((radii >= 0.2) & (radii <= 0.3)).all()
    np.testing.assert_allclose(np.quantile(radii, [0.1, 0.5, 0.9]), [0.21, 0.25, 0.29], atol=0.005)


@pytest.mark.parametrize("groups", [0.0, 0.6])
def test_nobody_in_a_stream_stands(groups):
    streams = [{"start": "west", "goal": "east", "share": share} for share in (0.3, 0.2)]
    scenario = hall(
        pedestrians={"count": 10, "streams": streams, "standing": 0.3, "groups": {"share": groups}}
    )
    for seed in range(900_000, 900_020):
        world = World(scenario, seed)
        stands, in_stream = world.layout.traits.standing, world.stream >= 0
        # Who walks in a group goes with its first one.
        assert stands.sum() == 3 and in_stream.sum() in ([5, 6] if groups else [5])
        assert not stands[in_stream].any() and not stands[world.pedestrians.group >= 0].any()


def test_two_equal_bounds_are_one_radius():
    both = [World(CROWD.override({"pedestrians.radius": r}), 4) for r in (0.2, [0.2, 0.2])]
    for world in both:
        for _ in range(20):
            world.step(np.zeros((1, 2)))
    for first, second in zip(*(world.pedestrians for world in both), strict=True):
        np.testing.assert_array_equal(first, second)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_lidar_contacts_and_people_know_everybodys_own_size(seed):
    """Against shapely: at the start nobody overlaps, and a contact is where discs meet."""
    wide = {"radius": [0.1, 0.45], "reactive": 0.0, "spawn_clearance": 0.0, "speed": [1.0, 1.5]}
    scenario = CROWD.override({"pedestrians": wide, "control_period": 0.05, "substeps": 1})
    world = World(scenario, seed)
    radius, touched = world.pedestrians.radius, None
    assert np.ptp(radius) > 0.1
    gaps = np.linalg.norm(world.pedestrians.position[:, None] - world.pedestrians.position, axis=2)
    free = gaps - radius - radius[:, None]
    assert free[np.triu_indices(8, 1)].min() > 0
    for _ in range(150):
        world.step(np.array([[1.0, 0.2]]))
        world.observe()
        people = [
            Point(p).buffer(r, quad_segs=100)
            for p, r in zip(world.pedestrians.position, radius, strict=True)
        ]
        centre = Point(world.pose[0, :2])
        nearest = min(6.0, *(centre.distance(person) for person in people))
        least = world.seen[0, PROPRIOCEPTION:].min()
        assert least > nearest - 1e-3
        if nearest < 2:  # farther away a person may be between two beams
            assert least < nearest + 0.03
        if world.contacts:
            touched = world.contacts[0]
            assert footprint(world.pose[0]).distance(people[touched.index]) < 2e-3
            break
        assert all(footprint(world.pose[0]).intersection(person).area < 1e-4 for person in people)


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
        ({"radius": [0.3, 0.2]}, r"radius: the lower bound 0\.3 exceeds the upper 0\.2"),
        ({"radius": [0.2, 3]}, r"radius: 3 is out of range; allowed: >= 0\.001 and <= 2"),
        ({"radius": [0.2]}, "radius: expected a number .* or two numbers, lowest then highest"),
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
