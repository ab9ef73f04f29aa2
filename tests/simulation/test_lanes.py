"""Lanes whose drive or walking model comes from elsewhere, beside compiled ones."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from crowdbench import Scenario, vector_env
from crowdbench.extensions import DRIVES, WALKING_MODELS
from crowdbench.simulation.kinematics import Differential, Omnidirectional
from crowdbench.simulation.walking import Orca, SocialForce, Straight

SCENE = Scenario(
    name="scene", time_limit=6, obstacles={"count": 2},
    pedestrians={"count": 4, "goals": "multimodal", "reactive": 0.5, "speed": [0.5, 1.0]},
)  # fmt: skip


@pytest.fixture
def foreign(monkeypatch):
    """Every drive and model once more, as a subclass: nothing of it runs compiled."""
    for registry, kinds in (
        (DRIVES, {"differential": Differential, "omnidirectional": Omnidirectional}),
        (WALKING_MODELS, {"orca": Orca, "social_force": SocialForce, "straight": Straight}),
    ):
        for name, kind in kinds.items():
            monkeypatch.setitem(registry._known, f"my_{name}", type("Mine", (kind,), {}))


@settings(
    deadline=None, max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    seed=st.integers(0, 10**6),
    drive=st.sampled_from(["differential", "omnidirectional"]),
    model=st.sampled_from(["orca", "social_force", "straight"]),
    acceleration=st.sampled_from([None, [1.0, 2.0]]),
)
def test_what_runs_in_python_does_the_same_to_the_last_bit(
    foreign, seed, drive, model, acceleration
):
    limits = {"robots.drive": drive, "robots.acceleration": acceleration}
    compiled = SCENE.override(limits | {"pedestrians.model": model})
    walking = compiled.override({"pedestrians.model": f"my_{model}"})
    env = vector_env([compiled, walking], 2, autoreset_mode="Disabled")
    driving = vector_env(compiled.override({"robots.drive": f"my_{drive}"}), 1)
    both = {"scenario": np.array([0, 1])}
    env.reset(seed=[seed, seed], options=both), driving.reset(seed=seed)
    low, high = env.single_action_space.low, env.single_action_space.high
    for action in np.random.default_rng(seed).uniform(low, high, (20, 2)):
        _, rewards, ended, *_ = env.step(np.tile(action, (2, 1)))
        _, alone, *_ = driving.step(action[None])
        assert rewards[0] == rewards[1] == alone[0]
        for key, value in env.state(0).items():
            np.testing.assert_array_equal(value, env.state(1)[key], err_msg=key)
            np.testing.assert_array_equal(value, driving.state(0)[key], err_msg=key)
        if ended.any():
            break
