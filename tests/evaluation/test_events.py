"""The moments of an episode against episodes made by hand, and against the metrics they explain."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from crowdbench.evaluation.events import Event, find_events
from crowdbench.evaluation.metrics import METRICS
from crowdbench.simulation.contact import Contact

STAYING = [[0, 0, 0]] * 4


def of_kind(episode, kind):
    return [event for event in find_events(episode) if event.kind == kind]


def test_a_cut_off_is_where_the_robot_crosses_in_front(make_episode):
    """A person walks along y at 1 m/s from (0, -2); the robot passes x = 0 in its second step."""
    robot = [[-0.3, 0, 0], [-0.1, 0, 0], [0.1, 0, 0], [0.3, 0, 0]]
    walk = [[[0, -2 + 0.2 * t]] for t in range(4)]
    episode = make_episode(robot, [[1, 0]] * 3, walk, [[[0, 1]]] * 4)
    # Seen from state 1, the person at -1.8 has walked 0.1 m on at the crossing: 1.7 - R = 1.2 m.
    (event,) = of_kind(episode, "cutoff")
    assert (event.first, event.last, event.pedestrian) == (2, 2, 0)
    assert event.value == pytest.approx(1.2)


def test_a_close_call_lasts_while_the_time_to_collision_is_below_a_second(make_episode):
    """The fixture of docs/metrics.md: 1.1 s after the first step, 0.9 s after the second."""
    robot = [[0.2 * t, 0, 0] for t in range(4)]
    episode = make_episode(robot, [[1, 0]] * 3, [[1.6, 0.4]])
    (event,) = of_kind(episode, "ttc")
    assert (event.first, event.last, event.pedestrian) == (2, 3, 0)
    assert event.value == pytest.approx(0.7)


def test_two_close_calls_are_two_events_and_name_the_nearer_person(make_episode):
    speeds = [[1, 0], [0, 0], [1, 0]]
    robot = [[0, 0, 0], [0.2, 0, 0], [0.2, 0, 0], [0.4, 0, 0]]
    episode = make_episode(robot, speeds, [[1.3, 0], [1.1, 0]])
    events = of_kind(episode, "ttc")
    assert [(event.first, event.last, event.pedestrian) for event in events] == [
        (1, 1, 1),
        (3, 3, 1),
    ]


def test_a_switch_is_at_the_first_state_that_is_late_enough(make_episode):
    episode = make_episode(
        STAYING,
        pedestrians=[[3, 0], [3, 1]],
        pedestrian_intent=np.array([[1, 0], [1, 0], [0, 0], [0, 0]]),
        pedestrian_switch_time=np.array([[0.15, np.inf], [0.15, np.inf], [np.inf] * 2, [9, 9]]),
    )
    assert of_kind(episode, "switch") == [Event("switch", 1, 1, 0, detail="return")]


@pytest.mark.parametrize(
    ("fields", "pedestrian", "detail"),
    [
        ({"outcome": "success"}, None, ""),
        ({"outcome": "timeout"}, None, ""),
        ({"outcome": "collision", "contact": Contact("pedestrian", 1, 0.5, 0.1)}, 1, "pedestrian"),
        ({"outcome": "collision", "contact": Contact("wall", 1, 0.5, 0.0)}, None, "wall"),
        ({"outcome": "agent_error", "error": "it broke"}, None, "it broke"),
    ],
)
def test_the_end_comes_last_with_its_reason(make_episode, fields, pedestrian, detail):
    episode = dataclasses.replace(make_episode(STAYING, pedestrians=[[3, 0], [3, 1]]), **fields)
    assert find_events(episode) == [Event(fields["outcome"], 3, 3, pedestrian, detail=detail)]


@pytest.mark.parametrize("seed", range(20))
def test_the_metrics_count_the_same_moments(random_episode, seed):
    episode = random_episode(seed)
    assert len(of_kind(episode, "cutoff")) == METRICS["cutoff"].function(episode)
    close = sum(event.last - event.first + 1 for event in of_kind(episode, "ttc"))
    assert close / episode.steps == pytest.approx(METRICS["ttc_below_1s"].function(episode))


def test_an_episode_without_a_step_has_an_end(make_episode):
    (event,) = find_events(make_episode([[0, 0, 0]], outcome="agent_error", error="no idea"))
    assert (event.kind, event.first, event.detail) == ("agent_error", 0, "no idea")


def test_switches_of_a_real_episode_are_where_goals_change():
    """Against the log: at each switch, and at no other kept goal, the goal is another one next."""
    from crowdbench.evaluation.rollout import run_episode

    (episode,) = run_episode("multimodal_fast", "straight_line", seed=900004)
    switches = of_kind(episode, "switch")
    assert switches
    for event in switches:
        before, after = episode.pedestrian_goal[event.first : event.first + 2, event.pedestrian]
        assert not np.array_equal(before, after)
        assert episode.pedestrian_intent[event.first + 1, event.pedestrian] == 0
