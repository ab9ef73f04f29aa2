"""What is believed of goals agrees with where people go, and futures are drawn from it."""

from __future__ import annotations

import numpy as np
from believed import drawn, futures
from crowdbench_agents.informed.agent import Informed
from crowdbench_agents.informed.goals import Goals
from crowdbench_agents.informed.search import TICKS

import crowdbench

SEED = 900_002
ENDS = {"start": [-4.0, -4.0], "goal": [4.0, 4.0]}


def watched(steps, scenario="multimodal_fast", futures=40, **overrides):
    """Goals after some steps in which the robot stands, and the state then."""
    env = crowdbench.parallel_env(scenario, **overrides)
    env.reset(seed=SEED)
    rng = np.random.default_rng(1)
    goals = Goals(env.state(), 0.2, env.robot_spec().radius, futures, rng)
    goals.update(env.state(), np.ones(env.scenario.pedestrians.count, dtype=bool))
    for _ in range(steps):
        env.step({"robot_0": (0.0, 0.0)})
        goals.update(env.state(), np.ones(env.scenario.pedestrians.count, dtype=bool))
    return goals, env.state(), env


def test_goals_are_believed_to_lie_ahead_and_a_leg_away_from_its_start():
    """Somebody alone walks straight: every believed goal is in that direction."""
    alone = {"count": 1, "reactive": 0, "goals": "unimodal"}
    goals, state, _ = watched(8, pedestrians=alone)
    believed = drawn(goals, state, "pedestrian_goal")[:, 0]
    place, true = state["pedestrian_position"][0], state["pedestrian_goal"][0]
    off = np.arctan2(*(believed - place).T[::-1]) - np.arctan2(*(true - place)[::-1])
    assert np.abs((off + np.pi) % (2 * np.pi) - np.pi).max() < 0.12
    away = np.linalg.norm(believed - state["pedestrian_start"][0], axis=1)
    assert away.min() > 4.0 - 0.2
    assert np.ptp(away) > 0.5, "how far it goes nobody can see"
    assert np.isinf(drawn(goals, state, "pedestrian_switch_time")).all()


def test_the_true_goal_is_among_those_believed():
    """In a crowd, where people evade each other: about as often as the belief says."""
    goals, state, _ = watched(10, pedestrians={"count": 10, "reactive": 0}, futures=100)
    believed, true = drawn(goals, state, "pedestrian_goal"), state["pedestrian_goal"]
    nearest = np.linalg.norm(believed - true, axis=2).min(axis=0)
    assert np.median(nearest) < 0.3


def test_half_of_the_legs_are_believed_to_be_interrupted_where_half_are():
    crowd = {"count": 30, "speed": (0.3, 0.5), "reactive": 0}
    goals, state, _ = watched(0, pedestrians=crowd, arena={"length": 20, "width": 20})
    switches = np.isfinite(drawn(goals, state, "pedestrian_switch_time"))
    assert abs(switches.mean() - 0.5) < 0.05
    back = (drawn(goals, state, "pedestrian_next_goal") == state["pedestrian_start"]).all(axis=2)
    assert abs(back[switches].mean() - 0.5) < 0.06
    assert (drawn(goals, state, "pedestrian_switch_time")[switches] > state["time"]).all()


def test_nothing_hidden_has_any_influence():
    def told(hidden=None):
        env = crowdbench.parallel_env("multimodal_fast")
        env.reset(seed=SEED)
        return futures(env, "pedestrian_goal", hidden)

    hidden = {"pedestrian_goal": 1.0, "pedestrian_next_goal": -1.0}
    np.testing.assert_array_equal(told(), told(hidden))


def test_who_is_not_seen_is_believed_to_go_anywhere():
    goals, state, _ = watched(0, pedestrians={"count": 1})
    env = crowdbench.parallel_env("multimodal_fast", pedestrians={"count": 1})
    env.reset(seed=SEED)
    unseen = Goals(env.state(), 0.2, 0.25, 40, np.random.default_rng(1))
    unseen.update(env.state(), np.zeros(1, dtype=bool))
    angles = [
        np.ptp(
            np.arctan2(*(drawn(g, state, "pedestrian_goal")[:, 0] - state["pedestrian_start"][0]).T)
        )
        for g in (goals, unseen)
    ]
    assert angles[0] < 0.3 < 1.0 < angles[1]


def test_one_future_with_the_true_goals_is_the_known_one():
    """Until somebody arrives, whose next goal is drawn in one and unknown in the other."""
    env = crowdbench.parallel_env("unimodal_fast", pedestrians={"reactive": 0})
    observations, _ = env.reset(seed=SEED)
    state = env.state()
    known, sampled = Informed(), Informed(intent="sampled", futures=1)
    actions = {}
    for agent in (known, sampled):
        agent.reset(env.robot_spec(), 0)
        if agent is sampled:
            agent._draw = lambda state, seen: [state]
        actions[agent] = agent.act(crowdbench.Observation(**observations["robot_0"], state=state))
    np.testing.assert_array_equal(actions[known], actions[sampled])


def test_whoever_arrives_in_a_future_walks_on_to_the_next_goal_drawn():
    alone = {"count": 1, "reactive": 0, "goals": "unimodal"}
    goals, state, env = watched(0, pedestrians=alone)
    (future, *_) = goals.draw(state)
    place = state["pedestrian_position"][0]
    future["pedestrian_goal"] = future["pedestrian_next_goal"] = place[None] + [0.5, 0.0]
    future["pedestrian_way"] = future["pedestrian_goal"][:, None]
    future["pedestrian_further"] = np.array([[[place[0] + 0.5, place[1] + 9.0], [0.0, 0.0]]])
    agent = Informed(intent="sampled")
    agent.reset(env.robot_spec(), 0)
    walk, spread = agent._predict(future, False)
    assert walk[-1, 0, 1] - place[1] > 1.5
    assert (spread == 0.0).all() and (walk[:, 0, 2] == 0.25).all()
    assert np.abs(np.diff(walk[: 2 * TICKS, 0, 0])).max() > 0.0


def test_the_same_seed_gives_the_same_drive():
    def drive(seed):
        env = crowdbench.parallel_env("multimodal_fast", time_limit=2.0)
        observations, _ = env.reset(seed=SEED)
        agent = Informed(intent="sampled", futures=2)
        agent.reset(env.robot_spec(), seed)
        actions = []
        while env.agents:
            seen = crowdbench.Observation(**observations["robot_0"], state=env.state())
            actions.append(agent.act(seen))
            observations, *_ = env.step({"robot_0": actions[-1]})
        return np.array(actions)

    np.testing.assert_array_equal(drive(5), drive(5))


def test_groups_go_where_their_first_is_believed_to_go_side_by_side():
    """With nobody else near: abreast, 0.75 m apart, at the pace of the slower one."""
    crowd = {"count": 2, "reactive": 0, "groups": {"share": 1.0, "size": (2, 2)}}
    env = crowdbench.parallel_env("unimodal_fast", pedestrians=crowd)
    env.reset(seed=SEED)
    state = env.state()
    agent = Informed(intent="sampled", futures=3)
    agent.reset(env.robot_spec(), 0)
    ways = []
    for told in agent._told(state):
        future, spread = agent._predict(told, False)
        before, after = future[15 * TICKS, :2, :2], future[16 * TICKS, :2, :2]
        first, second = before
        way = told["pedestrian_goal"][0] - first
        way /= np.linalg.norm(way)
        pace = state["pedestrian_speed"].min() * env.scenario.control_period
        np.testing.assert_allclose(after - before, [pace * way] * 2, atol=2e-3)
        assert abs(np.linalg.norm(second - first) - 0.75) < 2e-3
        assert abs((second - first) @ way) < 0.02
        assert (spread[: 16 * TICKS, :2] == 0.0).all()
        ways.append(way)
    assert np.ptp(ways, axis=0).max() > 0.01, "each future has a goal of its own"


def test_goals_lie_on_the_map_wherever_its_origin_is():
    arena = {"kind": "map", "length": 12, "width": 8, "centre": [20.0, 10.0]}
    robots = {"start": [15.0, 10.0], "goal": [25.0, 10.0]}
    goals, state, _ = watched(0, arena=arena, robots=robots)
    for name in ("pedestrian_goal", "pedestrian_next_goal", "pedestrian_further"):
        x, y = np.moveaxis(drawn(goals, state, name), -1, 0)
        assert ((x > 14) & (x < 26) & (y > 6) & (y < 14)).all()


def test_who_leaves_a_queue_begins_a_leg_there():
    """The first one was served after 4 s: a little later nearly half of its legs may yet change."""
    line = {"head": [3, 0], "direction": 0, "count": 4, "service": [4, 4], "spacing": 0.8}
    people = {"count": 5, "reactive": 0, "queues": [line]}
    goals, state, _ = watched(22, arena={"kind": "map"}, robots=ENDS, pedestrians=people)
    (first,) = np.flatnonzero((state["pedestrian_queue"] == 0) & state["pedestrian_walks_on"])
    switches = np.isfinite(drawn(goals, state, "pedestrian_switch_time")[:, first])
    assert 0.25 < switches.mean() < 0.6


def test_where_nothing_is_left_to_be_believed_belief_begins_anew():
    """The only place believed in is where somebody stands who has not arrived."""
    goals, state, env = watched(1, pedestrians={"count": 1, "reactive": 0, "goals": "unimodal"})
    away = np.linalg.norm(goals._cells - state["pedestrian_position"][0], axis=1)
    goals._weights[0] = away == away.min()
    goals._weights[0] /= goals._weights[0].sum()
    env.step({"robot_0": (0.0, 0.0)})
    goals.update(env.state(), np.ones(1, dtype=bool))
    believed = drawn(goals, env.state(), "pedestrian_goal")[:, 0]
    assert np.ptp(believed, axis=0).max() > 1.0
    assert np.linalg.norm(believed - state["pedestrian_start"][0], axis=1).min() > 4.0 - 0.2


def test_groups_that_turn_are_believed_to_turn():
    """Half a second after a leg begins, while limits on accelerations hold them back."""
    groups = {"share": 1.0, "size": (3, 3)}
    crowd = {"count": 9, "reactive": 0, "groups": groups, "acceleration": 2.4, "leg": 3}
    env = crowdbench.parallel_env("multimodal_fast", pedestrians=crowd)
    everybody, right = np.ones(9, dtype=bool), []
    for seed in range(SEED, SEED + 3):
        env.reset(seed=seed)
        state, age = env.state(), np.zeros(9)
        goals = Goals(state, 0.2, env.robot_spec().radius, 20, np.random.default_rng(1))
        goals.update(state, everybody)
        while env.agents:
            env.step({"robot_0": (0.0, 0.0)})
            before, state = state, env.state()
            goals.update(state, everybody)
            begun = (state["pedestrian_start"] != before["pedestrian_start"]).any(axis=1)
            age = np.where(begun, 0, age + 1)
            believed = drawn(goals, state, "pedestrian_goal") - state["pedestrian_position"]
            true = state["pedestrian_goal"] - state["pedestrian_position"]
            for p in {0, 3, 6} & set(np.flatnonzero(age == 2)):
                way = true[p] / np.linalg.norm(true[p])
                ahead = believed[:, p] @ way / np.linalg.norm(believed[:, p], axis=1)
                right.append((ahead > 0.7).mean())
    assert len(right) > 10
    assert np.mean(right) > 0.8
