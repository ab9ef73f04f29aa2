"""The ORCA agent: reaches goals past people, obstacles and walls with its LiDAR alone."""

from dataclasses import replace

import numpy as np
import pytest
from crowdbench_agents.orca import STOP, Orca
from hypothesis import given, settings
from hypothesis import strategies as st

import crowdbench
from crowdbench.evaluation.rollout import run_episode


def test_with_nothing_around_it_drives_straight_at_full_speed(world):
    path, outcome = world.drive(Orca(), goal=(4.0, 0.0))
    assert outcome == "success"
    np.testing.assert_allclose(path[:, 1], 0.0, atol=1e-6)
    np.testing.assert_allclose(np.diff(path[:, 0]), 0.2, atol=1e-6)


def test_it_turns_on_the_spot_towards_a_goal_behind(world):
    agent = Orca()
    agent.reset(world.spec, 0)
    v, w = agent.act(world.observe((0, 0, 0), (), goal=(-3.0, 0.1)))
    assert v == pytest.approx(0.0, abs=1e-9)
    assert w == pytest.approx(1.5)


@pytest.mark.parametrize(("away", "evades"), [(4.4, False), (3.8, True)])
def test_people_are_evaded_who_are_less_than_two_seconds_away(world, away, evades):
    """Both come at 1 m/s, and their surfaces are about 0.6 m nearer to each other."""
    assert bool(turns_for_somebody_ahead(world, away)) is evades


def test_with_limits_it_looks_farther_ahead(slow_world):
    assert turns_for_somebody_ahead(slow_world, 4.4)


def turns_for_somebody_ahead(world, away):
    """The turn rate [rad/s] if it counts, when who comes towards the robot is ``away`` [m]."""
    agent = Orca()
    agent.reset(world.spec, 0)
    for step in range(-9, 1):
        place = (away - 0.2 * step, 0.1, 0.25)
        seen = world.observe((0.2 * step, 0, 0), [place], (), (9 - 0.2 * step, 0), (1, 0))
        _, turn = agent.act(seen)
    return turn if abs(turn) > 0.1 else 0.0


def test_it_passes_an_obstacle_between_walls(world):
    walls = [(-3.0, -1.2, 9.0, -1.2), (-3.0, 1.2, 9.0, 1.2)]
    path, outcome = world.drive(Orca(), goal=(5.0, 0.0), discs=[(2.5, -0.2, 0.35)], walls=walls)
    assert outcome == "success"
    assert path[:, 1].max() > 0.3


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_mirrored_world_is_answered_with_the_mirrored_action(world, seed):
    seen = world.random_observation(np.random.default_rng(seed))
    actions = []
    for observation in (seen, world.mirrored(seen)):
        agent = Orca()
        agent.reset(world.spec, 0)
        actions.append(agent.act(observation))
    np.testing.assert_allclose(actions[1], np.array(actions[0]) * [1, -1], atol=1e-4)


def test_it_brakes_for_what_stands_in_its_arc(world):
    agent = Orca(margin=-0.2)  # blind to what it would have to evade
    agent.reset(world.spec, 0)
    # From the front to the disc it is 0.02 m more than it has to keep.
    v, w = agent.act(world.observe((0, 0, 0), [(0.2 + STOP + 0.3, 0.0, 0.28)]))
    assert v * world.spec.control_period <= 0.02 + 1e-6
    assert w == pytest.approx(0.0, abs=1e-3)


def test_it_needs_no_privileges():
    assert not Orca.privileged


def test_an_omnidirectional_robot_evades_without_turning_and_arrives():
    world = crowdbench.load_scenario("corridor_moderate", **{"robots.drive": "omnidirectional"})
    (episode,) = run_episode(world, [Orca()], seed=900_003)
    assert episode.outcome == "success"
    assert np.ptp(episode.robot_pose[:, 2]) == 0.0
    assert np.abs(episode.actions[:, 1]).max() > 0.2


def test_an_omnidirectional_robot_brakes_for_what_stands_beside_it(world):
    agent = Orca(margin=-0.2)  # blind to what it would have to evade
    agent.reset(replace(world.spec, drive="omnidirectional"), 0)
    # From the side to the disc it is 0.02 m more than it has to keep.
    seen = world.observe((0, 0, 0), [(0.0, 0.15 + STOP + 0.3, 0.28)], goal=(0.0, 5.0))
    ahead, left = agent.act(seen)
    assert 0.0 <= left * world.spec.control_period <= 0.02 + 1e-6
    assert abs(ahead) <= left + 1e-6
