"""Exported policies act as the agents whose policies they are."""

import numpy as np
import pytest
import torch
from crowdbench_agents.latent_planner.world_model import FORMAT as WORLD_MODEL
from crowdbench_agents.latent_planner.world_model import WorldModel
from crowdbench_agents.learning.config import load_config
from crowdbench_agents.learning.weights import save_weights
from crowdbench_agents.sac.networks import FORMAT as SAC
from crowdbench_agents.sac.networks import SacActor

import crowdbench
from crowdbench.cli import main
from crowdbench.evaluation.rollout import run_episode

CONFIG = load_config().override({"perception.cells": 16, "model.latent": 32, "model.hidden": 24})
SCENARIO = crowdbench.load_scenario("unimodal_slow")
SLOW = SCENARIO.override({"robots": {"speed": [0.0, 0.5], "turn_rate": [-1.0, 0.5]}})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Weights of random networks with large outputs, trained on paper with a slow robot."""
    folder = tmp_path_factory.mktemp("weights")
    torch.manual_seed(0)
    actor, model = SacActor(16, CONFIG.model), WorldModel(CONFIG.model, 16)
    with torch.no_grad():
        actor.mean.weight *= 4
        model.policy_network[-1].weight *= 4
    training = {"robot": {"speed": [0.0, 0.5], "turn_rate": [-1.0, 0.5]}}
    for name, network, form in (("actor", actor, SAC), ("model", model, WORLD_MODEL)):
        path = folder / f"{name}.safetensors"
        save_weights(path, network.state_dict(), CONFIG, training, form)
    return folder


def make(text):
    return crowdbench.AgentSpec.parse(text).make()


def recorded(scenario, agent, seed=1_000_000):
    """Commands and observations of an episode."""
    seen = []

    class Watched(type(agent)):
        def act(self, observation):
            seen.append(observation)
            return super().act(observation)

    agent.__class__ = Watched
    return run_episode(scenario, [agent], seed)[0], seen


def exported(text, file):
    assert main(["export-onnx", text, str(file)]) == 0
    return make(f"onnx:{file}")


@pytest.mark.parametrize(
    "text",
    [
        "sac:weights={}/actor.safetensors",
        "latent_planner:use_mppi=false,weights={}/model.safetensors",
    ],
    ids=["sac", "latent_planner"],
)
def test_it_acts_as_the_original_and_warns_of_another_robot(folder, tmp_path, text):
    original = make(text.format(folder))
    policy = exported(text.format(folder), tmp_path / "policy.onnx")
    episode, seen = recorded(SLOW, original)
    policy.reset(crowdbench.RobotSpec.from_scenario(SLOW), 0)
    actions = np.array([policy.act(item) for item in seen])
    assert len(actions) > 20
    assert actions.std(axis=0).min() > 1e-3
    np.testing.assert_allclose(actions, episode.commands, rtol=0, atol=1e-5)
    assert policy.drives == ("differential",)
    with pytest.warns(UserWarning, match=r"speed 0 to 1 m/s \(in training 0 to 0.5 m/s\)"):
        policy.reset(crowdbench.RobotSpec.from_scenario(SCENARIO), 0)


def test_an_episode_of_a_shipped_policy_has_the_same_outcome(tmp_path):
    policy = exported("sac", tmp_path / "sac.onnx")
    assert b"site-packages" not in (tmp_path / "sac.onnx").read_bytes()
    expected, seen = recorded(SCENARIO, make("sac"))
    episode = run_episode(SCENARIO, [policy], 1_000_000)[0]
    assert (episode.outcome, expected.outcome) == ("success", "success")
    policy.reset(crowdbench.RobotSpec.from_scenario(SCENARIO), 0)
    actions = np.array([policy.act(item) for item in seen])
    np.testing.assert_allclose(actions, expected.commands, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("latent_planner", "a plan by MPPI is no network; with use_mppi=false the policy acts"),
        ("latent_planner:use_mppi=false,execute=2", "execute: should be 1 to be exported, got 2"),
        ("orca", "agent 'orca' has no method export_onnx: nothing to export"),
    ],
)
def test_what_is_no_network_is_not_exported(tmp_path, capsys, text, told):
    assert main(["export-onnx", text, str(tmp_path / "policy.onnx")]) == 2
    assert told in " ".join(capsys.readouterr().err.split())
    assert list(tmp_path.iterdir()) == []


def test_without_the_exporters_package_it_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["export-onnx", "sac", str(tmp_path / "policy.onnx")]) == 2
    assert "pip install 'crowdbench-nav[onnx]'" in capsys.readouterr().err


def test_a_file_that_cannot_be_written_is_named(tmp_path, capsys):
    (tmp_path / "file").touch()
    assert main(["export-onnx", "sac", str(tmp_path / "file/policy.onnx")]) == 2
    assert "file/policy.onnx: cannot be written (" in capsys.readouterr().err
