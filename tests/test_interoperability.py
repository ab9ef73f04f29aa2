"""The environments pass the checks of the libraries they are written for, and train with them."""

import importlib

import gymnasium
import numpy as np
import pettingzoo
import pytest
import supersuit
import torch
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env as check_gymnasium
from pages import unpack
from pettingzoo.test import (
    api_test,
    parallel_api_test,
    parallel_seed_test,
    render_test,
    seed_test,
)
from pettingzoo.utils import parallel_to_aec
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_sb3
from stable_baselines3.common.vec_env import DummyVecEnv
from torchrl.envs.libs.pettingzoo import PettingZooWrapper
from torchrl.envs.utils import check_env_specs

import crowdbench

SMALL = {
    "one robot": {"scenario": "multimodal_fast", "time_limit": 6.0},
    "three robots": {"scenario": "corridor_dense", "robots.count": 3, "time_limit": 6.0},
    "people as agents": {
        "scenario": "unimodal_slow_nonreactive",
        "pedestrians": {"control": "agents", "count": 3},
        "robots.count": 2,
        "time_limit": 6.0,
    },
}


@pytest.fixture(params=SMALL.values(), ids=SMALL.keys())
def arguments(request):
    return request.param


def make_aec(**arguments):
    return parallel_to_aec(crowdbench.parallel_env(**arguments))


def test_pettingzoo_parallel_api(arguments):
    parallel_api_test(crowdbench.parallel_env(**arguments), num_cycles=200)


def test_pettingzoo_aec_api(arguments):
    api_test(make_aec(**arguments), num_cycles=200)


def test_pettingzoo_seeding(arguments):
    parallel_seed_test(lambda: crowdbench.parallel_env(**arguments), num_cycles=50)
    seed_test(lambda: make_aec(**arguments), num_cycles=50)


def test_pettingzoo_rendering(arguments):
    render_test(lambda render_mode=None: make_aec(render_mode=render_mode, **arguments))


def test_pettingzoo_knows_the_environment_by_name():
    environment = pettingzoo.make("parallel", "crowdbench/crowd-v0", scenario="corridor_sparse")
    assert environment.unwrapped.scenario.name == "corridor_sparse"


def make_gymnasium(**arguments):
    return gymnasium.make("crowdbench:CrowdNav-v0", scenario="multimodal_fast", **arguments)


def test_gymnasium_check():
    check_gymnasium(make_gymnasium(render_mode="rgb_array").unwrapped)


def test_stable_baselines3_check():
    check_sb3(make_gymnasium(time_limit=4.0))


def test_the_gymnasium_view_is_the_parallel_environment():
    view = make_gymnasium()
    crowd = crowdbench.parallel_env("multimodal_fast")
    seen, _ = view.reset(seed=5)
    expected, _ = crowd.reset(seed=5)
    rng = np.random.default_rng(0)
    while crowd.agents:
        for key, value in expected["robot_0"].items():
            np.testing.assert_array_equal(seen[key], value)
        action = rng.uniform([0.0, -1.5], [1.0, 1.5]).astype(np.float32)
        seen, reward, terminated, truncated, info = view.step(action)
        expected, rewards, terminations, truncations, infos = crowd.step({"robot_0": action})
        assert (reward, terminated, truncated, info["outcome"]) == (
            rewards["robot_0"],
            terminations["robot_0"],
            truncations["robot_0"],
            infos["robot_0"]["outcome"],
        )
    assert terminated or truncated


def test_stable_baselines3_trains():
    model = PPO(
        "MultiInputPolicy",
        make_gymnasium(),
        n_steps=500,
        batch_size=250,
        n_epochs=2,
        policy_kwargs={"net_arch": [32]},
        seed=1_000_000,
        device="cpu",
    )
    before = model.policy.parameters_to_vector()
    model.learn(total_timesteps=2_000)
    assert model.num_timesteps == 2_000
    assert np.isfinite(model.policy.parameters_to_vector()).all()
    assert not np.array_equal(model.policy.parameters_to_vector(), before)


@pytest.mark.parametrize("robots", [1, 3])
def test_torchrl_wraps_the_parallel_environment(robots):
    environment = PettingZooWrapper(
        crowdbench.parallel_env("multimodal_fast", **{"robots.count": robots}),
        use_mask=True,
        seed=1_000_000,
        device="cpu",
    )
    check_env_specs(environment)
    rollout = environment.rollout(30, break_when_any_done=False)
    assert rollout["robot", "observation", "lidar"].shape == (30, robots, 180)
    assert rollout["next", "robot", "reward"].shape == (30, robots, 1)
    assert rollout["next", "robot", "reward"].isfinite().all()


def test_torchrl_keeps_robots_that_have_left_done_until_the_last_has():
    """As docs/train_with_your_library.md wraps it."""
    environment = PettingZooWrapper(
        crowdbench.parallel_env("multimodal_fast", time_limit=12.0, **{"robots.count": 3}),
        use_mask=True,
        done_on_any=False,
        seed=1_000_003,
        device="cpu",
    )

    def policy(data):
        data["robot", "action"] = torch.tensor([[1.0, 0.0], [0.3, 0.0], [0.0, 0.0]])
        return data

    rollout = environment.rollout(100, policy)
    there, ended = rollout["robot", "mask"], rollout["next", "robot", "done"][..., 0]
    assert not there.all(), "some robot leaves before the last one"
    for robot in range(3):
        steps = int(there[:, robot].sum())
        assert there[:steps, robot].all()
        assert ended[:, robot].tolist() == [False] * (steps - 1) + [True] * (len(ended) - steps + 1)
        assert (rollout["next", "robot", "reward"][steps:, robot] == 0).all()
        assert (rollout["next", "robot", "observation", "lidar"][steps:, robot] == 0).all()
    assert rollout["next", "done"][:, 0].tolist() == [False] * (len(ended) - 1) + [True]


def test_stable_baselines3_sees_a_vector_of_environments_as_its_own(tmp_path, monkeypatch):
    """The class on docs/stable_baselines3.md hands over what DummyVecEnv does."""
    list(unpack("docs/stable_baselines3.md", tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    vectors = importlib.import_module("vectors")
    both = [
        vectors.Vectors(
            crowdbench.vector_env(
                "multimodal_fast", num_envs=3, autoreset_mode="SameStep", time_limit=4.0
            )
        ),
        DummyVecEnv([lambda: make_gymnasium(time_limit=4.0)] * 3),
    ]
    for environment in both:
        environment.seed(1_000_000)
    rng, ends = np.random.default_rng(0), set()
    for key, (ours, theirs) in in_pairs(*(environment.reset() for environment in both)):
        np.testing.assert_array_equal(ours, theirs, err_msg=key)
    for _ in range(60):
        actions = rng.uniform([0.5, -0.3], [1.0, 0.3], (3, 2)).astype(np.float32)
        (seen, rewards, done, told), (*expected, infos) = (one.step(actions) for one in both)
        np.testing.assert_array_equal(rewards, expected[1])
        np.testing.assert_array_equal(done, expected[2])
        pairs = [*in_pairs(seen, expected[0])]
        for i in np.flatnonzero(done):
            assert told[i]["TimeLimit.truncated"] == infos[i]["TimeLimit.truncated"]
            pairs += in_pairs(told[i]["terminal_observation"], infos[i]["terminal_observation"])
            ends.add(told[i]["TimeLimit.truncated"])
        for key, (ours, theirs) in pairs:
            np.testing.assert_array_equal(ours, theirs, err_msg=key)
    assert ends == {False, True}


def in_pairs(ours, theirs):
    """The parts of two observations, side by side."""
    assert ours.keys() == theirs.keys()
    return [(key, (ours[key], theirs[key])) for key in ours]


def flat_and_staying(environment):
    """As docs/stable_baselines3.md does it."""
    environment = supersuit.observation_lambda_v0(
        environment, lambda seen, space: spaces.flatten(space, seen), spaces.flatten_space
    )
    return supersuit.black_death_v3(environment)


def test_supersuit_flattens_observations_and_keeps_those_who_have_left():
    arguments = {"time_limit": 12.0, "robots.count": 3}
    crowd = crowdbench.parallel_env("multimodal_fast", **arguments)
    wrapped = flat_and_staying(crowdbench.parallel_env("multimodal_fast", **arguments))
    expected, _ = crowd.reset(seed=1_000_003)
    seen, _ = wrapped.reset(seed=1_000_003)
    away = 0
    while crowd.agents:
        for agent in crowd.possible_agents:
            space = crowd.observation_space(agent)
            flat = spaces.flatten(space, expected[agent]) if agent in expected else np.zeros(187)
            np.testing.assert_array_equal(seen[agent], flat)
        speeds = zip(crowd.possible_agents, (1.0, 0.3, 0.0), strict=True)
        actions = {agent: np.array([speed, 0.0], np.float32) for agent, speed in speeds}
        expected, rewards, *_ = crowd.step({agent: actions[agent] for agent in crowd.agents})
        seen, found, *_ = wrapped.step(actions)
        assert found == dict.fromkeys(crowd.possible_agents, 0.0) | rewards
        away += len(crowd.possible_agents) - len(crowd.agents)
    assert away > 3, "some robot leaves before the last one"
    *_, terminations, truncations, _ = wrapped.step(actions)
    assert all(terminations.values())
    assert all(truncations.values())
    assert not wrapped.agents


def test_supersuit_pads_the_observations_of_robots_and_people():
    environment = supersuit.observation_lambda_v0(
        crowdbench.parallel_env(**SMALL["people as agents"]),
        lambda seen, space: spaces.flatten(space, seen),
        spaces.flatten_space,
    )
    padded = supersuit.pad_observations_v0(environment)
    seen, _ = padded.reset(seed=1_000_000)
    assert {value.shape for value in seen.values()} == {(187,)}


def test_stable_baselines3_trains_through_supersuit():
    environment = flat_and_staying(
        crowdbench.parallel_env("multimodal_fast", time_limit=6.0, **{"robots.count": 3})
    )
    vector = supersuit.pettingzoo_env_to_vec_env_v1(environment)
    both = supersuit.concat_vec_envs_v1(vector, 2, num_cpus=1, base_class="stable_baselines3")
    assert both.num_envs == 6
    model = PPO("MlpPolicy", both, n_steps=64, batch_size=64, n_epochs=1, device="cpu")
    model.learn(total_timesteps=600)
    assert np.isfinite(model.policy.parameters_to_vector()).all()
