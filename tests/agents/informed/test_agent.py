"""The informed agent: its foresight is what then happens, and it wins because of it."""

from dataclasses import replace

import numpy as np
import pytest
from crowdbench_agents.informed.actions import lines
from crowdbench_agents.informed.agent import Informed
from crowdbench_agents.informed.distance_field import DistanceField, look_up
from crowdbench_agents.informed.search import HORIZON, TICKS
from foreseen import STAND, episodes, ways_left

import crowdbench

NO_WALLS = np.empty((0, 4))


def act(agent, env, observations):
    seen = observations["robot_0"]
    return agent.act(crowdbench.Observation(**seen, state=env.state()))


def drive(scenario, seed, **overrides):
    env = crowdbench.parallel_env(scenario, **overrides)
    observations, infos = env.reset(seed=seed)
    agent = Informed()
    agent.reset(env.robot_spec(), seed)
    actions = []
    while env.agents:
        actions.append(act(agent, env, observations))
        observations, *_, infos = env.step({"robot_0": actions[-1]})
    return infos["robot_0"]["outcome"], np.array(actions)


@pytest.mark.parametrize(
    ("scenario", "radius"),
    [
        ("multimodal_fast_nonreactive", 0.25),
        ("corridor_very_dense", 0.25),
        ("unimodal_fast_nonreactive", 0.4),
    ],
)
def test_people_walk_as_predicted(scenario, radius):
    """Those who keep their leg; the robot is out of sight of all."""
    env = crowdbench.parallel_env(scenario, pedestrians={"reactive": 0, "radius": radius})
    agent, compared = Informed(), 0
    for before, after in episodes(env, agent, range(900_000, 900_006), [STAND] * 5, STAND, 8):
        future, _ = agent._predict(before, False)
        assert (future[0, : env.scenario.pedestrians.count, 2] == radius).all()
        for step, state in after:
            left = ways_left(state)
            if left.min() < 0.6:  # somebody gets a new leg, to which the others react too
                break
            predicted = future[step * TICKS, : len(left), :2]
            np.testing.assert_allclose(predicted, state["pedestrian_position"], atol=1e-3)
            compared += len(left)
    assert compared > 100


def test_switches_are_foreseen():
    """Somebody who will turn back is predicted to turn back, at the right time."""
    env = crowdbench.parallel_env("multimodal_fast_nonreactive", pedestrians={"count": 1})
    agent = Informed()
    for seed in range(900_000, 900_100):
        env.reset(seed=seed)
        state = env.state()
        if 0.5 < state["pedestrian_switch_time"][0] < 2.0:
            break
    agent.reset(env.robot_spec(), seed)
    future, _ = agent._predict(state, False)
    for step in range(1, 16):
        env.step({"robot_0": (0.0, 0.0)})
        if not env.agents:
            break
        now = env.state()["pedestrian_position"][0]
        np.testing.assert_allclose(future[step * TICKS, 0, :2], now, atol=1e-3)
    assert step == 15


@pytest.mark.parametrize("scenario", crowdbench.scenario_names("paper"))
def test_it_wins(scenario):
    for seed in (900_500, 900_501):
        outcome, actions = drive(scenario, seed)
        assert outcome == "success"
        assert len(actions) < 120


@pytest.mark.parametrize(
    ("scenario", "seed"),
    [
        ("hard_open_dense", 900_008),  # somebody evades it
        ("hard_plaza_groups", 900_015),  # a group turns
        ("situation_blind_corner", 900_002),  # a quick search finds no way out
    ],
)
def test_it_wins_where_robots_cannot_stop_at_once(scenario, seed):
    outcome, _ = drive(scenario, seed)
    assert outcome == "success"


@pytest.mark.parametrize("scenario", ["multimodal_fast_nonreactive", "corridor_very_dense"])
def test_it_wins_with_an_omnidirectional_robot(scenario):
    for seed in (900_500, 900_501):
        outcome, actions = drive(scenario, seed, robots={"drive": "omnidirectional"})
        assert outcome == "success"
        assert len(actions) < 120


@pytest.mark.parametrize(
    "limits", [((0.0, 1.0), (-1.0, 1.0)), ((-0.2, 0.8), (-0.5, 0.3)), ((-1.0, 1.0), (-1.0, 1.0))]
)
def test_lines_keep_to_both_limits_and_reach_them(limits):
    chosen = lines(*limits)
    low, high = np.array(limits).T
    assert ((chosen >= low - 1e-12) & (chosen <= high + 1e-12)).all()
    np.testing.assert_allclose(chosen.max(axis=0), high)
    np.testing.assert_allclose(chosen.min(axis=0), low, atol=1e-12)
    assert (chosen == 0.0).all(axis=1).any()


def test_with_nobody_there_it_goes_straight_at_full_speed():
    outcome, actions = drive("unimodal_slow", 900_000, pedestrians={"count": 0})
    assert outcome == "success"
    # 7.7 m at 0.2 m a step; the start faces up to 30 degrees away from the goal.
    assert len(actions) <= 41


def test_the_same_state_gives_the_same_drive():
    first, second = (drive("multimodal_fast", 900_007)[1] for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_acceleration_limits_are_planned_with():
    env = crowdbench.parallel_env("unimodal_fast", robots={"acceleration": (0.5, 1.0)})
    observations, _ = env.reset(seed=900_000)
    agent = Informed()
    agent.reset(env.robot_spec(), 0)
    for _ in range(10):
        before = observations["robot_0"]["velocity"]
        action = act(agent, env, observations)
        assert np.all(np.abs(action - before) <= np.array([0.5, 1.0]) * 0.2 + 1e-6)
        observations, *_ = env.step({"robot_0": action})
    assert len(agent._plan) < HORIZON


def test_without_the_state_it_says_what_it_needs():
    agent = Informed()
    agent.reset(crowdbench.RobotSpec.from_scenario(crowdbench.Scenario(name="x")), 0)
    blind = crowdbench.Observation(*(np.zeros(n, np.float32) for n in (180, 2, 2, 3)))
    with pytest.raises(ValueError, match="true state"):
        agent.act(blind)


def test_other_robots_are_avoided():
    env = crowdbench.parallel_env("unimodal_slow", robots={"count": 2}, pedestrians={"count": 0})
    for seed in range(900_000, 900_005):
        observations, infos = env.reset(seed=seed)
        agents = {}
        for name in env.agents:
            agents[name] = Informed()
            agents[name].reset(replace(env.robot_spec(name)), seed)
        outcomes = {}
        while env.agents:
            state = env.state()
            actions = {
                name: agents[name].act(crowdbench.Observation(**observations[name], state=state))
                for name in env.agents
            }
            observations, *_, infos = env.step(actions)
            outcomes |= {name: info["outcome"] for name, info in infos.items()}
        assert set(outcomes.values()) == {"success"}


def test_the_way_around_an_obstacle_has_the_length_of_tangents_and_arc():
    """Start and goal 2 m from a disc of 1 m: 2 sqrt(3) + pi / 3; a polygon is longer."""
    field = DistanceField(
        np.array([2.0, 0.0]), np.array([-2.0, 0.0]), np.array([[0.0, 0.0, 0.9]]), NO_WALLS, 0.1
    )
    length = look_up(-2.0, 0.0, 2.0, 0.0, field.origin, field.values)
    exact = 2 * np.sqrt(3) + np.pi / 3
    assert exact - 0.02 <= length <= 1.03 * exact


def test_the_way_does_not_lead_through_a_wall():
    """The disc leaves room on one side only."""
    walls = np.array([[-5.0, 1.0, 5.0, 1.0]])
    field = DistanceField(
        np.array([2.0, 0.6]), np.array([-2.0, 0.6]), np.array([[0.0, 0.6, 0.5]]), walls, 0.2
    )
    length = look_up(-2.0, 0.6, 2.0, 0.6, field.origin, field.values)
    beneath = look_up(0.0, -0.3, 2.0, 0.6, field.origin, field.values)
    above = look_up(0.0, 1.5, 2.0, 0.6, field.origin, field.values)
    assert length > 4.2
    assert beneath < 2.4 < above + 1.0


def test_where_nothing_is_in_the_way_the_straight_line_is_the_length():
    field = DistanceField(np.zeros(2), np.ones(2), np.empty((0, 3)), NO_WALLS, 0.2)
    assert look_up(3.0, 4.0, 0.0, 0.0, field.origin, field.values) == pytest.approx(5.0)
