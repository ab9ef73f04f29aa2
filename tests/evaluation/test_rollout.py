from __future__ import annotations

import dataclasses
import time
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import crowdbench
from crowdbench.evaluation.rollout import run_episode, warm_up
from crowdbench.simulation import streams

TINY = crowdbench.load_scenario(
    "multimodal_fast",
    time_limit=3,
    arena={"length": 6, "width": 6},
    robots={"travel": 4},
    pedestrians={"count": 2, "leg": 2},
)
THREE = TINY.override({"robots.count": 3, "pedestrians.count": 0, "time_limit": 6})


class Drives(crowdbench.Agent):
    """Drives in an arc and remembers what it is told."""

    def __init__(self, action=(0.5, 0.3)):
        self.action = action
        self.told = []

    def reset(self, robot, seed):
        self.robot, self.seed, self.observations = robot, seed, []

    def act(self, observation):
        self.observations.append(observation)
        return self.action

    def diagnostics(self):
        return {"steps": len(self.observations)}


class Fails(Drives):
    """Does something wrong at one step, or before the first."""

    def __init__(self, how, at):
        super().__init__()
        self.how, self.at = how, at

    def reset(self, robot, seed):
        super().reset(robot, seed)
        if self.at < 0:
            self.how()

    def act(self, observation):
        action = super().act(observation)
        return self.how() if len(self.observations) == self.at + 1 else action


class DrivesSideways(Drives):
    drives = ("omnidirectional",)


def raise_error():
    raise RuntimeError("out of\nideas")


def exit_program():
    raise SystemExit(3)


def same(one, other):
    for field in dataclasses.fields(one):
        if field.name not in ("inference_s", "processor_share"):
            np.testing.assert_equal(getattr(one, field.name), getattr(other, field.name))


def test_the_log_is_what_the_environment_did():
    (episode,) = run_episode(TINY, [Drives()], seed=3)
    env = crowdbench.parallel_env(TINY)
    env.reset(seed=3)
    states = [env.state()]
    for action in episode.actions:
        _, _, _, _, infos = env.step({"robot_0": action})
        states.append(env.state())
    assert infos["robot_0"]["outcome"] == episode.outcome != "running"
    assert infos["robot_0"]["contact"] == episode.contact
    assert episode.steps == len(states) - 1
    for t, state in enumerate(states):
        np.testing.assert_array_equal(episode.robot_pose[t], state["robot_pose"][0])
        for key in ("position", "velocity", "goal", "intent", "switch_time"):
            logged = getattr(episode, f"pedestrian_{key}")
            np.testing.assert_array_equal(logged[t], state[f"pedestrian_{key}"])
    np.testing.assert_array_equal(episode.goal, states[0]["robot_goal"][0])
    assert episode.diagnostics == {"steps": episode.steps}
    assert (episode.scenario, episode.agent, episode.seed) == ("multimodal_fast", "Drives", 3)


def test_an_agent_is_found_by_name_and_gives_the_same_episode_again():
    env = crowdbench.parallel_env(TINY)
    (first,) = run_episode(env, "straight_line", seed=5)
    run_episode(env, "straight_line", seed=6)
    (again,) = run_episode(env, crowdbench.AgentSpec("straight_line", {}), seed=5)
    same(first, again)
    assert first.agent == "straight_line"


def test_an_agents_seed_comes_from_the_episodes_and_differs_by_robot():
    agents = [Drives(), Drives(), Drives()]
    run_episode(THREE, agents, seed=4)
    assert [agent.seed for agent in agents] == [streams.agent_seed(4, r) for r in range(3)]
    assert len({agent.seed for agent in agents}) == 3
    assert [agent.robot.name for agent in agents] == ["robot_0", "robot_1", "robot_2"]


def test_only_a_privileged_agent_sees_the_state():
    agent = Drives()
    run_episode(TINY, [agent], seed=0)
    assert all(observation.state is None for observation in agent.observations)

    class Knows(Drives):
        privileged = True

        def act(self, observation):
            action = super().act(observation)
            observation.state["pedestrian_position"] += 100.0
            return action

    knowing = Knows()
    (episode,) = run_episode(TINY, [knowing], seed=0)
    first = knowing.observations[0].state["pedestrian_position"] - 100.0
    np.testing.assert_allclose(first, episode.pedestrian_position[0])
    same(episode, dataclasses.replace(run_episode(TINY, [agent], seed=0)[0], agent="Knows"))


@pytest.mark.parametrize(
    ("how", "told"),
    [
        (raise_error, "RuntimeError: out of ideas ("),
        (exit_program, "SystemExit: 3 ("),
        (lambda: (float("nan"), 0.0), "act returned [nan, 0.0], expected finite numbers"),
        (lambda: (0.0, float("inf")), "act returned [0.0, inf], expected finite numbers"),
        (
            lambda: (0.0, 0.0, 0.0),
            "act returned shape (3,), expected (2,), e.g. v [m/s], w [rad/s]",
        ),
        (lambda: 1.0, "act returned shape (), expected (2,)"),
        (
            lambda: ("fast", "left"),
            "act returned ('fast', 'left'), expected two numbers, e.g. v [m/s], w [rad/s]",
        ),
        (lambda: (10**400, 0), "act returned (a number of 1329 bits, 0), expected two numbers"),
        (lambda: (1j, 0.0), "act returned (1j, 0.0), expected two numbers"),
        (lambda: ([0.0], [0.0, 1.0]), "act returned ([0.0], [0.0, 1.0]), expected two numbers"),
        (lambda: None, "act returned None, expected two numbers"),
        (lambda: ("1", "2"), "act returned ('1', '2'), expected two numbers"),
        (lambda: (1.0, b"2"), "act returned (1.0, b'2'), expected two numbers"),
        (lambda: np.array(["1", "2"]), "act returned array(['1', '2']"),
        (lambda: np.array(["1", 2.0], dtype=object), "act returned array(['1', 2.0]"),
        (lambda: np.array([1.0 + 1.0j, 0.0]), "act returned array([1.+1.j"),
        (lambda: np.array([1, 2], dtype="m8[s]"), "act returned array([1, 2]"),
    ],
)
@pytest.mark.parametrize("at", [0, 2])
def test_an_agent_that_fails_ends_its_episode_there(how, told, at):
    (episode,) = run_episode(TINY, [Fails(how, at)], seed=0)
    assert episode.outcome == "agent_error"
    assert told in episode.error
    assert episode.steps == at
    assert len(episode.inference_s) == at
    assert len(episode.robot_pose) == at + 1


@pytest.mark.parametrize(
    "action",
    [
        (True, 0),
        np.array([True, False]),
        np.array([Fraction(1), 0], dtype=object),
        np.array([1, 0], dtype=np.uint8),
        np.array([1, 0], dtype=np.float16),
    ],
)
def test_whatever_holds_numbers_is_an_action_truth_values_included(action):
    (episode,) = run_episode(TINY, [Drives(action)], seed=0)
    assert episode.error is None
    assert (episode.commands == [1.0, 0.0]).all()


def test_the_message_says_where_the_agent_raised():
    (episode,) = run_episode(TINY, [Fails(raise_error, at=1)], seed=0)
    line = raise_error.__code__.co_firstlineno + 1
    assert episode.error.endswith(f"({Path(__file__)}:{line})")


def test_an_agent_that_cannot_be_reset_ends_its_episode_at_once():
    (episode,) = run_episode(TINY, [Fails(raise_error, at=-1)], seed=0)
    assert (episode.outcome, episode.steps) == ("agent_error", 0)


def test_counters_that_cannot_be_read_do_not_change_the_outcome():
    class Miscounts(Drives):
        def diagnostics(self):
            return {"fails": "many"}

    (episode,) = run_episode(TINY, [Miscounts()], seed=3)
    (usual,) = run_episode(TINY, [Drives()], seed=3)
    assert episode.outcome == usual.outcome
    assert episode.diagnostics == {}
    assert episode.error.startswith("diagnostics: ValueError: could not convert string")


def test_time_is_taken_around_act_alone():
    class Dawdles(Drives):
        def reset(self, robot, seed):
            super().reset(robot, seed)
            time.sleep(0.2)

        def act(self, observation):
            time.sleep(0.002)
            return super().act(observation)

    (episode,) = run_episode(TINY, [Dawdles()], seed=0)
    assert len(episode.inference_s) == episode.steps > 0
    assert (episode.inference_s >= 0.002).all()
    assert episode.inference_s.min() < 0.2


def test_actions_are_logged_as_executed():
    (episode,) = run_episode(TINY, [Drives((5.0, -9.0))], seed=0)
    np.testing.assert_array_equal(episode.actions, np.tile([1.0, -1.5], (episode.steps, 1)))
    limited = TINY.override({"robots.acceleration": [1.0, 1.0]})
    (episode,) = run_episode(limited, [Drives((1.0, 0.0))], seed=0)
    np.testing.assert_allclose(episode.actions[:3, 0], [0.2, 0.4, 0.6])


def test_one_robot_that_fails_does_not_stop_the_others():
    agents = [Drives((1.0, 0.0)), Fails(raise_error, at=2), Drives((1.0, 0.0))]
    episodes = run_episode(THREE, agents, seed=1)
    assert [episode.robot for episode in episodes] == ["robot_0", "robot_1", "robot_2"]
    assert episodes[1].outcome == "agent_error"
    assert episodes[1].steps == 2
    for episode in (episodes[0], episodes[2]):
        assert episode.outcome != "agent_error"
        assert episode.steps > 2
        assert episode.other_robots.shape == (episode.steps + 1, 2, 3)
        stands = episode.other_robots[2:, {0: 0, 2: 1}[int(episode.robot[-1])]]
        np.testing.assert_array_equal(stands, np.tile(stands[0], (len(stands), 1)))


def test_a_robot_that_is_gone_is_logged_as_gone_from_the_next_state_on():
    arrives = crowdbench.AgentSpec("straight_line", {}).make()
    episodes = run_episode(THREE, [arrives, Drives((0.0, 0.0)), Drives((0.0, 0.0))], seed=1)
    first = min(episodes, key=lambda episode: episode.steps)
    last = max(episodes, key=lambda episode: episode.steps)
    assert first.steps < last.steps
    others = [r for r in range(3) if r != int(last.robot[-1])]
    seen = last.other_robots[:, others.index(int(first.robot[-1]))]
    np.testing.assert_array_equal(seen[: first.steps + 1], first.robot_pose)
    assert np.isnan(seen[first.steps + 1 :]).all()


def test_agents_and_robots_have_to_be_equally_many():
    with pytest.raises(ValueError, match="3 robots need as many agents, got 1"):
        run_episode(THREE, [Drives()], seed=0)


def test_every_state_is_shown_once():
    times = []
    (episode,) = run_episode(
        TINY, [Drives()], seed=0, on_step=lambda env: times.append(float(env.state()["time"]))
    )
    np.testing.assert_allclose(times, np.arange(episode.steps + 1) * TINY.control_period)


def test_the_watcher_knows_which_call_runs():
    calls = []
    (episode,) = run_episode(TINY, [Drives()], seed=0, on_call=calls.append)
    running = [-1, *range(episode.steps), episode.steps]
    assert calls == [call for step in running for call in (step, None)]


def test_warming_up_leaves_no_trace_and_hides_no_failure():
    env = crowdbench.parallel_env(TINY)
    (before,) = run_episode(env, [Drives()], seed=2)
    agent = Drives()
    warm_up(env, [agent], env.reset(seed=9)[0])
    assert len(agent.observations) == 1
    same(run_episode(env, [agent], seed=2)[0], before)
    warm_up(env, [Fails(exit_program, at=0)], env.reset(seed=9)[0])


def test_an_agent_that_hands_over_one_array_again_and_again_is_logged_as_it_drove():
    class Reuses(Drives):
        command = np.zeros(2)

        def act(self, observation):
            self.command += 0.01
            return self.command

    (episode,) = run_episode(TINY, [Reuses()], seed=0)
    steps = np.arange(1, episode.steps + 1)[:, None]
    np.testing.assert_allclose(episode.commands, np.repeat(0.01 * steps, 2, axis=1))


def test_an_episode_says_where_the_robot_goes_whatever_its_drive():
    """Against its positions: an omnidirectional robot moves straight within a control period."""
    world = TINY.override({"robots.drive": "omnidirectional", "pedestrians.reactive": 0.5})
    (episode,) = run_episode(world, [DrivesSideways((0.1, -0.4))], seed=3)
    assert episode.steps > 3
    moved = np.diff(episode.robot_pose[:, :2], axis=0) / 0.2
    np.testing.assert_allclose(episode.robot_world_velocity[1:], moved, atol=1e-9)
    np.testing.assert_allclose(episode.robot_speed[1:], np.hypot(0.1, 0.4))
    np.testing.assert_array_equal(episode.robot_world_velocity[0], [0.0, 0.0])
    np.testing.assert_array_equal(episode.actions, np.tile([0.1, -0.4], (episode.steps, 1)))
    env = crowdbench.parallel_env(world)
    env.reset(seed=3)
    reactive = env.state()["pedestrian_reactive"]
    assert reactive.sum() == 1
    np.testing.assert_array_equal(episode.pedestrian_reactive, reactive)


def test_an_agent_is_not_let_near_robots_that_drive_otherwise():
    agent = Drives()
    with pytest.raises(crowdbench.AgentError) as caught:
        run_episode(TINY.override({"robots.drive": "omnidirectional"}), [agent], seed=0)
    assert str(caught.value) == (
        "agent 'Drives' drives differential robots only, and those of scenario "
        "'multimodal_fast' are omnidirectional (robots.drive)"
    )
    assert not hasattr(agent, "robot")
    with pytest.raises(crowdbench.AgentError, match="drives omnidirectional robots only"):
        run_episode(TINY, [DrivesSideways()], seed=0)


def test_an_agent_is_not_let_among_people_whom_it_does_not_support():
    agent = Drives()
    agent.unsupported_models = ("straight", "orca")
    with pytest.raises(crowdbench.AgentError) as caught:
        run_episode(TINY, [agent], seed=0)
    assert str(caught.value) == (
        "agent 'Drives' cannot drive among the people of scenario 'multimodal_fast', whose "
        "pedestrians.model is 'orca'; allowed: any but straight, orca"
    )
    assert not hasattr(agent, "robot")
    (episode,) = run_episode(TINY.override({"pedestrians.model": "social_force"}), [agent], seed=0)
    assert episode.error is None
