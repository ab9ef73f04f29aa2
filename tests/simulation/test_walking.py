"""Walking models: what they are given, what they may return, and who is left out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pages import unpack

from crowdbench import Scenario, ScenarioError
from crowdbench.extensions import WALKING_MODELS
from crowdbench.simulation.pedestrians import preferred_velocity
from crowdbench.simulation.walking import Crowd, WalkingModel, make_walking_model
from crowdbench.simulation.world import World

CROWD = Scenario(name="crowd", pedestrians={"count": 6}, robots={"count": 2})
MODELS = ["orca", "social_force", "straight"]


def random_crowd(seed, people=6, robots=2):
    rng = np.random.default_rng(seed)
    return Crowd(
        position=rng.uniform(-3, 3, (people, 2)),
        velocity=rng.uniform(-1, 1, (people, 2)),
        heading=rng.uniform(-3, 3, people),
        goal=rng.uniform(-5, 5, (people, 2)),
        preferred_speed=rng.uniform(0.5, 1.2, people),
        preferred_velocity=rng.uniform(-0.5, 0.5, (people, 2)),
        radius=rng.uniform(0.2, 0.3, people),
        present=np.ones(people, dtype=bool),
        sees_robot=rng.random((people, robots)) < 0.5,
        robot_position=rng.uniform(-3, 3, (robots, 2)),
        robot_velocity=rng.uniform(-1, 1, (robots, 2)),
        robot_radius=0.25,
        responsibility=0.5,
        obstacles=np.array([[0.5, 0.5, 0.3]]),
        walls=np.array([[-5.0, 4.0, 5.0, 4.0]]),
        period=0.2,
    )


class Witness(WalkingModel):
    """Remembers what it was given and stands still."""

    def reset(self, crowd, rng):
        self.start, self.draw, self.seen = crowd, rng.random(), []

    def velocities(self, crowd, time):
        self.seen.append((time, crowd))
        return np.zeros_like(crowd.position)


@pytest.fixture
def register(monkeypatch):
    """Add a walking model for one test, named ``test``."""

    def add(kind):
        monkeypatch.setitem(WALKING_MODELS._known, "test", kind)
        return CROWD.override({"pedestrians.model": "test"})

    return add


def test_a_model_gets_the_whole_crowd_at_every_step(register):
    world = World(register(Witness), 3)
    model = world.worlds.episode(0).model
    assert model.seen == []
    np.testing.assert_array_equal(model.start.position, world.layout.pedestrian_position)
    for _ in range(3):
        before = world.pose[:, :2].copy()
        world.step(np.array([[0.5, 0.3], [0.0, 0.0]]))
        np.testing.assert_array_equal(model.seen[-1][1].robot_position, before)
    times, crowds = zip(*model.seen, strict=True)
    np.testing.assert_allclose(times, [0.0, 0.2, 0.4])
    last = crowds[-1]
    assert last.present.all()
    assert last.sees_robot.shape == (6, 2)
    heading = world.pose[0, 2] - 0.3 * 0.2
    moving = 0.5 * np.array([np.cos(heading), np.sin(heading)])
    np.testing.assert_allclose(last.robot_velocity, [moving, [0.0, 0.0]], atol=1e-12)
    np.testing.assert_array_equal(world.pedestrians.velocity, np.zeros((6, 2)))


def test_a_models_draws_belong_to_the_seed_alone(register):
    draws = {}
    for seed in (1, 2, 1):
        other = register(Witness).override({"pedestrians.count": 6 - len(draws)})
        draws.setdefault(seed, set()).add(World(other, seed).worlds.episode(0).model.draw)
    assert [len(found) for found in draws.values()] == [1, 1]
    assert draws[1] != draws[2]


def test_only_reactive_pedestrians_see_robots_and_only_ahead_of_them(register):
    scenario = register(Witness).override(
        {"pedestrians.reactive": 0.5, "pedestrians.field_of_view": 90.0}
    )
    world = World(scenario, 0)
    world.step(np.zeros((2, 2)))
    _, crowd = world.worlds.episode(0).model.seen[0]
    ahead = np.stack([np.cos(crowd.heading), np.sin(crowd.heading)], axis=1)
    offset = crowd.robot_position[None] - crowd.position[:, None]
    angle = np.einsum("prk,pk->pr", offset, ahead) / np.linalg.norm(offset, axis=2)
    expected = (angle >= np.cos(np.deg2rad(45))) & world.pedestrians.reactive[:, None]
    np.testing.assert_array_equal(crowd.sees_robot, expected)
    assert 0 < crowd.sees_robot.sum() < crowd.sees_robot.size


@pytest.mark.parametrize("model", MODELS)
@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_who_is_absent_is_as_if_never_there(model, seed):
    """Against a crowd without those rows; the others' velocities are the same to the bit."""
    crowd = random_crowd(seed)
    crowd.present[[1, 4]] = False
    walks = make_walking_model(CROWD.override({"pedestrians.model": model}))
    found = walks.velocities(crowd, 0.0)
    assert found.shape == (6, 2)
    without = walks.velocities(crowd.only(crowd.present), 0.0)
    np.testing.assert_array_equal(found[crowd.present], without)


def test_preferred_velocities_are_straight_and_never_overshoot():
    assert preferred_velocity(0.02, 0.0, 1.0, 0.2) == pytest.approx((0.1, 0.0), abs=1e-12)
    assert preferred_velocity(0.0, 0.0, 1.0, 0.2) == (0.0, 0.0)
    assert preferred_velocity(3.0, -4.0, 1.0, 0.2) == pytest.approx((0.6, -0.8))


class TooFew(Witness):
    def velocities(self, crowd, time):
        return np.zeros((2, 2))


class Undefined(Witness):
    def velocities(self, crowd, time):
        return np.full_like(crowd.position, np.nan)


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        (TooFew, r"model 'test': expected finite velocities of shape \(6, 2\), got shape \(2, 2\)"),
        (Undefined, r"velocities of shape \(6, 2\), got numbers that are not finite"),
    ],
)
def test_a_model_that_cannot_be_used_is_refused_with_the_reason(register, kind, told):
    with pytest.raises(ScenarioError, match=told):
        World(register(kind), 0).step(np.zeros((2, 2)))


def test_a_model_of_another_package_is_found_by_its_name(tmp_path, monkeypatch):
    """The one of docs/add_a_walking_model.md: who sees a robot within 1.5 m stands still."""
    list(unpack("docs/add_a_walking_model.md", tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(WALKING_MODELS, "_points", None)
    monkeypatch.setattr(WALKING_MODELS, "_known", dict(WALKING_MODELS._known))
    assert {*MODELS, "polite"} < set(WALKING_MODELS)
    scenario = CROWD.override({"pedestrians.model": "polite", "robots.count": 1})
    stood = 0
    for seed in range(5):
        world = World(scenario.override({"pedestrians.field_of_view": 360.0}), seed)
        for _ in range(30):
            people = world.pedestrians
            near = np.linalg.norm(people.position - world.pose[0, :2], axis=1) < 1.5
            world.step(np.array([[0.5, 0.0]]))
            chosen = np.linalg.norm(people.chosen, axis=1)
            np.testing.assert_array_equal(chosen == 0.0, near)
            stood += near.sum()
    assert stood > 10
