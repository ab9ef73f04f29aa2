"""Whom the informed agent is told of with a limited view."""

from __future__ import annotations

import numpy as np
import pytest
from crowdbench_agents.informed.agent import Informed
from crowdbench_agents.informed.view import hit_by_lidar, in_view, on_map, told_of

import crowdbench
from crowdbench import RobotSpec, Scenario
from crowdbench.simulation.lidar import beam_table, cast_rays

NOTHING, NO_WALLS = np.empty((0, 3)), np.empty((0, 4))
ANGLES = RobotSpec.from_scenario(Scenario(name="test")).lidar_angles
AT_ORIGIN = np.zeros(3)


def hit(discs, obstacles=NOTHING, walls=NO_WALLS, pose=AT_ORIGIN, reach=6.0):
    return hit_by_lidar(pose, ANGLES, reach, np.array(discs), obstacles, walls).tolist()


def test_a_person_behind_a_row_of_people_is_not_hit():
    row = [[2.0, y, 0.25] for y in (-0.45, 0.0, 0.45)]
    assert hit([*row, [4.0, 0.0, 0.25]]) == [True, True, True, False]
    assert hit([row[0], row[2], [4.0, 0.0, 0.25]]) == [True, True, True], "between the two"


def test_obstacles_and_walls_hide_people():
    person = [[3.0, 0.0, 0.25]]
    assert hit(person) == [True]
    assert hit(person, obstacles=np.array([[1.5, 0.0, 0.3]])) == [False]
    assert hit(person, walls=np.array([[1.5, -1.0, 1.5, 1.0]])) == [False]
    assert hit(person, walls=np.array([[1.5, 1.0, 1.5, 2.0]])) == [True]


def test_beams_end_at_their_range_and_those_not_there_are_not_hit():
    assert hit([[6.2, 0.0, 0.25]]) == [True], "its near side"
    assert hit([[6.3, 0.0, 0.25]]) == [False]
    assert hit([[2.0, 0.0, -1.0], [3.0, 0.0, 0.25]]) == [False, True]


def test_whoever_is_hit_is_what_a_scan_shows():
    """Without somebody who is hit the scan differs, without somebody else it does not."""
    rng = np.random.default_rng(3)
    beams, compared = beam_table(ANGLES), {True: 0, False: 0}

    def scan(discs, obstacles, walls, pose):
        out = np.empty(len(ANGLES), np.float32)
        nobody, standing = np.empty((0, 2)), np.vstack([discs, obstacles])
        cast_rays(pose, beams, nobody, standing, walls, 6.0, out)
        return out

    for _ in range(30):
        pose = rng.uniform([-1, -1, -np.pi], [1, 1, np.pi])
        discs = np.column_stack([rng.uniform(-6, 6, (12, 2)), np.full(12, 0.25)])
        discs = discs[np.hypot(*(discs[:, :2] - pose[:2]).T) > 0.3]
        obstacles = np.array([[*rng.uniform(2, 4, 2), 0.4]])
        walls = rng.uniform(-5, 5, (2, 4))
        whole = scan(discs, obstacles, walls, pose)
        for d, seen in enumerate(hit(discs, obstacles, walls, pose)):
            without = scan(np.delete(discs, d, axis=0), obstacles, walls, pose)
            assert seen == bool((without > whole + 1e-4).any())
            compared[seen] += 1
    assert min(compared.values()) > 50


@pytest.mark.parametrize(
    ("place", "inside"),
    [((3.9, 0.0), True), ((4.1, 0.0), False), ((-1.9, 0.0), True), ((-2.1, 0.0), False),
     ((0.0, 2.9), True), ((0.0, -3.1), False)],
)  # fmt: skip
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_a_map_of_six_metres_reaches_four_ahead(place, inside, heading):
    frame = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    places = (np.array([place]) @ frame) + [5.0, 7.0]
    assert on_map(np.array([5.0, 7.0, heading]), 6.0, places).tolist() == [inside]


def test_people_out_of_view_are_left_out_and_the_rest_stays():
    env = crowdbench.parallel_env("multimodal_fast", robots={"count": 2})
    env.reset(seed=900_000)
    state = env.state()
    limited = told_of(in_view(6.0, 0, env.robot_spec(), state), state)
    inside = on_map(state["robot_pose"][0], 6.0, state["pedestrian_position"])
    assert 0 < inside.sum() < len(inside)
    for name in state:
        expected = state[name][inside] if name.startswith("pedestrian_") else state[name]
        if name != "robot_active":
            np.testing.assert_array_equal(limited[name], expected)
    near = on_map(state["robot_pose"][0], 6.0, state["robot_pose"][1:, :2])
    assert limited["robot_active"].tolist() == [True, *near]
    assert state["robot_active"].all()


def test_whoever_is_in_view_counts_in_plans_and_nobody_else():
    """Somebody stands in the way, 5 m ahead: on a map of 9 m, but not on one of 6 m."""
    env = crowdbench.parallel_env("unimodal_slow", pedestrians={"count": 1})
    observations, _ = env.reset(seed=900_000)
    state = env.state()
    ahead = state["robot_goal"][0] - state["robot_pose"][0, :2]
    ahead /= np.hypot(*ahead)
    state["robot_pose"][0, 2] = np.arctan2(ahead[1], ahead[0])
    state["pedestrian_position"][0] = state["robot_pose"][0, :2] + 5.0 * ahead
    state["pedestrian_velocity"][:], state["pedestrian_speed"][:] = 0.0, 0.0
    lengths = {}
    for view in ("all", 9, 6):
        agent = Informed(view=view)
        agent.reset(env.robot_spec(), 0)
        agent.act(crowdbench.Observation(**observations["robot_0"], state=state))
        lengths[view] = np.abs(agent._plan[:, 1]).max()
    assert lengths["all"] == lengths[9] > 0.1
    assert lengths[6] == 0.0
