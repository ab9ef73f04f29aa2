"""Agents whose commands act late, on robots that speed up slowly and see from their front."""

import numpy as np
import pytest

import crowdbench
from crowdbench.evaluation.rollout import run_episode

AGENTS = ["straight_line", "orca", "dynamic_window", "neupan:exact=true"]
ROBOT = {
    "robots": {"latency": 2, "acceleration": (1.0, 3.0)},
    "lidar": {"mount": (0.2, 0.0, 0.5)},
}


@pytest.mark.parametrize("agent", AGENTS)
def test_they_drive_straight_where_nobody_is(agent):
    world = crowdbench.load_scenario("unimodal_slow", pedestrians={"count": 0}, **ROBOT)
    (episode,) = run_episode(world, agent, seed=900_000)
    assert episode.outcome == "success"
    # 30 degrees are the most that the first turn takes; who steers late goes on swinging.
    assert np.abs(np.diff(episode.robot_pose[:, 2])).sum() < np.pi / 6 + 0.2
    assert episode.steps * 0.2 < 8.0 + 3.0


@pytest.mark.parametrize("agent", AGENTS[1:])
def test_they_pass_obstacles_in_a_corridor(agent):
    world = crowdbench.load_scenario("corridor_sparse", **ROBOT)
    outcomes = [run_episode(world, agent, seed)[0].outcome for seed in (900_001, 900_002)]
    assert outcomes == ["success"] * 2


@pytest.mark.parametrize("agent", AGENTS[:2])
def test_an_omnidirectional_robot_does_not_swing_either(agent):
    robots = {**ROBOT["robots"], "drive": "omnidirectional"}
    world = crowdbench.load_scenario("unimodal_slow", pedestrians={"count": 0}, robots=robots)
    (episode,) = run_episode(world, agent, seed=900_000)
    assert episode.outcome == "success"
    way = np.linalg.norm(np.diff(episode.robot_pose[:, :2], axis=0), axis=1).sum()
    assert way < 8.0 + 0.1
