"""The parallel environment: its contract, its bad inputs, and that it is a function of its seed."""

import hashlib
import subprocess
import sys

import numpy as np
import pytest
from pettingzoo.utils import parallel_to_aec

import crowdbench
from crowdbench import Scenario, ScenarioError, parallel_env
from crowdbench.simulation.env import CrowdEnv

SMALL = Scenario(
    name="small",
    time_limit=6,
    pedestrians={"count": 6, "goals": "multimodal", "speed": [0.7, 1.1]},
    lidar={"noise": 0.01, "dropout": 0.05},
)


def trajectory_hash(seed, render_mode=None, scenario=SMALL):
    """Hash of all states, observations and rewards of an episode under fixed actions."""
    env = CrowdEnv(scenario, render_mode)
    digest = hashlib.sha256()
    actions = np.random.default_rng(seed).uniform([0, -1.5], [1, 1.5], (100, 2))

    def note(*parts):
        for part in parts:
            for _, value in sorted(part.items()):
                digest.update(np.ascontiguousarray(value).tobytes())

    observations, _ = env.reset(seed=seed)
    note(env.state(), observations["robot_0"])
    while env.agents:
        seen, rewards, *_ = env.step(dict.fromkeys(env.agents, actions[env._steps]))
        if render_mode:
            env.render()
        note(env.state(), seen["robot_0"], rewards)
    env.close()
    return digest.hexdigest()


def test_the_whole_trajectory_is_the_same_in_another_process_and_beside_others():
    seeds = [0, 1, 2, 3]
    alone = [trajectory_hash(seed) for seed in seeds]
    beside = [
        subprocess.Popen([sys.executable, __file__, str(seed)], stdout=subprocess.PIPE, text=True)
        for seed in seeds
    ]
    assert [process.communicate(timeout=120)[0].strip() for process in beside] == alone
    assert len(set(alone)) == len(seeds)


def test_the_trajectory_is_the_same_after_other_episodes_in_the_same_environment():
    env = CrowdEnv(SMALL)
    states = []
    for seed in (5, 6, 5):
        env.reset(seed=seed)
        for _ in range(10):
            env.step({"robot_0": (0.3, 0.2)})
        states.append(env.state())
    for key, value in states[0].items():
        np.testing.assert_array_equal(value, states[2][key])
    assert not np.array_equal(states[0]["pedestrian_position"], states[1]["pedestrian_position"])


def test_rendering_changes_nothing():
    assert trajectory_hash(7, "rgb_array") == trajectory_hash(7)


def test_reset_without_a_seed_continues_from_the_last_one():
    first, second = CrowdEnv(SMALL), CrowdEnv(SMALL)
    for env in (first, second):
        env.reset(seed=3)
        env.reset()
    np.testing.assert_array_equal(first.state()["robot_pose"], second.state()["robot_pose"])
    again = CrowdEnv(SMALL)
    again.reset(seed=3)
    assert not np.array_equal(first.state()["robot_pose"], again.state()["robot_pose"])


def test_observations_and_state_lie_in_their_spaces():
    env = parallel_env(SMALL, robots={"count": 2}, pedestrians={"control": "agents"})
    observations, _ = env.reset(seed=1)
    assert set(observations) == set(env.possible_agents) == set(env.agents)
    for _ in range(10):
        for agent, observation in observations.items():
            assert env.observation_space(agent).contains(observation), agent
        assert env.state_space.contains(env.state())
        observations, *_ = env.step(
            {agent: env.action_space(agent).sample() for agent in env.agents}
        )


def test_observations_are_what_the_state_says():
    env = CrowdEnv(SMALL.override({"lidar.noise": 0.0, "lidar.dropout": 0.0}))
    start = env.reset(seed=2)[0]["robot_0"]["pose"]
    np.testing.assert_array_equal(start, 0)
    initial = env.state()["robot_pose"][0]
    for _ in range(8):
        seen = env.step({"robot_0": (0.5, 0.4)})[0]["robot_0"]
    state = env.state()
    x, y, heading = state["robot_pose"][0]
    to_robot = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    np.testing.assert_allclose(
        seen["goal"], to_robot @ (state["robot_goal"][0] - [x, y]), rtol=1e-5
    )
    np.testing.assert_allclose(seen["velocity"], [0.5, 0.4], rtol=1e-6)
    c, s = np.cos(initial[2]), np.sin(initial[2])
    moved = np.array([[c, s], [-s, c]]) @ ([x, y] - initial[:2])
    np.testing.assert_allclose(seen["pose"], [*moved, heading - initial[2]], atol=1e-6)
    gaps = np.linalg.norm(state["pedestrian_position"] - [x, y], axis=1) - 0.25
    assert seen["lidar"].min() == pytest.approx(gaps.min(), abs=0.01)


def test_arrival_terminates_with_success_and_the_bonus():
    env = parallel_env(Scenario(name="free", pedestrians={"count": 0}))
    seen, infos = env.reset(seed=0)
    rewards = []
    while env.agents:
        x, y = seen["robot_0"]["goal"]
        seen, reward, ended, late, infos = env.step({"robot_0": (1.0, np.arctan2(y, x) / 0.2)})
        rewards.append(reward["robot_0"])
        assert reward["robot_0"] == pytest.approx(sum(infos["robot_0"]["reward_terms"].values()))
    assert ended["robot_0"] and not late["robot_0"]
    assert infos["robot_0"]["outcome"] == "success"
    assert rewards[-1] == pytest.approx(20.0)
    # Progress telescopes: 9 per metre from 8 m down to where the last step but one ended.
    assert 9 * (8 - 0.3 - 0.2) <= sum(rewards[:-1]) <= 9 * (8 - 0.3)


def test_the_time_limit_truncates():
    env = parallel_env(Scenario(name="free", pedestrians={"count": 0}, time_limit=1.0))
    env.reset(seed=0)
    flags = []
    while env.agents:
        _, _, ended, late, infos = env.step({"robot_0": (0.0, 0.0)})
        flags.append((ended["robot_0"], late["robot_0"], infos["robot_0"]["outcome"]))
    assert flags == [(False, False, "running")] * 4 + [(False, True, "timeout")]


def test_out_of_range_actions_are_clipped():
    free = Scenario(name="free", pedestrians={"count": 0})
    far, near = CrowdEnv(free), CrowdEnv(free)
    far.reset(seed=0), near.reset(seed=0)
    far.step({"robot_0": (7.0, -9.0)}), near.step({"robot_0": (1.0, -1.5)})
    np.testing.assert_array_equal(far.state()["robot_pose"], near.state()["robot_pose"])


@pytest.mark.parametrize(
    ("action", "complaint"),
    [
        ((np.nan, 0.0), "action of agent 'robot_0': expected finite"),
        ((0.0, np.inf), "action of agent 'robot_0': expected finite"),
        ((0.1, 0.2, 0.3), r"action of agent 'robot_0': expected shape \(2,\), got \(3,\)"),
        (0.5, r"action of agent 'robot_0': expected shape \(2,\), got \(\)"),
        ("left", "action of agent 'robot_0': 'left' is not numeric"),
        (("1", "2"), r"action of agent 'robot_0': \('1', '2'\) is not numeric"),
        (None, "action of agent 'robot_0': None is not numeric"),
    ],
)
def test_bad_actions_are_refused_by_name_and_change_nothing(action, complaint):
    env = CrowdEnv(SMALL)
    env.reset(seed=0)
    before = env.state()
    with pytest.raises(ValueError, match=complaint):
        env.step({"robot_0": action})
    np.testing.assert_array_equal(before["robot_pose"], env.state()["robot_pose"])


def test_missing_and_unknown_agents_are_named():
    env = CrowdEnv(SMALL)
    with pytest.raises(RuntimeError, match="reset"):
        env.step({"robot_0": (0, 0)})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="no action for agent 'robot_0'"):
        env.step({})
    with pytest.raises(ValueError, match="unknown agent 'robot_1'"):
        env.step({"robot_0": (0, 0), "robot_1": (0, 0)})


def test_an_unknown_render_mode_is_refused():
    with pytest.raises(ValueError, match="render_mode 'ansi'"):
        CrowdEnv(SMALL, "ansi")


def test_several_robots_see_each_other_and_leave_one_by_one():
    env = parallel_env(Scenario(name="fleet", pedestrians={"count": 0}, robots={"count": 3}))
    seen, _ = env.reset(seed=4)
    outcomes = {}
    assert min(observation["lidar"].min() for observation in seen.values()) < 6.0
    while env.agents:
        acting = list(env.agents)
        actions = {}
        for agent in acting:
            x, y = seen[agent]["goal"]
            actions[agent] = (0.9, np.arctan2(y, x))
        seen, _, ended, late, infos = env.step(actions)
        assert set(seen) == set(acting)
        outcomes |= {a: infos[a]["outcome"] for a in acting if ended[a] or late[a]}
    assert set(outcomes) == set(env.possible_agents)
    assert set(outcomes.values()) <= {"success", "collision", "timeout"}


def test_robots_that_touch_each_other_both_end():
    env = parallel_env(Scenario(name="two", pedestrians={"count": 0}, robots={"count": 2}))
    for seed in range(40):
        seen, _ = env.reset(seed=seed)
        while env.agents:
            acting = list(env.agents)
            goals = {agent: seen[agent]["goal"] for agent in acting}
            seen, _, _, _, infos = env.step(
                {agent: (1.0, 5 * np.arctan2(y, x)) for agent, (x, y) in goals.items()}
            )
            contacts = [infos[agent]["contact"] for agent in acting]
            if any(contacts):
                assert [contact.kind for contact in contacts] == ["robot", "robot"]
                assert [contact.index for contact in contacts] == [1, 0]
                assert not env.agents
                return
    pytest.fail("no two robots met in 40 episodes")


def test_steered_pedestrians_obey_and_the_others_walk_by_themselves():
    steered = SMALL.override({"pedestrians.control": "agents", "lidar.noise": 0.0})
    env, script = CrowdEnv(steered), CrowdEnv(SMALL.override({"lidar.noise": 0.0}))
    env.reset(seed=8), script.reset(seed=8)
    before = env.state()["pedestrian_position"]
    env.step({"robot_0": (0, 0), "pedestrian_2": (0.3, -0.4)})
    script.step({"robot_0": (0, 0)})
    after, free = env.state()["pedestrian_position"], script.state()["pedestrian_position"]
    np.testing.assert_allclose(after[2] - before[2], [0.06, -0.08], atol=1e-9)
    np.testing.assert_allclose(np.delete(after, 2, 0), np.delete(free, 2, 0), atol=1e-9)
    with pytest.raises(ValueError, match="pedestrian_1"):
        env.step({"robot_0": (0, 0), "pedestrian_1": (np.nan, 0)})


def test_pedestrians_observe_zeros_for_a_robot_that_has_left():
    env = parallel_env(SMALL, robots={"count": 2}, pedestrians={"control": "agents"})
    for seed in range(20):
        env.reset(seed=seed)
        while set(env.agents) >= {"robot_0", "robot_1"}:
            seen, *_ = env.step({"robot_0": (1.0, 0.2), "robot_1": (0.0, 0.0)})
        if "robot_1" in env.agents:
            break
    assert "robot_1" in env.agents
    state = env.state()
    for p in range(6):
        robots = seen[f"pedestrian_{p}"]["robots"]
        assert (robots[0] == 0.0).all()
        offset = state["robot_pose"][1, :2] - state["pedestrian_position"][p]
        np.testing.assert_allclose(robots[1, :2], offset, rtol=1e-5)


def test_a_steered_pedestrian_is_rewarded_for_its_way_and_not_fined_for_a_new_goal():
    steered = SMALL.override({"pedestrians.control": "agents", "time_limit": 20})
    env = CrowdEnv(steered)
    env.reset(seed=1)
    new_goals = 0
    while env.agents:
        before = env.state()
        _, rewards, *_ = env.step(dict.fromkeys([a for a in env.agents if "robot" in a], (0, 0)))
        after = env.state()
        new_goals += np.any(after["pedestrian_goal"] != before["pedestrian_goal"], axis=1).sum()
        for p in range(6):
            walked = after["pedestrian_position"][p] - before["pedestrian_position"][p]
            assert abs(rewards[f"pedestrian_{p}"]) <= np.linalg.norm(walked) + 1e-9
    assert new_goals > 3


def test_the_aec_view_plays_the_same_episode():
    env, aec = CrowdEnv(SMALL), parallel_to_aec(CrowdEnv(SMALL))
    env.reset(seed=1), aec.reset(seed=1)
    total, aec_total = 0.0, 0.0
    while env.agents:
        total += env.step({"robot_0": (0.5, 0.1)})[1]["robot_0"]
    for agent in aec.agent_iter():
        _, reward, ended, late, _ = aec.last()
        aec_total += reward
        aec.step(None if ended or late else np.array([0.5, 0.1], np.float32))
        assert agent == "robot_0"
    assert aec_total == pytest.approx(total)


def test_noise_and_dropout_touch_only_what_they_should():
    clean = CrowdEnv(SMALL.override({"lidar.noise": 0.0, "lidar.dropout": 0.0}))
    noisy = CrowdEnv(SMALL.override({"lidar.noise": 0.02, "lidar.dropout": 0.0}))
    dropped = CrowdEnv(SMALL.override({"lidar.noise": 0.0, "lidar.dropout": 0.3}))
    true, noise, lost = (
        np.concatenate([env.reset(seed=s)[0]["robot_0"]["lidar"] for s in range(60)])
        for env in (clean, noisy, dropped)
    )
    hit = true < 6.0
    assert (noise[~hit] == 6.0).all()
    assert np.std((noise - true)[hit & (true < 5.9)]) == pytest.approx(0.02, rel=0.1)
    assert set(np.unique(lost[hit] == true[hit])) == {False, True}
    assert (lost[hit & (lost != true)] == 6.0).all()
    assert np.mean(lost[hit] != true[hit]) == pytest.approx(0.3, abs=0.04)


def test_the_gymnasium_view_is_the_same_episode():
    env, view = CrowdEnv(SMALL), crowdbench.CrowdNavEnv(SMALL)
    env.reset(seed=9), view.reset(seed=9)
    over = False
    while not over:
        seen, reward, ended, late, _ = view.step(np.array([0.6, -0.1], np.float32))
        others, rewards, *_ = env.step({"robot_0": np.array([0.6, -0.1], np.float32)})
        assert reward == rewards["robot_0"]
        np.testing.assert_array_equal(seen["lidar"], others["robot_0"]["lidar"])
        over = ended or late
    assert not env.agents
    with pytest.raises(RuntimeError, match="reset"):
        view.step(np.zeros(2))


@pytest.mark.parametrize(
    "changes", [{"robots": {"count": 2}}, {"pedestrians": {"control": "agents"}}]
)
def test_the_gymnasium_view_needs_one_agent(changes):
    with pytest.raises(ScenarioError, match="Gymnasium view needs"):
        crowdbench.CrowdNavEnv(SMALL, **changes)


if __name__ == "__main__":
    print(trajectory_hash(int(sys.argv[1])))
