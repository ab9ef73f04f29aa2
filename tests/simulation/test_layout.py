"""Layouts: nothing overlaps, and a scenario without room says so."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, Point

from crowdbench import Scenario, ScenarioError
from crowdbench.simulation.layout import OBSTACLE_CLEARANCE, PASSAGE, place

CORRIDOR = Scenario(
    name="corridor",
    arena={"kind": "corridor", "length": 12, "width": 4},
    robots={"travel": 10},
    obstacles={"count": 4},
    pedestrians={"count": 6},
)
OPEN = Scenario(name="open", robots={"count": 3}, pedestrians={"count": 9, "reactive": 0.5})


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), scenario=st.sampled_from([CORRIDOR, OPEN]))
def test_nothing_overlaps(seed, scenario):
    layout = place(scenario, seed)
    people = [Point(p).buffer(0.25) for p in layout.pedestrian_position]
    obstacles = [Point(x, y).buffer(r) for x, y, r in layout.obstacles]
    robots = [Point(x, y).buffer(0.25) for x, y, _ in layout.robot_pose]
    walls = [LineString([w[:2], w[2:]]) for w in layout.walls]
    bodies = people + obstacles + robots + walls
    for i, first in enumerate(bodies):
        for second in bodies[i + 1 :]:
            assert not (first.intersects(second)) or (first in walls and second in walls)
    for robot in robots:
        assert all(robot.distance(p) >= scenario.pedestrians.spawn_clearance - 1e-3 for p in people)
    ends = [Point(x, y) for x, y, _ in layout.robot_pose] + [Point(g) for g in layout.robot_goal]
    assert all(o.distance(e) >= OBSTACLE_CLEARANCE - 1e-3 for o in obstacles for e in ends)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_the_corridor_is_never_closed_by_obstacles(seed):
    layout = place(CORRIDOR, seed)
    discs = [Point(x, y).buffer(r) for x, y, r in layout.obstacles]
    for i, disc in enumerate(discs):
        assert all(disc.distance(other) >= PASSAGE - 1e-3 for other in discs[i + 1 :])
        assert max(disc.bounds[1] + 2, 2 - disc.bounds[3]) >= PASSAGE - 1e-3


@pytest.mark.parametrize("scenario", [CORRIDOR, OPEN])
def test_the_goal_is_a_travel_away_and_roughly_ahead(scenario):
    for seed in range(20):
        layout = place(scenario, seed)
        way = layout.robot_goal - layout.robot_pose[:, :2]
        along = way if scenario is OPEN else way * [1, 0]
        np.testing.assert_allclose(np.linalg.norm(along, axis=1), scenario.robots.travel)
        off = np.arctan2(way[:, 1], way[:, 0]) - layout.robot_pose[:, 2]
        assert (np.cos(off) >= np.cos(np.pi / 6) - 1e-9).all()


def test_the_reactive_share_is_exact():
    shares = {int(place(OPEN, seed).pedestrian_reactive.sum()) for seed in range(20)}
    assert shares == {round(0.5 * 9)}


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"pedestrians.count": 500}, "pedestrian .* of 500 found no place in 10 x 10 m"),
        ({"obstacles.count": 100}, "obstacle .* of 100 found no place"),
        ({"arena.kind": "corridor", "robots.travel": 12.0}, "robots.travel = 12 m does not fit"),
        ({"robots.count": 32, "robots.travel": 0.5}, "robot .* of 32 found no place"),
        ({"arena.width": 0.4}, "found no place"),
    ],
)
def test_no_room_is_said_clearly(changes, complaint):
    with pytest.raises(ScenarioError, match=rf"'plain' has no room: .*{complaint}"):
        place(Scenario(name="plain").override(changes), 0)
