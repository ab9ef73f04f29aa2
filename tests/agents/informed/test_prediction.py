"""What the informed agent foresees without knowing where people are going."""

from __future__ import annotations

import numpy as np
import pytest
from crowdbench_agents.informed.agent import Informed
from crowdbench_agents.informed.search import HORIZON, TICKS

import crowdbench

ALONE = {"count": 1, "reactive": 0}


def begun(scenario, seed, **overrides):
    env = crowdbench.parallel_env(scenario, **overrides)
    observations, _ = env.reset(seed=seed)
    return env, observations["robot_0"], env.state()


def prediction(env, state, **options):
    agent = Informed(**options)
    agent.reset(env.robot_spec(), 0)
    return agent._predict(agent._told(state)[0], False)


def test_by_velocity_one_person_walks_straight_on_past_its_goal():
    env, _, state = begun("multimodal_fast", 900_003, pedestrians=ALONE)
    place, velocity = state["pedestrian_position"][0], state["pedestrian_velocity"][0]
    state["pedestrian_goal"][0] = place + 0.5 * velocity
    future, _ = prediction(env, state, intent="velocity")
    times = np.arange(HORIZON * TICKS + 1) * env.scenario.control_period / TICKS
    expected = place + times[:, None] * velocity
    np.testing.assert_allclose(future[:, 0, :2], expected, atol=1e-9)
    assert (future[:, 0, 2] == 0.25).all()


def test_by_velocity_nothing_hidden_has_any_influence():
    env, _, state = begun("multimodal_fast", 900_004)
    hidden = {
        "pedestrian_goal": state["pedestrian_goal"] + 1.0,
        "pedestrian_next_goal": state["pedestrian_next_goal"] - 2.0,
        "pedestrian_switch_time": np.zeros_like(state["pedestrian_switch_time"]),
        "pedestrian_speed": state["pedestrian_speed"] * 2.0,
        "pedestrian_intent": state["pedestrian_intent"] * 0,
    }
    one = prediction(env, state, intent="velocity")
    other = prediction(env, {**state, **hidden}, intent="velocity")
    np.testing.assert_array_equal(one[0], other[0])
    np.testing.assert_array_equal(one[1], other[1])


@pytest.mark.parametrize("growth", [0.0, 0.7])
def test_by_velocity_uncertainty_grows_with_time(growth):
    env, _, state = begun("multimodal_fast", 900_004)
    _, spread = prediction(env, state, intent="velocity", growth=growth)
    seconds = HORIZON * env.scenario.control_period
    np.testing.assert_allclose(spread[-1], growth * seconds)
    np.testing.assert_allclose(spread[TICKS], growth * env.scenario.control_period)


HABITS = {
    "limited accelerations": {"acceleration": 0.8},
    "stops": {"stops": {"share": 1.0, "duration": (1.0, 3.0)}},
    "standing": {"standing": 0.5},
    "sizes": {"radius": (0.15, 0.35)},
    "a queue": {"queues": [{"head": [3, 3], "direction": 0, "count": 3, "service": [1, 2]}]},
}


@pytest.mark.parametrize("habit", HABITS)
def test_people_with_habits_walk_as_predicted(habit):
    """Until somebody arrives or is served; the robot is out of sight of all."""
    people = {"count": 8, "reactive": 0, **HABITS[habit]}
    env, agent = crowdbench.parallel_env("unimodal_fast", pedestrians=people), Informed()
    compared, moved = 0, []
    for seed in range(900_000, 900_004):
        env.reset(seed=seed)
        agent.reset(env.robot_spec(), seed)
        for _ in range(3):
            env.step({"robot_0": (0.0, 0.0)})
        before = env.state()
        future, spread = agent._predict(before, False)
        for step in range(1, 16):
            env.step({"robot_0": (0.0, 0.0)})
            state = env.state()
            if not env.agents or (state["pedestrian_goal"] != before["pedestrian_goal"]).any():
                break
            left = np.linalg.norm(state["pedestrian_goal"] - state["pedestrian_position"], axis=1)
            if (left < 0.6)[state["pedestrian_walks_on"]].any():
                break
            predicted = future[step * TICKS, : len(left), :2]
            np.testing.assert_allclose(predicted, state["pedestrian_position"], atol=1e-2)
            assert (spread[step * TICKS, : len(left)] == 0.0).all()
            compared += len(left)
            moved.append(np.ptp(np.linalg.norm(state["pedestrian_velocity"], axis=1)))
    assert compared > 60
    assert max(moved) > 0.1


def test_by_velocity_or_sampled_nobody_knows_of_stops_to_come():
    env, _, state = begun("multimodal_fast", 900_004, pedestrians={"stops": {"share": 1.0}})
    for options in ({"intent": "velocity"}, {"intent": "sampled", "futures": 2}):
        other = {**state, "pedestrian_stop_time": np.zeros(len(state["pedestrian_stop_time"]))}
        np.testing.assert_array_equal(
            prediction(env, state, **options)[0], prediction(env, other, **options)[0]
        )


def test_what_is_recorded_ahead_is_what_is_predicted():
    env, _, state = begun("multimodal_fast", 900_004)
    ahead = np.cumsum(np.full((50, 6, 2), 0.1), axis=0) + state["pedestrian_position"]
    ahead[10:, 2] = np.nan
    future, spread = prediction(env, {**state, "recorded_ahead": ahead})
    np.testing.assert_allclose(future[TICKS : 5 * TICKS : TICKS, :6, :2], ahead[:4], atol=1e-12)
    middle = (ahead[0] + ahead[1]) / 2
    np.testing.assert_allclose(future[TICKS + 1, :6, :2], middle, atol=1e-12)
    assert (future[11 * TICKS :, 2, 2] < 0.0).all() and (future[:, 3, 2] == 0.25).all()
    assert future.shape[1] == 7 and (spread == 0.0).all()


@pytest.mark.parametrize("latency", [1, 3])
def test_plans_begin_when_their_commands_act(latency):
    """The robot is where the first command of a plan was meant to act, and arrives."""
    env = crowdbench.parallel_env("unimodal_fast", robots={"latency": latency}, time_limit=20)
    observations, infos = env.reset(seed=900_500)
    agent = Informed()
    agent.reset(env.robot_spec(), 0)
    begins, poses = [], []
    search = agent._search
    agent._search = lambda pose, *rest: (begins.append(pose), search(pose, *rest))[1]
    while env.agents:
        state = env.state()
        poses.append(state["robot_pose"][0])
        seen = crowdbench.Observation(**observations["robot_0"], state=state)
        observations, *_, infos = env.step({"robot_0": agent.act(seen)})
    assert infos["robot_0"]["outcome"] == "success"
    count = min(len(begins), len(poses) - latency)
    np.testing.assert_allclose(begins[:count], poses[latency:][:count], atol=1e-2)


def test_uncertainty_has_its_price():
    """Where somebody crosses ahead, a robot that pays more for being near keeps farther away."""
    env, seen, state = begun("unimodal_slow", 900_000, pedestrians=ALONE)
    ahead = state["robot_goal"][0] - state["robot_pose"][0, :2]
    ahead /= np.hypot(*ahead)
    state["robot_pose"][0, 2] = np.arctan2(ahead[1], ahead[0])
    aside = np.array([-ahead[1], ahead[0]])
    state["pedestrian_position"][0] = state["robot_pose"][0, :2] + 3.0 * ahead + 0.8 * aside
    state["pedestrian_velocity"][0], state["pedestrian_speed"][0] = 0.0, 0.0

    def turns(price):
        agent = Informed(intent="velocity", growth=0.5, price=price)
        agent.reset(env.robot_spec(), 0)
        agent.act(crowdbench.Observation(**seen, state=state))
        return np.abs(agent._plan[:, 1]).max()

    assert turns(0.0) == 0.0 < turns(30.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"growth": 0.5}, "option 'growth' goes with intent=velocity or intent=sampled"),
        ({"intent": "velocity", "futures": 4}, "option 'futures' goes with intent=sampled, not"),
        ({"intent": "known", "price": 5.0}, "option 'price' goes with"),
    ],
)
def test_an_option_that_the_intent_has_no_use_for_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Informed(**options)
