"""Stops that may be, for those who do not know when anybody will stop."""

import numpy as np
import pytest
from crowdbench_agents.informed.goals import Goals
from crowdbench_agents.informed.stops import Stops

import crowdbench

FUTURES = 4000


def walking(now=0.0, since=np.inf, end=np.inf):
    """One person on a leg of 10 m at 1 m/s, of which it stops on 40 %, for 2 to 5 s."""
    return {
        "time": np.array(now),
        "stop_share": np.array(0.4),
        "stop_duration": np.array([2.0, 5.0]),
        "pedestrian_start": np.zeros((1, 2)),
        "pedestrian_speed": np.ones(1),
        "pedestrian_stop_time": np.array([since]),
        "pedestrian_stop_end": np.array([end]),
    }


def stops_of(*states):
    """Stops after the last of some states, (FUTURES,) begin and end."""
    stops = Stops(1, FUTURES, np.random.default_rng(0))
    stops.begin_leg(0)
    goal = np.full((FUTURES, 1, 2), [6.0, 8.0])
    for state in states:
        begin, end = stops.draw(state, np.zeros(1), goal)
    return begin[:, 0], end[:, 0]


def test_a_leg_that_begins_has_a_stop_as_often_as_legs_have_and_evenly_along_it():
    begin, end = stops_of(walking())
    some = np.isfinite(begin)
    assert some.mean() == pytest.approx(0.4, abs=0.03)
    assert (end[~some] == np.inf).all()
    for drawn, low, high in ((begin[some], 0, 10), (end[some] - begin[some], 2, 5)):
        assert low <= drawn.min()
        assert drawn.max() <= high
        assert drawn.mean() == pytest.approx((low + high) / 2, abs=0.02 * (high - low))


def test_who_has_walked_half_of_it_is_believed_to_stop_by_the_rule_of_bayes():
    """Of ten legs four have a stop, two of them in the half that is left: two of eight."""
    begin, _ = stops_of(walking(now=5.0))
    some = np.isfinite(begin)
    assert some.mean() == pytest.approx(0.25, abs=0.03)
    assert begin[some].min() >= 5.0


def test_who_stands_has_stood_since_then_and_will_for_at_most_what_is_left():
    """Whenever it will really walk on: 3 s of at most 5 are over."""
    for truth in (4.1, 6.0):
        begin, end = stops_of(walking(now=4.0, since=1.0, end=truth))
        assert (begin == 1.0).all()
        assert 4.0 <= end.min() < 4.1
        assert 5.9 < end.max() <= 6.0


def test_nobody_stops_twice_on_a_leg():
    begin, _ = stops_of(walking(4.0, 1.0, 4.1), walking(4.2, 1.0, 4.1))
    assert (begin == np.inf).all()


def test_who_stands_on_its_way_is_foreseen_to_stand_there_for_a_while_that_nobody_knows():
    """The only person of a world has stood for half a second, of 2 to 5."""
    alone = {"count": 1, "reactive": 0, "goals": "unimodal", "stops": {"share": 1.0}}
    env = crowdbench.parallel_env("multimodal_fast", pedestrians=alone)
    env.reset(seed=900_004)
    goals = Goals(env.state(), 0.2, 0.25, 20, np.random.default_rng(1))
    for _ in range(7):
        state = env.state()
        goals.update(state, np.ones(1, dtype=bool))
        env.step({"robot_0": (0.0, 0.0)})
    assert state["time"] - state["pedestrian_stop_time"][0] == pytest.approx(0.5, abs=0.1)
    stands = [
        np.linalg.norm(
            crowdbench.walk_ahead(future, 0.2, np.full((20, 1, 4), np.nan), 0.25).velocity[:, 0],
            axis=1,
        )
        < 0.01
        for future in goals.draw(state)
    ]
    lasts = 0.2 * np.sum(stands, axis=1)
    assert 1.4 <= lasts.min() <= 2.5
    assert np.ptp(lasts) > 1.0
