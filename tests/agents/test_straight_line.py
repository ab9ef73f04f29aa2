"""The straight line: what it does can be said in a formula."""

from dataclasses import replace

import numpy as np
import pytest
from crowdbench_agents.straight_line import StraightLine
from hypothesis import given
from hypothesis import strategies as st

import crowdbench
from crowdbench.evaluation.rollout import run_episode


@given(angle=st.floats(-3, 3), distance=st.floats(0.5, 8))
def test_an_omnidirectional_robot_goes_to_the_goal_at_full_speed(world, angle, distance):
    agent = StraightLine()
    agent.reset(replace(world.spec, drive="omnidirectional"), 0)
    goal = distance * np.array([np.cos(angle), np.sin(angle)])
    action = agent.act(world.observe((0, 0, 0), (), goal=goal))
    np.testing.assert_allclose(action, goal / distance, atol=1e-5)


@pytest.mark.parametrize("drive", ["differential", "omnidirectional"])
def test_it_arrives_where_nobody_is(drive):
    alone = {"robots.drive": drive, "pedestrians.count": 0}
    world = crowdbench.load_scenario("unimodal_slow", **alone)
    (episode,) = run_episode(world, "straight_line", seed=900_000)
    assert episode.outcome == "success"
    assert episode.steps * 0.2 < 1.1 * world.robots.travel + 1.0
