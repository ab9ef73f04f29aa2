"""A copy of an environment goes on exactly as the original would; neither disturbs the other."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest
from map_scenarios import ROOMS

from crowdbench import MapGeometry, Scenario
from crowdbench.simulation.env import CrowdEnv

NOISY = Scenario(
    name="noisy", time_limit=8, lidar={"noise": 0.02, "dropout": 0.1},
    pedestrians={"count": 5, "goals": "multimodal", "speed": [0.7, 1.1]},
)  # fmt: skip
FLEET = NOISY.override({"robots.count": 3, "pedestrians.count": 3})
ON_MAP = FLEET.override(ROOMS)
STEERED = FLEET.override({"pedestrians.control": "agents"})
QUICK = NOISY.override({"robots.speed": [0, 5], "control_period": 1.0, "substeps": 1})

WAYS = [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))]


def actions_of(env, rng):
    """Random ones, some pedestrians walking by themselves."""
    chosen = {agent: rng.uniform([0, -1.5], [1, 1.5]) for agent in env.possible_agents}
    walking = rng.random(len(env.possible_agents)) < 0.5
    return {
        agent: action
        for (agent, action), walks in zip(chosen.items(), walking, strict=True)
        if agent in env.agents and not (walks and agent.startswith("pedestrian"))
    }


def same(one, other):
    """Equal to the last bit, whatever is nested in it."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return np.array_equal(one, other)


def go_on(env, seed=9):
    """All that happens until the episode ends, and at the start of the next."""
    rng, seen = np.random.default_rng(seed), [env.state()]
    while env.agents:
        seen += [env.step(actions_of(env, rng)), env.state()]
    return (*seen, env.reset(), env.state())


@pytest.mark.parametrize(
    "scenario",
    [NOISY, FLEET, STEERED, QUICK, ON_MAP],
    ids=["noisy", "fleet", "steered", "quick", "map"],
)
@pytest.mark.parametrize("way", WAYS, ids=["deepcopy", "pickle"])
@pytest.mark.parametrize("steps", [0, 12])
def test_a_copy_goes_on_identically(scenario, way, steps):
    env, rng = CrowdEnv(scenario), np.random.default_rng(1)
    env.reset(seed=4)
    for _ in range(steps):
        env.step(actions_of(env, rng))
    first = way(env)
    second = way(first)
    expected = go_on(env)
    assert same(go_on(first), expected)
    assert same(go_on(second), expected)


@pytest.mark.parametrize("way", WAYS, ids=["deepcopy", "pickle"])
def test_a_copy_after_some_robots_have_left_goes_on_identically(way):
    env, rng = CrowdEnv(FLEET, obstacle_map=MapGeometry(16, 6.0, 4.0)), np.random.default_rng(3)
    for seed in range(50):
        env.reset(seed=seed)
        while len(env.agents) == 3:
            env.step({agent: (1.0, rng.uniform(-0.5, 0.5)) for agent in env.agents})
        if env.agents:
            break
    assert 0 < len(env.agents) < 3
    other = way(env)
    assert other.agents == env.agents
    assert same(go_on(other), go_on(env))


def test_what_a_copy_does_leaves_the_original_alone():
    env = CrowdEnv(NOISY)
    env.reset(seed=2)
    env.step({"robot_0": (0.5, 0.1)})
    before, plan = env.state(), copy.deepcopy(env)
    for _ in range(5):
        plan.step({"robot_0": (1.0, 1.0)})
    assert same(env.state(), before)
    assert same(go_on(copy.deepcopy(env)), go_on(env))


@pytest.mark.parametrize("way", WAYS, ids=["deepcopy", "pickle"])
def test_an_environment_before_its_first_reset_can_be_copied(way):
    env = CrowdEnv(NOISY)
    other = way(env)
    with pytest.raises(RuntimeError, match="reset"):
        other.state()
    assert same(env.reset(seed=1), other.reset(seed=1))
    assert same(go_on(other), go_on(env))


def test_a_copy_of_a_finished_episode_is_finished_and_starts_the_same_next_one():
    env = CrowdEnv(NOISY)
    env.reset(seed=1)
    while env.agents:
        env.step({"robot_0": (1.0, 0.4)})
    other = copy.deepcopy(env)
    assert other.agents == []
    assert same(go_on(other), go_on(env))


def test_a_copy_samples_the_same_actions_and_draws_the_same_picture():
    env = CrowdEnv(NOISY, "rgb_array")
    env.reset(seed=1)
    env.render()
    env.action_space("robot_0").seed(5)
    other = copy.deepcopy(env)
    np.testing.assert_array_equal(other.render(), env.render())
    samples = [e.action_space("robot_0").sample() for e in (env, other)]
    np.testing.assert_array_equal(*samples)


def test_a_copy_has_no_window():
    pygame = pytest.importorskip("pygame")
    env = CrowdEnv(NOISY.override({"control_period": 0.01}), "human")
    env.reset(seed=1)
    other = copy.deepcopy(env)
    assert other.render_mode == "human"
    assert other._renderer is None
    other.close()
    assert pygame.display.get_init(), "the original's is still there"
    env.close()


@pytest.mark.parametrize("way", WAYS, ids=["deepcopy", "pickle"])
def test_the_gymnasium_environment_can_be_copied_with_its_wrappers(way):
    env = gymnasium.make("crowdbench:CrowdNav-v0", scenario=NOISY)
    env.reset(seed=3)
    for _ in range(4):
        env.step(np.array([0.6, 0.2], np.float32))
    other = way(env)
    for _ in range(10):
        action = env.action_space.sample()
        one, two = env.step(action), other.step(action)
        assert same(one, two)
        if one[2] or one[3]:
            break
    assert same(env.reset()[0], other.reset()[0])
