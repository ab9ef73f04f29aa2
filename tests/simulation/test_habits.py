"""Habits: when people look away, stop and stand, whatever a robot does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench import Scenario, ScenarioError, parallel_env, vector_env
from crowdbench.simulation.draws import between, splitmix64
from crowdbench.simulation.world import World

CROWD = Scenario(name="crowd", pedestrians={"count": 10, "reactive": 0.8, "speed": [0.5, 1.2]})
AWAY = {"away_share": 0.5, "away_for": [1.0, 2.0], "every": [3.0, 4.0]}
STOPS = {"share": 0.5, "duration": [1.0, 2.0]}
EVERYTHING = CROWD.override(
    {"pedestrians": {"attention": AWAY, "stops": STOPS, "standing": 0.3, "goals": "multimodal"}}
)


def walk(scenario, seed, speed=0.0, steps=100):
    """The state after every step."""
    world, states = World(scenario, seed), []
    for _ in range(steps):
        world.step(np.array([[speed, 0.2]]))
        people = world.pedestrians._asdict()
        sees = world.worlds.state.sees[0].copy()
        states.append({"sees": sees} | {name: value.copy() for name, value in people.items()})
    return {name: np.array([state[name] for state in states]) for name in states[0]}


def test_draws_are_those_of_splitmix64():
    """Against the numbers that its authors' program gives."""
    numbers = [int(splitmix64(np.uint64(1234567), i)) for i in range(3)]
    assert numbers == [6457827717110365317, 3203168211198807973, 9817491932198370423]


def test_numbers_for_one_purpose_are_uniform_and_tell_nothing_of_those_for_another():
    drawn = np.array(
        [[between((2.0, 4.0), np.uint64(9), use, i) for i in range(2000)] for use in range(3)]
    )
    assert ((drawn >= 2) & (drawn < 4)).all()
    np.testing.assert_allclose(np.quantile(drawn, [0.25, 0.5, 0.75], axis=1).T - 3,
                               [[-0.5, 0, 0.5]] * 3, atol=0.07)  # fmt: skip
    assert np.abs(np.corrcoef(drawn) - np.eye(3)).max() < 0.07


def spans(flags):
    """Lengths of the runs of True that lie wholly within."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags, [0]]).astype(int)))
    return [b - a for a, b in edges.reshape(-1, 2) if a > 0 and b < len(flags)]


def test_a_share_of_the_reactive_looks_away_for_as_long_as_is_said_and_sees_nothing_then():
    seen = walk(CROWD.override({"pedestrians.attention": AWAY}), 3, steps=200)
    away, reactive = ~seen["attentive"], seen["reactive"][0]
    assert away.any(axis=0).sum() == round(0.5 * 8)
    assert not away[:, ~reactive].any()
    assert not seen["sees"][away].any()
    assert seen["sees"][~away].any()
    lasting = [0.2 * span for p in range(10) for span in spans(away[:, p])]
    looking = [0.2 * span for p in range(10) for span in spans(~away[:, p])]
    assert len(lasting) > 15
    assert 1.0 - 0.21 <= min(lasting) < 1.4 and 1.6 < max(lasting) <= 2.0 + 0.21
    assert min(looking) >= 3.0 - 0.21 and max(looking) <= 4.0 + 0.21


def test_people_stop_on_a_share_of_their_legs_and_then_walk_on_to_the_same_goal():
    alone = CROWD.override({"pedestrians": {"model": "straight", "stops": STOPS}})
    seen = walk(alone, 1, steps=400)
    legs = {(p, *goal) for p in range(10) for goal in seen["goal"][:, p].tolist()}
    stands = (seen["chosen"] == 0.0).all(axis=2)
    stopped = {(p, *seen["goal"][t, p]) for t, p in np.argwhere(stands).tolist()}
    assert 0.35 < len(stopped) / len(legs) < 0.65
    lasting = [0.2 * span for p in range(10) for span in spans(stands[:, p])]
    assert min(lasting) >= 1.0 - 0.21 and max(lasting) <= 2.0 + 0.21
    # Every stop lies between two parts of one leg, and happens when it was announced.
    times = 0.2 * np.arange(400)[:, None]
    announced = (seen["stop_time"] <= times) & (times < seen["stop_end"])
    np.testing.assert_array_equal(stands, announced)
    last = np.flatnonzero(stands[:-1, 0] & ~stands[1:, 0])
    np.testing.assert_array_equal(seen["goal"][last, 0], seen["goal"][last + 1, 0])


def test_who_stands_keeps_a_place_and_comes_back_to_it():
    scenario = CROWD.override({"pedestrians": {"standing": 0.4, "speed": [0.8, 1.2]}})
    world = World(scenario, 5)
    standing, places = world.layout.traits.standing, world.layout.pedestrian_position
    assert standing.sum() == 4
    assert (world.pedestrians.velocity[standing] == 0).all()
    away = []
    for _ in range(300):
        world.step(np.zeros((1, 2)))
        np.testing.assert_array_equal(world.pedestrians.goal[standing], places[standing])
        away.append(np.linalg.norm(world.pedestrians.position - places, axis=1))
    away = np.array(away)
    assert 0.05 < away[:, standing].max() < 1.0  # made way for others
    assert np.median(away[:, standing]) < 0.01
    assert (away[:, ~standing].max(axis=0) > 2).all()


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_robots_have_no_part_in_what_is_drawn(seed):
    """Two robots, people who see neither: everything about them is the same to the last bit."""
    blind = EVERYTHING.override({"pedestrians": {"field_of_view": 0.001, "model": "straight"}})
    slow, fast = (walk(blind, seed, speed, steps=60) for speed in (0.0, 0.3))
    for name in ("attentive", "attention_time"):
        np.testing.assert_array_equal(slow[name], fast[name])
    # A leg that began in the same place at the same time has the same stop.
    same = (slow["start"] == fast["start"]).all(axis=2)
    assert same.mean() > 0.8
    for name in ("goal", "stop_time", "stop_end"):
        np.testing.assert_array_equal(slow[name][same], fast[name][same])


def test_others_have_no_part_in_it_either():
    more = walk(EVERYTHING.override({"pedestrians.count": 12}), 4, steps=1)
    fewer = walk(EVERYTHING, 4, steps=1)
    np.testing.assert_array_equal(more["speed"][:, :10], fewer["speed"])
    both = np.isfinite(more["attention_time"][:, :10]) & np.isfinite(fewer["attention_time"])
    assert both.any()
    np.testing.assert_array_equal(
        more["attention_time"][:, :10][both], fewer["attention_time"][both]
    )


@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 10**6), lanes=st.integers(1, 3))
def test_lanes_have_the_habits_of_the_single_environment_to_the_last_bit(seed, lanes):
    """Beside a lane without habits, and again in a lane that had none before."""
    plain = CROWD.override({"time_limit": 2})
    habits = EVERYTHING.override({"time_limit": 8, "pedestrians.acceleration": 1.5})
    env = vector_env([plain, habits], lanes + 1, autoreset_mode="Disabled")
    env.reset(seed=seed, options={"scenario": np.zeros(lanes + 1, dtype=int)})
    which = np.array([0] + [1] * lanes)
    env.reset(seed=seed, options={"scenario": which})
    singles = [parallel_env(habits if lane else plain) for lane in range(lanes + 1)]
    for lane, single in enumerate(singles):
        single.reset(seed=seed + lane)
    for action in np.random.default_rng(seed).uniform([0, -1.5], [1, 1.5], (30, 2)):
        env.step(np.tile(action, (lanes + 1, 1)))
        for lane, single in enumerate(singles):
            if single.agents:
                single.step({"robot_0": action})
                for name, value in single.state().items():
                    np.testing.assert_array_equal(env.state(lane)[name], value, err_msg=name)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"standing": 1.2}, r"standing: 1\.2 is out of range; allowed: >= 0 and <= 1"),
        ({"attention": {"away_share": -1}}, r"attention\.away_share: -1 is out of range"),
        ({"attention": {"every": [9, 2]}}, r"attention\.every: the lower bound 9.* exceeds"),
        ({"attention": {"away_for": [0, 2]}}, r"attention\.away_for: 0 is out of range"),
        ({"attention": 0.3}, r"attention: expected a section"),
        ({"stops": {"share": 0.5, "lenght": 3}}, r"unknown key 'pedestrians\.stops\.lenght'"),
    ],
)
def test_what_cannot_be_is_refused_with_the_field(changes, told):
    with pytest.raises(ScenarioError, match=told):
        CROWD.override({"pedestrians": changes})
