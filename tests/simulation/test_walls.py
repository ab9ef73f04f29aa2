"""Nobody gets through a wall, however thin: neither robots nor people."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from map_scenarios import BORDER, ROOMS, hall

import crowdbench
from crowdbench import Scenario
from crowdbench.simulation.walls import walls_of

PEOPLE = Scenario(name="people", pedestrians={"count": 8, "speed": [0.5, 2.0]}).override(ROOMS)


def test_edges_of_polygons_follow_the_walls():
    scenario = hall(arena__polygons=[[[0, 0], [1, 0], [0, 2]]])
    walls = walls_of(scenario)
    assert walls[: len(scenario.arena.walls)].tolist() == [list(w) for w in scenario.arena.walls]
    assert walls[-3:].tolist() == [[0, 0, 1, 0], [1, 0, 0, 2], [0, 2, 0, 0]]


@settings(max_examples=25, deadline=None)
@given(
    x=st.floats(-4, 4),
    slope=st.floats(-2, 2),
    speed=st.sampled_from([1.0, 5.0]),
    size=st.sampled_from([(0.4, 0.3), (0.1, 0.05)]),
)
def test_a_robot_that_drives_at_a_wall_touches_it_and_stays_on_its_side(x, slope, speed, size):
    # From side to side but for a gap at the top, which the robot does not head for.
    wall = [x - 6 * slope / 4, -6, x + 4.5 * slope / 4, 4.5]
    scenario = hall(
        arena__walls=[*BORDER, wall],
        arena__polygons=[],
        robots__start=[-9, -1],
        robots__goal=[9, 0],
        robots__speed=[0, speed],
        robots__length=size[0],
        robots__width=size[1],
        robots__goal_tolerance=1,
        pedestrians__count=0,
    )
    env = crowdbench.parallel_env(scenario)
    env.reset(seed=0)
    line, info, place = shapely.LineString([wall[:2], wall[2:]]), {}, np.array([-9.0, -1.0])
    while env.agents:
        _, _, _, _, infos = env.step({"robot_0": (speed, 0.0)})
        moved = shapely.LineString([place, env.state()["robot_pose"][0, :2]])
        assert not moved.crosses(line)
        place, info = env.state()["robot_pose"][0, :2], infos["robot_0"]
    assert info["outcome"] == "collision"
    assert info["contact"].kind == "wall"


@pytest.mark.parametrize(
    "outside",
    [
        {"arena__walls": [[-12, -6, -12, 6]], "arena__polygons": []},
        {"arena__walls": [], "arena__polygons": [[[-13, -6], [-12, -6], [-12, 6], [-13, 6]]]},
    ],
    ids=["wall", "polygon"],
)
def test_what_lies_outside_the_area_is_seen_and_run_into(outside):
    ends = {"robots__start": [-9, 0], "robots__goal": [9, 0], "robots__speed": [-1, 1]}
    env = crowdbench.parallel_env(hall(**outside, **ends, pedestrians__count=0))
    observations, infos = env.reset(seed=0)
    assert observations["robot_0"]["lidar"].min() == pytest.approx(3.0, abs=0.01)
    while env.agents:
        *_, infos = env.step({"robot_0": (-1.0, 0.0)})
    assert infos["robot_0"]["contact"].kind == "wall"
    assert env.state()["robot_pose"][0, 0] < env.state()["bounds"][0] == -10


@pytest.mark.parametrize("model", ["straight", "orca", "social_force"])
def test_people_stay_on_their_side_of_every_wall(model):
    scenario = PEOPLE.override({"pedestrians.model": model})
    env = crowdbench.parallel_env(scenario)
    walls = shapely.union_all([shapely.LineString([w[:2], w[2:]]) for w in walls_of(scenario)])
    for seed in range(6):
        env.reset(seed=seed)
        before = env.state()["pedestrian_position"]
        while env.agents:
            env.step({"robot_0": (0.0, 0.0)})
            after = env.state()["pedestrian_position"]
            moves = shapely.linestrings(np.stack([before, after], axis=1))
            assert not shapely.intersects(moves, walls).any()
            # Who is pushed sinks in by less than half of the smallest body's extent.
            assert shapely.distance(shapely.points(after), walls).min() > 0.25 - 0.12
            before = after
