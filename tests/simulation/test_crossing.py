"""Where robots cross a recording: in the open and on maps, across, along and as they are told."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
import shapely
from crossings import crossing, standing, walking

from crowdbench import ScenarioError
from crowdbench.people import read_recording
from crowdbench.people.saved import save
from crowdbench.simulation.crossing import NEAR, free_distance, main_direction
from crowdbench.simulation.env import CrowdEnv
from crowdbench.simulation.layout import place

HALL = {
    "arena": {
        "kind": "map",
        "length": 14.0,
        "width": 10.0,
        "centre": [0.0, 0.0],
        "walls": [[-7, -4.5, 7, -4.5], [-7, 4.5, 7, 4.5]],
        "polygons": [[[2.0, 2.0], [3.0, 2.0], [3.0, 3.0], [2.0, 3.0]]],
        "regions": {"south": [-2, -4, 2, -2.5], "north": [-2, 2.5, 1.5, 4], "on": [-4, -1, 4, 1]},
    }
}
"""A hall of 9 m with a pillar, in which people walk along x in the middle."""
ENDS = {"robots.start": "south", "robots.goal": "north"}


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "walk.csv"
    path.write_text(walking())
    return path


def solids(scenario):
    shapes = [shapely.LineString(np.reshape(wall, (2, 2))) for wall in scenario.arena.walls]
    return shapely.union_all([*shapes, *map(shapely.Polygon, scenario.arena.polygons)])


@pytest.mark.parametrize("arena", [{}, HALL], ids=["open", "map"])
@pytest.mark.parametrize("route, angle", [("across", math.pi / 2), ("along", 0.0)])
def test_a_way_leads_across_the_people_or_along_them(recording, arena, route, angle):
    scenario = crossing(recording, **arena, **{"pedestrians.recording.route": route})
    begin_angles = []
    for seed in range(8):
        layout = place(scenario, seed)
        start, goal = layout.robot_pose[0, :2], layout.robot_goal[0]
        x, y = goal - start
        turned = math.remainder(math.atan2(y, x) - angle, math.pi)
        begin_angles.append(math.atan2(y, x))
        assert abs(turned) <= math.pi / 12 + 0.02  # people do not walk straight along x either
        assert math.hypot(x, y) <= 6.0 + 1e-9
        way = shapely.LineString([start, goal])
        assert solids(scenario).distance(way) >= 0.25 + 0.1 - 0.021 or not arena
    assert np.ptp(np.cos(np.array(begin_angles) - angle)) > 1.9  # both ways
    if arena:
        x_min, y_min, x_max, y_max = scenario.arena.bounds
        assert shapely.box(x_min + 0.25, y_min + 0.25, x_max - 0.25, y_max - 0.25).contains(way)


@pytest.mark.parametrize("kind", ["open", "map"])
def test_a_robot_begins_and_ends_where_it_is_told(recording, kind):
    regions = HALL["arena"]["regions"]
    if kind == "open":
        regions = {"south": [-2, -3.9, 2, -2.5], "north": [-2, 2.5, 1.5, 3.9]}
    arena = HALL["arena"] if kind == "map" else {"regions": regions}
    scenario = crossing(recording, arena=arena, **ENDS)
    poses = []
    for seed in range(5):
        layout = place(scenario, seed)
        assert shapely.box(*regions["south"]).contains(shapely.Point(layout.robot_pose[0, :2]))
        assert shapely.box(*regions["north"]).contains(shapely.Point(layout.robot_goal[0]))
        ahead = layout.robot_goal[0] - layout.robot_pose[0, :2]
        facing = layout.robot_pose[0, 2] - math.atan2(ahead[1], ahead[0])
        assert abs(math.remainder(facing, math.tau)) < math.pi / 4
        poses.append(layout.robot_pose[0])
    assert len({pose.tobytes() for pose in poses}) == 5
    points = {"robots.start": [0.0, -3.0], "robots.goal": [1.0, 3.0]}
    layout = place(crossing(recording, arena=arena, **points), 0)
    assert layout.robot_pose[0, :2].tolist() == [0.0, -3.0]
    assert layout.robot_goal[0].tolist() == [1.0, 3.0]


def test_a_map_has_the_coordinates_of_the_recording(recording):
    moved = {**HALL["arena"], "centre": [-3.0, 1.0], "regions": {}}
    layout = place(crossing(recording, arena=moved), 3)
    there = np.isfinite(layout.tracks.position[..., 0])
    x, y = layout.tracks.position[there].T
    np.testing.assert_allclose(np.minimum(abs(y), abs(y - 0.6)), abs(0.05 * np.sin(x)), atol=0.05)
    low, high = read_recording(recording).extent
    assert (x >= low[0]).all() and (x <= high[0]).all()
    walls = np.array(moved["walls"], dtype=float)
    np.testing.assert_array_equal(layout.walls[:2], walls)


def test_somebody_crosses_the_way_that_was_given(recording):
    scenario = crossing(recording, **HALL, **ENDS)
    for seed in range(5):
        layout = place(scenario, seed)
        way = shapely.LineString([layout.robot_pose[0, :2], layout.robot_goal[0]])
        needed = 2 * way.length  # at 1 m/s
        seen = layout.tracks.position[: int(needed / 0.2) + 1].reshape(-1, 2)
        seen = seen[np.isfinite(seen[:, 0])]
        assert shapely.distance(way, shapely.points(seen)).min() <= NEAR + 0.1


def test_a_robot_is_led_around_a_pillar_to_a_goal_that_it_is_told(recording):
    ends = {"robots.start": [2.5, 3.6], "robots.goal": [2.5, -3.0]}
    env = CrowdEnv(crossing(recording, **HALL, **ends))
    observations, _ = env.reset(seed=0)
    pose, ahead = env.state()["robot_pose"][0], observations["robot_0"]["goal"]
    turn = np.array(
        [[math.cos(pose[2]), -math.sin(pose[2])], [math.sin(pose[2]), math.cos(pose[2])]]
    )
    seen = shapely.LineString([pose[:2], pose[:2] + turn @ ahead])
    assert solids(env.scenario).distance(seen) > 0.2
    assert seen.length < 3.0 + 1e-6


def test_a_recording_beside_the_map_is_refused(recording):
    aside = {**HALL["arena"], "centre": [100.0, 0.0], "walls": [], "polygons": [], "regions": {}}
    with pytest.raises(ScenarioError, match=r"everybody walks outside of the map, within x -6 to"):
        crossing(recording, arena=aside)


def test_who_walks_through_a_wall_is_told_of_and_walks_on(recording):
    arena = {**HALL["arena"], "walls": [*HALL["arena"]["walls"], [1.0, 0.3, 1.0, 2.0]]}
    with pytest.warns(
        UserWarning, match=r"3 of 6 recorded people walk through walls or solids, fi"
    ):
        scenario = crossing(recording, arena=arena)
    x = place(scenario, 1).tracks.position[..., 0]
    assert ((x[:-1] <= 1.0) & (x[1:] > 1.0)).any()


@pytest.mark.parametrize("people", [[(0.0, 0.0)], [(30.0, 0.0)]], ids=["in a solid", "outside"])
def test_no_robot_begins_in_a_solid_or_beside_the_map(tmp_path, people):
    path = tmp_path / "stand.csv"
    path.write_text(standing(*people, (-9.0, 9.0)))
    block = [[-8, -8], [8, -8], [8, 8], [-8, 8]]
    arena = {"kind": "map", "length": 24.0, "width": 24.0, "polygons": [block]}
    changes = {"robots.travel": 3.0, "pedestrians.spawn_clearance": 0.0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # somebody is within the solid
        scenario = crossing(path, arena=arena, **changes)
    for seed in range(4):
        layout = place(scenario, seed)
        for x, y in (layout.robot_pose[0, :2], layout.robot_goal[0]):
            assert 8.3 < max(abs(x), abs(y)) < 11.7


def test_walls_of_the_recording_are_walls_that_nobody_should_walk_through(tmp_path, recording):
    door = (np.array([[0.0, -1.0], [0.0, 1.0]]),)
    save(replace(read_recording(recording), walls=door), tmp_path / "walls.npz")
    with pytest.warns(UserWarning, match="6 of 6 recorded people walk through walls"):
        crossing(tmp_path / "walls.npz")


def test_who_walks_between_walls_is_not_told_of(recording):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        crossing(recording, **HALL)


@pytest.mark.parametrize(
    "people, told",
    [
        ([(-1, -3.2), (1, -3.2)], "somebody is within pedestrians.spawn_clearance of every start"),
        ([(0.0, 3.0), (0.0, 0.0)], "somebody stands at every goal all the time"),
        ([(-5.0, 0.0), (-4.0, 0.0)], "nobody comes within 1 m of the robot's way"),
    ],
)
def test_a_given_way_that_nobody_leaves_free_is_refused(tmp_path, people, told):
    path = tmp_path / "stand.csv"
    path.write_text(standing(*people))
    ends = {"robots.start": [0.0, -3.5], "robots.goal": [0.0, 3.0]}
    with pytest.raises(
        ScenarioError, match=f"from robots.start to robots.goal with seed 0: {told}"
    ):
        place(crossing(path, **HALL, **ends), 0)


@pytest.mark.parametrize("field", ["start", "goal"])
def test_a_region_without_room_is_named(recording, field):
    regions = {**HALL["arena"]["regions"], "nook": [2.1, 2.1, 2.9, 2.9]}
    arena = {**HALL["arena"], "regions": regions}
    scenario = crossing(recording, arena=arena, **{**ENDS, f"robots.{field}": "nook"})
    with pytest.raises(ScenarioError, match=f"robots.{field}: the region 'nook' has no room for"):
        place(scenario, 0)


def test_a_recording_with_nobody_in_the_way_is_refused(tmp_path):
    path = tmp_path / "apart.csv"
    lines = ["id,time [s],x [m],y [m]"]
    for person, y in enumerate((0.0, 40.0)):
        lines += [f"{person},{0.5 * k},{0.0 + 0.01 * k},{y + 0.4 * k}" for k in range(10)]
    path.write_text("\n".join(lines) + "\n")
    scenario = crossing(path, **{"pedestrians.spawn_clearance": 8.0})
    with pytest.raises(ScenarioError, match="cannot be crossed"):
        CrowdEnv(scenario).reset(seed=0)


def test_a_clearance_that_nobody_keeps_is_named_among_what_to_change(recording):
    scenario = crossing(recording, **{"pedestrians.spawn_clearance": 100.0})
    with pytest.raises(ScenarioError, match=r"change pedestrians.spawn_clearance, pedestrians.rec"):
        place(scenario, 0)


def test_a_way_longer_than_people_walk_is_told_of(recording):
    # 12 x 0.7 m, with a metre more on either side: the diagonal of 14 x 2.7 m.
    told = r"robots.travel: 14.3 m .* people walk within 12 x 0.\d+ m; among them it is 14.3 m at"
    with pytest.warns(UserWarning, match=told):
        crossing(recording, **{"robots.travel": 14.3})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        crossing(recording, **{"robots.travel": 14.2})


def test_the_main_direction_is_an_axis(tmp_path):
    path = tmp_path / "both.csv"
    lines = ["id,time [s],x [m],y [m]"]
    for person, sign in enumerate((1, -1, 1)):
        lines += [f"{person},{0.5 * k},{sign * 0.3 * k},{sign * 0.3 * k}" for k in range(20)]
    path.write_text("\n".join(lines) + "\n")
    assert main_direction(read_recording(path)) == pytest.approx(np.pi / 4)


@pytest.mark.parametrize(
    "origin, clear, expected", [((0, 0), 0.3, 1.7), ((0, 1.4), 0.3, 1.7), ((1.9, 0), 0.3, 0.0)]
)
def test_a_disc_gets_as_far_as_its_edge_touches_the_wall(origin, clear, expected):
    wall = np.array([[2.0, -5.0, 2.0, 5.0]])
    found = free_distance(np.array(origin, float), np.array([1.0, 0.0]), clear, 8.0, wall)
    assert found == pytest.approx(expected, abs=0.021)


def test_without_walls_a_disc_gets_anywhere():
    assert np.isinf(free_distance(np.zeros(2), np.array([1.0, 0.0]), 0.3, 8.0, np.empty((0, 4))))
