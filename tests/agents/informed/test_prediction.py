"""What the informed agent foresees without knowing where people are going."""

from __future__ import annotations

import numpy as np
import pytest
from crowdbench_agents.informed.agent import Informed
from crowdbench_agents.informed.search import HORIZON, TICKS
from foreseen import STAND, episodes, ways_left

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
@pytest.mark.parametrize("intent", [{"intent": "velocity"}, {"intent": "sampled", "futures": 2}])
def test_by_velocity_or_sampled_uncertainty_grows_with_time(intent, growth):
    env, _, state = begun("multimodal_fast", 900_004)
    _, spread = prediction(env, state, growth=growth, **intent)
    seconds = HORIZON * env.scenario.control_period
    np.testing.assert_allclose(spread[-1], growth * seconds)
    np.testing.assert_allclose(spread[TICKS], growth * env.scenario.control_period)


HABITS = {
    "limited accelerations": {"acceleration": 0.8},
    "stops": {"stops": {"share": 1.0, "duration": (1.0, 3.0)}},
    "standing": {"standing": 0.5},
    "sizes": {"radius": (0.15, 0.35)},
    "groups": {"groups": {"share": 1.0, "size": (2, 3)}},
    "a queue": {"queues": [{"head": [3, 3], "direction": 0, "count": 3, "service": [1, 2]}]},
}


def touch(state):
    """Whether two people do: how bodies push each other is not foreseen."""
    place, radius = state["pedestrian_position"], state["pedestrian_radius"]
    gaps = np.linalg.norm(place[:, None] - place, axis=2) - radius[:, None] - radius
    return (gaps[~np.eye(len(place), dtype=bool)] < 1e-3).any()


@pytest.mark.parametrize("habit", HABITS)
def test_people_with_habits_walk_as_predicted(habit):
    """Until somebody arrives, is served or touched; the robot is out of sight of all."""
    people = {"count": 8, "reactive": 0, **HABITS[habit]}
    env, agent = crowdbench.parallel_env("unimodal_fast", pedestrians=people), Informed()
    compared, moved = 0, []
    for before, after in episodes(env, agent, range(900_000, 900_004), [STAND] * 3, STAND, 15):
        future, spread = agent._predict(before, False)
        for step, state in after:
            if (state["pedestrian_goal"] != before["pedestrian_goal"]).any():
                break
            left = ways_left(state)
            if (left < 0.6)[state["pedestrian_walks_on"]].any() or touch(state):
                break
            predicted = future[step * TICKS, : len(left), :2]
            np.testing.assert_allclose(predicted, state["pedestrian_position"], atol=1e-2)
            assert (spread[step * TICKS, : len(left)] == 0.0).all()
            compared += len(left)
            moved.append(np.ptp(np.linalg.norm(state["pedestrian_velocity"], axis=1)))
    assert compared > 60
    assert max(moved) > 0.1


MAP = {
    "kind": "map",
    "length": 12,
    "width": 12,
    "polygons": [[[-6, -6], [3.6, -6], [3.6, 3.6], [-6, 3.6]]],
    "regions": {"west": [-5.5, 4, -4.5, 5.5], "south": [4, -5.5, 5.5, -4.5]},
}
SEEN = {
    "all around": {"field_of_view": 360},
    "a view": {"field_of_view": 120},
    "attention": {"attention": {"away_share": 1.0, "away_for": (5, 9), "every": (1, 9)}},
    "accelerations and groups": {"acceleration": 2.0, "groups": {"share": 0.5, "size": (2, 3)}},
}


@pytest.mark.parametrize("people", SEEN)
def test_people_evade_a_robot_that_does_as_planned_as_predicted(people):
    """Until somebody arrives or two touch; were it not seen they would walk elsewhere."""
    env = crowdbench.parallel_env(
        "unimodal_fast",
        robots={"acceleration": (1.0, 3.0), "latency": 2},
        pedestrians={"count": 10, "reactive": 1, "responsibility": 1.0, **SEEN[people]},
    )
    agent, compared, evaded = Informed(), 0, 0.0
    plan = np.tile([1.0, 0.2], (HORIZON, 1))
    seeds, latency = range(900_000, 900_006), env.scenario.robots.latency
    for before, after in episodes(env, agent, seeds, [(1.0, 0.0)] * 6, plan[0], 9 + latency):
        future, _ = agent._predict(before, True, plan)
        unseen, _ = agent._predict(before, False)
        for step, state in after:
            left = ways_left(state)
            if left.min() < 0.6 or touch(state):
                break
            if step >= latency:
                row = (step - latency) * TICKS
                places = state["pedestrian_position"]
                np.testing.assert_allclose(future[row, : len(left), :2], places, atol=1e-2)
                evaded = max(evaded, np.abs(unseen[row, : len(left), :2] - places).max())
                compared += len(left)
    assert compared > 60
    assert evaded > 0.05


def test_around_corners_people_walk_as_predicted_and_leave_at_the_end():
    """Who comes out of a stream is nowhere, and not where it would have walked on to."""
    env = crowdbench.parallel_env(
        "unimodal_fast",
        arena=MAP,
        robots={"start": "west", "goal": "south"},
        pedestrians={
            "count": 5,
            "reactive": 0,
            "acceleration": 2.0,
            "streams": [{"start": "west", "goal": "south"}],
        },
    )
    agent, compared, left = Informed(), 0, 0
    for before, after in episodes(env, agent, range(900_000, 900_006), [], STAND, 15):
        future, _ = agent._predict(before, False)
        for step, state in after:
            goes = (state["pedestrian_goal"] != before["pedestrian_goal"]).any(axis=1)
            if goes.any():
                assert (future[(step + 1) * TICKS, :5, 2][goes] < 0.0).all()
                left += goes.sum()
                break
            if touch(state):
                break
            places = state["pedestrian_position"]
            np.testing.assert_allclose(future[step * TICKS, :5, :2], places, atol=1e-2)
            compared += 5
    assert compared > 100
    assert left > 0


def test_by_velocity_or_sampled_nobody_knows_of_stops_to_come():
    env, _, _ = begun("multimodal_fast", 900_004, pedestrians={"stops": {"share": 1.0}})
    env.step({"robot_0": (0.0, 0.0)})
    state = env.state()
    begins, ends = state["pedestrian_stop_time"], state["pedestrian_stop_end"]
    assert ((state["time"] < begins) & np.isfinite(begins)).all()
    other = {**state, "pedestrian_stop_time": begins + 0.5, "pedestrian_stop_end": ends + 1.0}
    for options in ({"intent": "velocity"}, {"intent": "sampled", "futures": 2}):
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
    agree = agent._agree
    agent._agree = lambda pose, *rest: (begins.append(pose), agree(pose, *rest))[1]
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
