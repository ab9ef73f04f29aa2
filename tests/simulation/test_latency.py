"""Commands that act some control periods after they were given."""

import copy

import numpy as np
import pytest

import crowdbench
from crowdbench.evaluation.resimulate import resimulate
from crowdbench.evaluation.rollout import run_episode

REAL = {
    "robots": {
        "latency": 2,
        "acceleration": (1.0, 3.0),
        "odometry": {"rotation": 0.01, "translation": 0.01},
    },
    "lidar": {"noise": 0.02, "mount": (0.1, 0.05, 0.3)},
}
"""A robot with every shortcoming."""


def commands(steps, robots=1):
    return np.random.default_rng(4).uniform([0.0, -1.5], [1.0, 1.5], (steps, robots, 2))


def drive(env, asked):
    """(T, R, 2) commands; the states after each."""
    states = []
    for row in asked:
        env.step({name: row[int(name.removeprefix("robot_"))] for name in env.agents})
        states.append(env.state())
    return states


def test_a_command_acts_after_the_latency():
    env = crowdbench.parallel_env(
        "multimodal_fast", pedestrians={"count": 0}, robots={"latency": 2}
    )
    env.reset(seed=0)
    for expected, under_way in [(0.0, [0, 1]), (0.0, [1, 1]), (1.0, [1, 1])]:
        seen, *_ = env.step({"robot_0": (1.0, 0.0)})
        assert seen["robot_0"]["velocity"][0] == expected
        assert env.state()["robot_under_way"][0, :, 0].tolist() == under_way
    np.testing.assert_allclose(seen["robot_0"]["pose"], [0.2, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("acceleration", [None, (1.0, 3.0)])
def test_latency_is_the_same_as_standing_first(acceleration):
    changes = {"robots.count": 2, "robots.acceleration": acceleration}
    late = crowdbench.parallel_env("multimodal_fast", **changes, **{"robots.latency": 3})
    prompt = crowdbench.parallel_env("multimodal_fast", **changes)
    late.reset(seed=5)
    prompt.reset(seed=5)
    asked = commands(12, robots=2)
    standing = np.concatenate([np.zeros((3, 2, 2)), asked[:-3]])
    for one, other in zip(drive(late, asked), drive(prompt, standing), strict=True):
        for key in set(one) - {"robot_under_way"}:
            np.testing.assert_array_equal(one[key], other[key])


def test_lanes_do_what_the_single_environment_does():
    lanes = crowdbench.vector_env("multimodal_fast", num_envs=2, **REAL)
    singles = [crowdbench.parallel_env("multimodal_fast", **REAL) for _ in range(2)]
    seen, _ = lanes.reset(seed=[8, 10])
    alone = [env.reset(seed=seed)[0] for env, seed in zip(singles, (8, 10), strict=True)]
    for row in commands(10, robots=2):
        for lane in range(2):
            for key, value in alone[lane]["robot_0"].items():
                np.testing.assert_array_equal(seen[key][lane], value)
        seen, *_ = lanes.step(row)
        alone = [env.step({"robot_0": a})[0] for env, a in zip(singles, row, strict=True)]
    np.testing.assert_array_equal(
        lanes.state(1)["robot_under_way"], singles[1].state()["robot_under_way"]
    )


def test_a_lane_foresees_by_its_own_control_period():
    geometry, asked = crowdbench.MapGeometry(), commands(5)
    short, long = (
        crowdbench.load_scenario("multimodal_fast", control_period=period, robots={"latency": 2})
        for period in (0.2, 0.5)
    )
    lanes = crowdbench.vector_env([short, long], 2, obstacle_map=geometry)
    single = crowdbench.parallel_env(long, obstacle_map=geometry)
    lanes.reset(seed=[1, 1], options={"scenario": np.array([0, 1])})
    single.reset(seed=1)
    for row in asked:
        seen, *_ = lanes.step(np.concatenate([row, row]))
        alone, *_ = single.step({"robot_0": row[0]})
        np.testing.assert_array_equal(seen["map"][1], alone["robot_0"]["map"])


def test_nothing_is_under_way_when_an_episode_begins():
    env = crowdbench.parallel_env("multimodal_fast", **REAL)
    env.reset(seed=1)
    drive(env, commands(4))
    env.reset(seed=1)
    assert not env.state()["robot_under_way"].any()


def test_a_copy_goes_on_as_the_original():
    env = crowdbench.parallel_env("multimodal_fast", **REAL)
    env.reset(seed=2)
    drive(env, commands(4))
    twin = copy.deepcopy(env)
    for row in commands(6):
        one, other = (e.step({"robot_0": row[0]})[0]["robot_0"] for e in (env, twin))
        for key in one:
            np.testing.assert_array_equal(one[key], other[key])


def test_an_episode_is_simulated_again_from_what_was_asked_for():
    scenario = crowdbench.load_scenario("multimodal_fast", **REAL)
    (first,) = run_episode(scenario, "straight_line", seed=3)
    (again,) = resimulate(scenario, 3, [first.commands], label="again")
    np.testing.assert_array_equal(first.robot_pose, again.robot_pose)
    np.testing.assert_array_equal(first.actions, again.actions)
    assert first.outcome == again.outcome
