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
