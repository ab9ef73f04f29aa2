"""Lanes of several robots against CrowdEnv, robots that leave, bad input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from map_scenarios import ROOMS

from crowdbench import CrowdEnv, MapGeometry, Scenario, parallel_vector_env

FLEET = Scenario(
    name="fleet", time_limit=6, robots={"count": 3, "travel": 5},
    arena={"length": 8, "width": 8}, pedestrians={"count": 3, "speed": [0.7, 1.1]},
)  # fmt: skip
QUIET = FLEET.override({"pedestrians.count": 0, "lidar.noise": 0.02, "time_limit": 4})
ON_MAP = FLEET.override(ROOMS)
MAP = MapGeometry(16, 6.0, 4.0)


@settings(deadline=None, max_examples=5)
@given(seed=st.integers(0, 10**6), lanes=st.integers(1, 4))
def test_every_lane_is_the_single_environment_to_the_last_bit(seed, lanes):
    env = parallel_vector_env([FLEET, QUIET, ON_MAP], lanes, obstacle_map=MAP)
    seen, infos = env.reset(seed=seed)
    singles = [CrowdEnv(env.scenarios[k], obstacle_map=MAP) for k in infos["robot_0"]["scenario"]]
    for lane, single in enumerate(singles):
        same_lane(seen, lane, single.reset(seed=seed + lane)[0])
    rng = np.random.default_rng(seed)
    for _ in range(30):
        actions = {
            name: rng.uniform([0, -1.5], [1, 1.5], (lanes, 2)) for name in env.possible_agents
        }
        before = [list(single.agents) for single in singles]
        seen, rewards, ended, late, infos = env.step(actions)
        for lane, single in enumerate(singles):
            told = {name: actions[name][lane] for name in single.agents}
            if not told:  # this lane has begun again
                single.scenario = env.scenarios[infos["robot_0"]["scenario"][lane]]
                singles[lane] = CrowdEnv(single.scenario, obstacle_map=MAP)
                expected = singles[lane].reset(seed=int(infos["robot_0"]["seed"][lane]))[0]
                same_lane(seen, lane, expected)
                continue
            expected, single_rewards, single_ended, single_late, single_infos = single.step(told)
            same_lane(seen, lane, expected)
            for name in env.possible_agents:
                here = name in before[lane]
                assert infos[name]["acted"][lane] == here
                assert rewards[name][lane] == (single_rewards[name] if here else 0.0)
                assert ended[name][lane] == (here and single_ended[name])
                assert late[name][lane] == (here and single_late[name])
                outcome = single_infos[name]["outcome"] if here else None
                assert infos[name]["outcome"][lane] == outcome
                assert infos[name]["contact"][lane] == (
                    single_infos[name]["contact"] if here else None
                )
            state, other = env.state(lane), single.state()
            for key, value in state.items():
                np.testing.assert_array_equal(value, other[key], err_msg=key)


def same_lane(seen, lane, expected):
    for name, parts in expected.items():
        for key, value in parts.items():
            np.testing.assert_array_equal(seen[name][key][lane], value, err_msg=f"{name} {key}")


def test_robots_leave_one_by_one_and_may_then_be_told_anything():
    env = parallel_vector_env(FLEET, 8)
    env.reset(seed=3)
    left = np.zeros((8, 3), dtype=bool)
    for _ in range(25):
        actions = {name: np.full((8, 2), [1.0, 0.0]) for name in env.possible_agents}
        for r, name in enumerate(env.possible_agents):
            actions[name][left[:, r]] = np.nan
        _, _, ended, _, infos = env.step(actions)
        for r, name in enumerate(env.possible_agents):
            assert not (infos[name]["acted"] & left[:, r]).any()
            left[:, r] |= ended[name]
        if left.all(axis=1).any():
            break
    assert left.any() and (left.sum(axis=1) < 3).any()


def test_bad_actions_name_robot_and_lane():
    env = parallel_vector_env(FLEET, 2)
    actions = {name: np.zeros((2, 2)) for name in env.possible_agents}
    with pytest.raises(RuntimeError, match="reset"):
        env.step(actions)
    env.reset(seed=0)
    bad = np.zeros((2, 2))
    bad[1, 1] = np.nan
    with pytest.raises(ValueError, match="agent 'robot_2' in lane 1: expected finite"):
        env.step(actions | {"robot_2": bad})
    with pytest.raises(ValueError, match=r"agent 'robot_1': expected shape \(2, 2\), got \(3, 2\)"):
        env.step(actions | {"robot_1": np.zeros((3, 2))})
    with pytest.raises(ValueError, match="no actions for agent 'robot_0'"):
        env.step({})
    with pytest.raises(ValueError, match="unknown agent 'robot_9'"):
        env.step(actions | {"robot_9": bad})


def test_nothing_goes_on_once_it_is_closed():
    env = parallel_vector_env(FLEET, 2)
    env.reset(seed=0)
    env.close()
    env.close()
    with pytest.raises(RuntimeError, match="the environment is closed"):
        env.step({name: np.zeros((2, 2)) for name in env.possible_agents})
    with pytest.raises(RuntimeError, match="the environment is closed"):
        env.reset(seed=0)
