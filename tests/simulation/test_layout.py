"""Layouts: nothing overlaps, and a scenario without room says so."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.affinity import rotate, translate
from shapely.geometry import LineString, Point, box

from crowdbench import Scenario, ScenarioError
from crowdbench.scenario import NoRoomError
from crowdbench.scenario.room import PASSAGE
from crowdbench.simulation.layout import OBSTACLE_CLEARANCE, _place_discs, place

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
        (
            {"robots.count": 32, "robots.travel": 9.4},
            r"robot .* of 32 found no place .*\(robots\.travel, .* or robots\.count\)",
        ),
        ({"robots.goal_tolerance": 5, "robots.count": 4}, "robot .* of 4 found no place"),
    ],
)
def test_no_room_is_said_clearly(changes, complaint):
    with pytest.raises(ScenarioError, match=rf"'plain' has no room: .*{complaint}"):
        place(Scenario(name="plain").override(changes), 0)


def footprint(pose, scenario):
    """The robot's rectangle at a pose, by shapely."""
    x, y, heading = pose
    half = scenario.robots.length / 2, scenario.robots.width / 2
    rectangle = box(-half[0], -half[1], half[0], half[1])
    return translate(rotate(rectangle, heading, origin=(0, 0), use_radians=True), x, y)


LARGE = {
    "a long robot among obstacles": CORRIDOR.override(
        {"robots.length": 2.2, "robots.width": 0.9, "robots.travel": 8, "pedestrians.count": 2}
    ),
    "a robot in the narrowest corridor": CORRIDOR.override(
        {"arena.width": 1.5, "robots.length": 1.2, "robots.width": 0.9, "obstacles.count": 0,
         "pedestrians.count": 0}
    ),
    "a flat open arena": OPEN.override(
        {"arena.length": 16, "arena.width": 3, "pedestrians.count": 2, "robots.count": 2}
    ),
    "a robot across the diagonal": OPEN.override(
        {"robots.travel": 13, "robots.count": 1, "obstacles.count": 3}
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LARGE)
def test_robots_start_and_arrive_inside_the_arena_and_clear_of_everything(name):
    scenario = LARGE[name]
    half = scenario.arena.length / 2 + 1e-9, scenario.arena.width / 2 + 1e-9
    arena = box(-half[0], -half[1], half[0], half[1])
    for seed in range(60):
        layout = place(scenario, seed)
        obstacles = [Point(x, y).buffer(r) for x, y, r in layout.obstacles]
        for pose, goal in zip(layout.robot_pose, layout.robot_goal, strict=True):
            for turned in np.linspace(-np.pi, np.pi, 9):
                for place_ in (pose[:2], goal):
                    body = footprint((*place_, turned), scenario)
                    assert arena.covers(body)
                    assert not any(body.intersects(obstacle) for obstacle in obstacles)
            people = [Point(p).buffer(0.25) for p in layout.pedestrian_position]
            assert not any(footprint(pose, scenario).intersects(person) for person in people)


def test_a_wide_robot_can_pass_between_obstacles():
    scenario = CORRIDOR.override({"robots.width": 1.3, "arena.width": 5, "pedestrians.count": 0})
    for seed in range(40):
        discs = [Point(x, y).buffer(r) for x, y, r in place(scenario, seed).obstacles]
        gaps = [a.distance(b) for i, a in enumerate(discs) for b in discs[i + 1 :]]
        assert min(gaps) >= 1.3


@pytest.mark.parametrize(
    "scenario",
    [
        CORRIDOR.override({"robots.count": 5, "pedestrians.count": 3}),
        CORRIDOR.override({"robots.count": 3, "arena.width": 2, "obstacles.count": 0}),
        OPEN.override({"robots.count": 14, "pedestrians.count": 0}),
    ],
    ids=["corridor", "narrow corridor", "open"],
)
def test_several_robots_are_placed_where_there_is_room(scenario):
    apart = 0.5 + scenario.robots.goal_tolerance
    for seed in range(40):
        layout = place(scenario, seed)
        ends = np.vstack([layout.robot_pose[:, :2], layout.robot_goal])
        gaps = np.linalg.norm(ends[:, None] - ends[None], axis=2)
        assert (gaps[np.triu_indices(len(ends), 1)] > apart).all()
        half = np.array([scenario.arena.length, scenario.arena.width]) / 2 - 0.25
        assert (np.abs(ends) <= half + 1e-9).all()
        way = layout.robot_goal - layout.robot_pose[:, :2]
        along = way if scenario.arena.kind == "open" else way * [1, 0]
        np.testing.assert_allclose(np.linalg.norm(along, axis=1), scenario.robots.travel)


def test_a_narrow_corridor_is_not_closed_by_chance():
    scenario = CORRIDOR.override({"arena.width": 1.9, "obstacles.count": 3, "pedestrians.count": 0})
    for seed in range(20):
        for _, y, radius in place(scenario, seed).obstacles:
            assert 0.95 + abs(y) - radius >= PASSAGE


def test_a_seed_without_room_says_which_one_it_is_even_from_another_process():
    crowded = Scenario(name="full", pedestrians={"count": 400})
    with pytest.raises(NoRoomError, match="with seed 7") as caught:
        place(crowded, 7)
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.seed, str(again)) == (7, str(caught.value))


@given(seed=st.integers(0, 10**6), count=st.integers(1, 30), side=st.floats(0.1, 3.0))
@settings(deadline=None, max_examples=40)
def test_discs_are_placed_one_after_another_from_batches_of_places(seed, count, side):
    """Against the plain loop, with as many draws, also where there is no room for all."""
    ours, theirs = np.random.default_rng(seed), np.random.default_rng(seed)
    half = np.array([side, 1.5])
    discs = np.vstack([[[0.0, 0.0, 0.4]], np.full((count, 3), 0.25)])
    placed = _place_discs(ours, half, discs, 1)
    expected = [[0.0, 0.0, 0.4]]
    while len(expected) <= count:
        for _ in range(20):
            spots = theirs.uniform(-half, half, size=(64, 2))
            known = np.array(expected)
            gaps = np.linalg.norm(spots[:, None] - known[None, :, :2], axis=2)
            free = (gaps > known[:, 2] + 0.25).all(axis=1)
            if free.any():
                expected.append([*spots[np.argmax(free)], 0.25])
                break
        else:
            break
    assert placed == len(expected) - 1
    np.testing.assert_array_equal(discs[: placed + 1], expected)
    assert ours.random() == theirs.random()
