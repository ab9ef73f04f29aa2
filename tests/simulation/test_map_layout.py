"""Layouts on maps: who begins where, and which places cannot be."""

from __future__ import annotations

import re

import numpy as np
import pytest
import shapely
from map_scenarios import BORDER, HALL, PILLARS, hall

from crowdbench.scenario import NoRoomError, ScenarioError, load_scenario
from crowdbench.simulation.layout import OBSTACLE_CLEARANCE, place
from crowdbench.simulation.map_layout import places_of, robot_clearance
from crowdbench.simulation.routes import routes_of

PILLAR_SHAPES = [shapely.Polygon(pillar) for pillar in PILLARS]


NEAR_8 = [7.5, -1, 8.5, 1]
"""A region all of which is near (8, 0)."""


def solids(scenario):
    lines = [shapely.LineString([wall[:2], wall[2:]]) for wall in scenario.arena.walls]
    return shapely.union_all([*lines, *map(shapely.Polygon, scenario.arena.polygons)])


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"robots__count": 3, "obstacles__count": 2},
        {"pedestrians__radius": 0.4, "robots__length": 1.0, "robots__width": 0.6},
    ],
)
def test_nobody_overlaps_anything_and_robots_are_where_regions_say(changes):
    scenario = hall(pedestrians__count=15, **changes)
    places, walls = places_of(scenario), solids(scenario)
    radius = np.hypot(scenario.robots.length, scenario.robots.width) / 2
    for seed in range(12):
        layout = place(scenario, seed, places)
        starts, goals = layout.robot_pose[:, :2], layout.robot_goal
        assert ((starts >= [-9, -5]) & (starts <= [-7, 5])).all()
        assert ((goals >= [7, -5]) & (goals <= [9, 5])).all()
        people = [(*p, scenario.pedestrians.radius) for p in layout.pedestrian_position]
        robots = [(*start, radius + 0.1) for start in starts]
        discs = [shapely.Point(x, y).buffer(r) for x, y, r in [*people, *robots, *layout.obstacles]]
        for i, disc in enumerate(discs):
            assert not disc.intersects(walls)
            assert not any(disc.intersects(other) for other in discs[i + 1 :])
        for x, y, r in layout.obstacles:
            ends = shapely.points(np.vstack([starts, goals]))
            assert (shapely.distance(shapely.Point(x, y), ends) - r).min() >= OBSTACLE_CLEARANCE
            assert shapely.distance(shapely.Point(x, y), walls) - r >= 0.9


def test_a_robot_faces_the_first_turn_of_its_way():
    scenario = hall(robots__start=[-1, -5], robots__goal=[1, -5], pedestrians__count=0)
    layout = place(scenario, 0)
    # The way leads up to the gap in the middle, y = -1, not through the wall to the right.
    off = layout.robot_pose[0, 2] - np.pi / 2
    assert abs(off) < np.pi / 6 + np.arctan(1 / 4)
    assert layout.robot_pose[0, :2].tolist() == [-1, -5]
    assert layout.robot_goal[0].tolist() == [1, -5]


def test_a_region_may_lie_over_a_pillar():
    around = [-5.6, -3.6, -4.2, -2.4]
    scenario = hall(arena__regions={**HALL["arena.regions"], "around": around})
    scenario = scenario.override({"robots.start": "around", "robots.length": 0.2})
    places = places_of(scenario)
    for seed in range(20):
        start = shapely.Point(place(scenario, seed, places).robot_pose[0, :2])
        assert min(start.distance(shape) for shape in PILLAR_SHAPES) >= 0.18 + 0.1 - 1e-9


def test_nobody_is_where_nobody_can_walk_to():
    shut = [[3, 2, 6, 2], [6, 2, 6, 5], [6, 5, 3, 5], [3, 5, 3, 2]]  # a room without a door
    scenario = hall(arena__walls=[*BORDER, *shut], arena__polygons=[], pedestrians__count=20)
    places = places_of(scenario)
    for seed in range(10):
        position = place(scenario, seed, places).pedestrian_position
        assert not ((position > [3, 2]) & (position < [6, 5])).all(axis=1).any()


def test_regions_serve_in_open_arenas_and_corridors_too():
    regions = {"arena.regions": {"a": [-4, -1, -3, 1], "b": [3, -1, 4, 1]}}
    for name in ("multimodal_fast", "corridor_dense"):
        scenario = load_scenario(name, **regions, **{"robots.start": "b", "robots.goal": "a"})
        layout = place(scenario, 0)
        assert 3 <= layout.robot_pose[0, 0] <= 4
        assert -4 <= layout.robot_goal[0, 0] <= -3
        assert len(layout.walls) == (2 if name == "corridor_dense" else 0)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            {"arena__regions__west": [-9.9, -5, -9.7, 5]},
            "robots.start: the region 'west' has no room for a robot; allowed: with a place in "
            "it, 0.15 m wide, at least 0.35 m from walls",
        ),
        (
            {"arena__regions__west": [-8, -2, -7.97, 2]},  # thinner than a cell
            "robots.start: the region 'west' has no room for a robot; allowed: with a place in "
            "it, 0.15 m wide, at least",
        ),
        (
            {"arena__regions__east": [4.8, -3.2, 5.2, -2.8]},  # within a pillar
            "robots.goal: the region 'east' has no room for a robot",
        ),
        (
            {"robots__start": [-9.8, 0]},
            "robots.start: (-9.8, 0) is too near to a wall, a polygon or the border; allowed: at "
            "least 0.35 m away",
        ),
        ({"robots__goal": [5, 3]}, "robots.goal: (5, 3) is too near"),
        (
            {"arena__walls": [*BORDER, [0, -6, 0, 6]]},
            "robots.goal: no way leads to region 'east' from region 'west' (robots.start); "
            "allowed: passages at least 0.80 m wide",
        ),
        (
            {"arena__walls": [*BORDER, [0, -6, 0, -0.3], [0, 0.3, 0, 6]]},
            "robots.goal: no way leads to",
        ),
        ({"robots__length": 2, "robots__width": 1.5}, "passages at least 2.80 m wide"),
        (
            {
                "arena__walls": [*BORDER, *([-10, y, 10, y] for y in (-3, 0, 3))],
                "arena__polygons": [],
                "pedestrians__radius": 1.6,
            },
            "pedestrians.radius: 1.6 m leaves no room",
        ),
        (
            {"arena__regions": {"west": [-1, 3, -0.4, 3.4], "east": [-1, 3.1, -0.4, 3.5]}},
            "robots.goal: all of region 'east' is within 0.78 m of region 'west' (robots.start); "
            "allowed: places more than 0.8 m apart",
        ),
        (
            {"pedestrians__queues": [{"head": [8, 0], "count": 1}], "arena__regions__east": NEAR_8},
            "robots.goal: region 'east' has no room for a robot away from people in line "
            "(pedestrians.queues); allowed: somewhere in it more than 1.5 m from their places",
        ),
    ],
)
def test_places_that_no_seed_can_use_are_refused_with_what_is_allowed(changes, told):
    with pytest.raises(ScenarioError) as caught:
        places_of(hall(**changes))
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            {"pedestrians__count": 500, "pedestrians__radius": 0.4},
            r"pedestrian .* of 500 found no .*\(pedestrians\.count, pedestrians\.radius or pede",
        ),
        (
            {"robots__count": 30},
            r"robot .* of 30 found no place .*\(robots\.start, robots\.goal, .* or robots\.count\)",
        ),
        (
            {"obstacles__count": 60},
            r"obstacle .* of 60 found no place .*\(obstacles\.count or ",
        ),
    ],
)
def test_no_room_is_said_with_the_seed(changes, told):
    with pytest.raises(NoRoomError, match=told) as caught:
        place(hall(**changes), 3)
    assert caught.value.seed == 3


@pytest.mark.parametrize("streams", [[], [{"start": "low", "goal": "high", "share": 0.3}]])
def test_nobody_stands_where_a_robot_or_a_stream_would_be_shut_in(streams):
    low, high = [-3, -1, -2, 1], [2, -1, 3, 1]
    robots = {"start": [-2.5, 0], "goal": [2.5, 0]} if not streams else {}
    scenario = hall(
        arena__length=6,
        arena__width=3,
        arena__walls=[[0, -1.5, 0, -0.55], [0, 0.55, 0, 1.5]],
        arena__polygons=[],
        arena__regions={"west": low, "east": low, "low": low, "high": high},
        robots=robots,
        pedestrians={"count": 3, "standing": 0.7, "spawn_clearance": 0.1, "streams": streams},
    )
    ground = places_of(scenario).ground
    width = scenario.pedestrians.radii[1] if streams else robot_clearance(scenario)
    for seed in range(20):
        layout = place(scenario, seed)
        stands = layout.traits.standing
        discs = np.column_stack([layout.pedestrian_position, layout.traits.radius])[stands]
        solid = shapely.union_all(
            [shapely.LineString(np.reshape(wall, (2, 2))).buffer(width) for wall in layout.walls]
            + [shapely.Point(x, y).buffer(width + radius) for x, y, radius in discs]
        )
        free = shapely.box(*ground.bounds).buffer(-width).difference(solid.buffer(-0.08))
        parts = shapely.get_parts(free)
        ends = [shapely.box(*low), shapely.box(*high)]
        assert any(part.intersects(ends[0]) and part.intersects(ends[1]) for part in parts)


@pytest.mark.parametrize("turn", [0.0, 10.0, 45.0])
@pytest.mark.parametrize("off", [0.0, 0.01, 0.025])
def test_passages_as_wide_as_a_refusal_says_are_passed_by_robots_and_people(turn, off):
    def with_passage(width, **changes):
        direction = np.array([-np.sin(np.deg2rad(turn)), np.cos(np.deg2rad(turn))])
        far, near = 20 * direction, width / 2 * direction
        walls = [[off, 0, off, 0] + np.concatenate(k) for k in ([-far, -near], [near, far])]
        changes = {"arena__walls": [*BORDER, *(wall.tolist() for wall in walls)], **changes}
        return hall(**changes, arena__polygons=[])

    with pytest.raises(ScenarioError, match="no way leads to") as told:
        places_of(with_passage(0.6))
    width = float(re.search(r"at least ([\d.]+) m wide", str(told.value))[1])
    assert places_of(with_passage(width)).starts.corner.size
    stream = {"pedestrians__streams": [{"start": "west", "goal": "east"}], "robots__goal": [-6, 0]}
    with pytest.raises(ScenarioError, match="no way leads to") as told:
        routes_of(with_passage(0.4, **stream))
    width = float(re.search(r"passages ([\d.]+) m wide", str(told.value))[1])
    assert routes_of(with_passage(width, **stream)).regions.streams[0, 1] == 1
