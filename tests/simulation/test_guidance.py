"""On a map, robots see a point ahead on the shortest path, and progress is counted along it."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from map_scenarios import BORDER, hall

import crowdbench
from crowdbench.evaluation.rollout import run_episode
from crowdbench.evaluation.shortest_path import shortest_path
from crowdbench.simulation.map_layout import places_of
from crowdbench.simulation.walls import walls_of

DOORWAY = [*BORDER, [0, -6, 0, -0.45], [0, 0.45, 0, 6]]
MAZE = [*BORDER, [-4, -6, -4, 4], [0, -4, 0, 6], [4, -6, 4, 4], [-4, 1, -2, 1], [2, -1, 4, -1]]
ALONE = hall(arena__walls=MAZE, arena__polygons=[], pedestrians__count=0)
RADIUS, CLEARANCE = 0.25, 0.35  # of the circle around the footprint, and with the wall's distance
NOTHING = np.empty((0, 3))


def world_of(pose, point):
    """A point in the robot's frame, in the world."""
    x, y, heading = pose
    cosine, sine = np.cos(heading), np.sin(heading)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    return np.array([x, y]) + turn @ np.asarray(point, dtype=float)


def begin(scenario, seed=0):
    env = crowdbench.parallel_env(scenario)
    seen, _ = env.reset(seed=seed)
    return env, seen


def drive(scenario, seed, agent="straight_line"):
    """States and observations of an episode."""
    planner = crowdbench.AgentSpec.parse(agent).make()
    env, seen = begin(scenario, seed)
    planner.reset(env.robot_spec(), seed)
    log = []
    while env.agents:
        log.append((env.state(), seen["robot_0"]))
        action = planner.act(crowdbench.Observation(**seen["robot_0"]))
        seen, _, _, _, infos = env.step({"robot_0": action})
        log[-1] += (infos["robot_0"],)
    return log


@pytest.mark.parametrize(("goal", "ahead"), [([-3, 0], [3, 0]), ([-5, 0], [2, 0])])
def test_in_sight_it_is_the_goal_or_a_point_on_the_way_there(goal, ahead):
    scenario = hall(robots__start=[-7, 0], robots__goal=goal, pedestrians__count=0)
    env, seen = begin(scenario)
    point = world_of(env.state()["robot_pose"][0], seen["robot_0"]["goal"])
    np.testing.assert_allclose(point, np.array([-7, 0]) + ahead, atol=1e-6)


def test_around_a_wall_it_is_at_the_turn_and_never_behind_the_wall():
    scenario = hall(robots__start=[-1, -5], robots__goal=[1, -5], pedestrians__count=0)
    env, seen = begin(scenario.override({"robots.look_ahead": 20.0}))
    start, point = (
        np.array([-1, -5]),
        world_of(env.state()["robot_pose"][0], seen["robot_0"]["goal"]),
    )
    # The wall's end is (0, -1); around it a path turns in a circle of 0.35 m, or a little farther.
    assert (
        CLEARANCE - 1e-6 <= np.linalg.norm(point - [0, -1]) <= CLEARANCE / np.cos(np.pi / 8) + 0.1
    )
    assert shapely.LineString([start, point]).distance(shapely.Point(0, -1)) >= RADIUS - 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_the_point_ahead_is_within_reach_and_can_be_driven_to_straight(seed):
    walls = [shapely.LineString([wall[:2], wall[2:]]) for wall in walls_of(ALONE)]
    turned = 0
    for state, seen, _ in drive(ALONE, seed):
        place, goal = state["robot_pose"][0, :2], state["robot_goal"][0]
        point = world_of(state["robot_pose"][0], seen["goal"])
        assert np.linalg.norm(point - place) <= 3.0 + 1e-5
        line = shapely.LineString([place, point])
        gaps = shapely.distance(line, walls)
        own = shapely.distance(shapely.Point(place), walls)
        assert (gaps >= np.minimum(own, RADIUS) - 1e-5).all()
        turned += abs(np.cross([*(point - place), 0], [*(goal - place), 0])[2]) > 0.1
    assert turned > 10


@pytest.mark.parametrize("seed", range(3))
def test_progress_adds_up_to_the_shortest_path(seed):
    scenario = ALONE.override({"robots.look_ahead": 1.5})
    log = drive(scenario, seed)
    progress = (
        sum(info["reward_terms"]["goal"] for _, _, info in log[:-1]) / scenario.reward.progress
    )
    first, last = log[0][0], log[-1][0]
    walls, goal = walls_of(scenario), first["robot_goal"][0]
    lengths = [
        shortest_path(state["robot_pose"][0, :2], goal, walls, NOTHING, CLEARANCE)
        for state in (first, last)
    ]
    # Ways turn around corners in straight pieces, 5.5 % longer than arcs.
    assert progress == pytest.approx(lengths[0] - lengths[1], abs=0.15)
    assert progress > 1.02 * (
        np.linalg.norm(goal - first["robot_pose"][0, :2])
        - np.linalg.norm(goal - last["robot_pose"][0, :2])
    )
    assert log[-1][2]["reward_terms"]["goal"] == scenario.reward.arrival


def test_the_robots_specification_says_the_goal_in_the_frame_of_its_odometry():
    env, _ = begin(hall(robots__count=2, pedestrians__count=3), seed=4)
    state = env.state()
    for r in range(2):
        spec = env.robot_spec(f"robot_{r}")
        np.testing.assert_allclose(
            world_of(state["robot_pose"][r], spec.goal), state["robot_goal"][r], atol=1e-9
        )
    assert crowdbench.RobotSpec.from_scenario(ALONE).goal is None


def test_open_arenas_keep_their_goal_even_with_regions():
    regions = {"arena.regions": {"a": [-4, -1, -3, 1], "b": [3, -1, 4, 1]}}
    ends = {"robots.start": "b", "robots.goal": "a"}
    env, seen = begin(crowdbench.load_scenario("multimodal_fast", **regions, **ends))
    state = env.state()
    point = world_of(state["robot_pose"][0], seen["robot_0"]["goal"])
    np.testing.assert_allclose(point, state["robot_goal"][0], atol=1e-5)


@pytest.mark.parametrize("walls", [DOORWAY, MAZE])
def test_who_follows_the_points_blindly_arrives_where_nobody_walks(walls):
    scenario = hall(arena__walls=walls, arena__polygons=[], pedestrians__count=0)
    for seed in range(4):
        (episode,) = run_episode(scenario, "straight_line", seed)
        assert episode.outcome == "success"


def test_a_robot_in_a_dead_end_is_not_led_through_a_slit_in_its_back():
    # The dead end is 0.62 m wide, the slit 0.12 m, the robot 0.3 m.
    dead_end = [[-1.5, -0.25, 0, -0.25], [-1.5, 0.37, 0, 0.37], [0, -6, 0, 0], [0, 0.12, 0, 5]]
    scenario = hall(arena__walls=[*BORDER, *dead_end], arena__polygons=[], pedestrians__count=0)
    ways, goal = places_of(scenario).ways, np.array([5.0, 0.0])
    assert ways.length(np.array([-0.36, -0.03]), goal) > 12.0
