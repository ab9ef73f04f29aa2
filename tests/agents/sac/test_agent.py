"""SAC as an agent."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from crowdbench_agents.latent_planner.world_model import FORMAT as WORLD_MODEL
from crowdbench_agents.latent_planner.world_model import WorldModel
from crowdbench_agents.learning.config import load_config
from crowdbench_agents.learning.inputs import Inputs
from crowdbench_agents.learning.weights import WeightsError, file_digest, save_weights
from crowdbench_agents.sac.agent import Sac
from crowdbench_agents.sac.networks import FORMAT, SacActor

import crowdbench

CONFIG = load_config().override({"perception.cells": 16, "model.latent": 32, "model.hidden": 24})
ROBOT = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario("multimodal_fast"))


@pytest.fixture
def actor():
    torch.manual_seed(0)
    model = CONFIG.model
    return SacActor(16, model).eval().requires_grad_(False)


@pytest.fixture
def weights(actor, tmp_path):
    path = tmp_path / "actor.safetensors"
    save_weights(path, actor.state_dict(), CONFIG, {}, FORMAT)
    return str(path)


def observation(rng):
    return crowdbench.Observation(
        lidar=rng.uniform(0.5, 6.0, 180).astype(np.float32),
        velocity=rng.uniform([0, -1.5], [1, 1.5]).astype(np.float32),
        goal=rng.uniform(-4, 4, 2).astype(np.float32),
        pose=rng.uniform(-1, 1, 3).astype(np.float32),
    )


def test_actions_are_the_actors_for_the_stacked_map(actor, weights):
    agent = Sac(weights=weights)
    assert agent.weights_sha256 == file_digest(Path(weights))
    agent.reset(ROBOT, 0)
    maps = crowdbench.ObstacleMap(ROBOT, CONFIG.perception.geometry)
    rng = np.random.default_rng(0)
    actions = []
    for _ in range(3):
        seen = observation(rng)
        arrays = (maps.update(seen.lidar, seen.pose), seen.velocity, seen.goal)
        raw = actor(Inputs(*(torch.from_numpy(array[None]) for array in arrays)))[0].numpy()
        actions.append(agent.act(seen))
        # v in [0, 1] m/s, w in [-1.5, 1.5] rad/s
        np.testing.assert_allclose(actions[-1], [(raw[0] + 1) / 2, raw[1] * 1.5], atol=1e-6)
    assert np.std(actions, axis=0).min() > 1e-4


def test_the_episode_starts_anew_at_a_reset(weights):
    agent = Sac(weights=weights)
    rng = np.random.default_rng(0)
    seen = [observation(rng) for _ in range(3)]
    runs = []
    for seed in (0, 1):
        agent.reset(ROBOT, seed)
        runs.append([agent.act(item) for item in seen])
    assert np.array_equal(*runs)


def test_weights_of_another_agent_are_refused(tmp_path):
    path = tmp_path / "w.safetensors"
    model = WorldModel(CONFIG.model, 16)
    save_weights(path, model.state_dict(), CONFIG, {}, WORLD_MODEL)
    with pytest.raises(WeightsError, match="'crowdbench-world-model-1', expected 'crowdbench-sac"):
        Sac(weights=str(path))


def test_missing_weights_say_how_to_make_them():
    with pytest.raises(ValueError, match=r"no weights 'other'.*`crowdbench train sac`"):
        crowdbench.AgentSpec.parse("sac:weights=other").make()


def test_neither_acting_nor_training_needs_stable_baselines(weights):
    code = f"""
import sys
sys.modules["stable_baselines3"] = None  # importing it fails
import numpy as np, crowdbench, crowdbench_agents.sac.training
agent = crowdbench.AgentSpec.parse("sac:weights={weights}").make()
robot = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario("multimodal_fast"))
agent.reset(robot, 0)
zeros = np.zeros(2, np.float32)
seen = crowdbench.Observation(np.full(180, 3, np.float32), zeros, zeros, np.zeros(3, np.float32))
assert np.isfinite(agent.act(seen)).all()
"""
    subprocess.run([sys.executable, "-c", code], check=True)
