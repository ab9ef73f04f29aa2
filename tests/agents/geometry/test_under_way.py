"""Commands that do not act yet, against the simulation and by hand."""

import dataclasses

import numpy as np
import pytest
from crowdbench_agents.geometry.under_way import CommandsUnderWay, drive_ahead, into_frame, relative

import crowdbench

SPEC = crowdbench.RobotSpec.from_scenario(crowdbench.Scenario(name="test"))


def observation(velocity=(0.0, 0.0), goal=(4.0, 1.0), pose=(0.0, 0.0, 0.0)):
    parts = (np.array(part, np.float32) for part in (velocity, goal, pose))
    return crowdbench.Observation(np.full(180, 6.0, np.float32), *parts)


@pytest.mark.parametrize("drive", ["differential", "omnidirectional"])
@pytest.mark.parametrize("acceleration", [None, (1.0, 3.0)])
def test_what_is_driven_ahead_is_what_the_simulation_does(drive, acceleration):
    env = crowdbench.parallel_env(
        "multimodal_fast",
        pedestrians={"count": 0},
        robots={"drive": drive, "acceleration": acceleration},
    )
    env.reset(seed=3)
    rng = np.random.default_rng(0)
    commands = rng.uniform([0.0, -1.0], [1.0, 1.0], (12, 2))
    pose, velocity = env.state()["robot_pose"][0], env.state()["robot_velocity"][0]
    pose, velocity = drive_ahead(env.robot_spec(), pose, velocity, commands)
    for command in commands:
        env.step({"robot_0": command})
    np.testing.assert_allclose(pose, env.state()["robot_pose"][0], atol=1e-9)
    np.testing.assert_array_equal(velocity, env.state()["robot_velocity"][0])


def test_many_robots_are_driven_ahead_as_each_by_itself():
    rng = np.random.default_rng(1)
    pose, velocity = rng.normal(size=(3, 4, 3)), rng.uniform(0, 1, (3, 4, 2))
    commands = rng.uniform(-1, 1, (3, 4, 2, 2))
    poses, velocities = drive_ahead(SPEC, pose, velocity, commands)
    for index in np.ndindex(3, 4):
        one = drive_ahead(SPEC, pose[index], velocity[index], commands[index])
        np.testing.assert_array_equal(one[0], poses[index])
        np.testing.assert_array_equal(one[1], velocities[index])


def test_without_latency_what_is_foreseen_is_what_is_observed():
    under_way = CommandsUnderWay(SPEC)
    seen = observation(velocity=(0.7, -0.2))
    assert under_way.send((1.0, 0.3)) == (1.0, 0.3)
    assert under_way.foresee(seen) is seen
    assert under_way.time == 0.0


def test_before_the_first_command_acts_the_robot_stands():
    under_way = CommandsUnderWay(dataclasses.replace(SPEC, latency=2))
    for part in ("pose", "velocity", "goal"):
        foreseen = getattr(under_way.foresee(observation()), part)
        np.testing.assert_array_equal(foreseen, getattr(observation(), part))
    assert under_way.time == pytest.approx(0.4)


def test_commands_under_way_move_pose_velocity_and_goal():
    under_way = CommandsUnderWay(dataclasses.replace(SPEC, latency=2))
    under_way.send((9.0, 0.0))  # as fast as it can, 1 m/s
    under_way.send((0.0, 1.0))
    seen = under_way.foresee(observation(goal=(1.2, 1.0), pose=(2.0, 3.0, np.pi / 2)))
    # 0.2 m ahead, along y, then 0.2 rad to the left on the spot.
    np.testing.assert_allclose(seen.pose, [2.0, 3.2, np.pi / 2 + 0.2], atol=1e-6)
    np.testing.assert_array_equal(seen.velocity, [0.0, 1.0])
    c, s = np.cos(0.2), np.sin(0.2)
    np.testing.assert_allclose(seen.goal, [c + s, c - s], atol=1e-6)
    under_way.send((0.5, 0.0))
    np.testing.assert_array_equal(under_way.commands, [[0.0, 1.0], [0.5, 0.0]])


def test_a_pose_seen_from_another_is_found_again_from_there():
    rng = np.random.default_rng(2)
    here, there = rng.normal(size=(2, 3))
    x, y, turn = relative(here, there)
    points = rng.normal(size=(5, 2))
    by_steps = into_frame(into_frame(points, here), np.array([x, y, turn]))
    np.testing.assert_allclose(by_steps, into_frame(points, there), atol=1e-12)
