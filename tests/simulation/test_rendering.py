"""Pictures show what the state says, where it says it; drawing changes nothing."""

import copy
import os

import numpy as np
import pytest
from map_scenarios import HALL, hall

from crowdbench.scenario import Scenario
from crowdbench.simulation import window as windows
from crowdbench.simulation.canvas import SUPERSAMPLING, View
from crowdbench.simulation.env import CrowdEnv
from crowdbench.simulation.rendering import NONREACTIVE, OBSTACLE, REACTIVE, ROBOTS, Renderer

OPEN = Scenario(name="open", arena={"length": 10, "width": 10})
CORRIDOR = Scenario(name="hall", arena={"kind": "corridor", "length": 12, "width": 4})
WHITE = (255, 255, 255)
PIXELS_PER_METRE = 62  # a 10 x 10 m arena takes 620 x 620 of 700 x 700 pixels


def make_state(**changes):
    """A robot at the origin, heading along x, its goal at (4, 4), nobody else."""
    state = {
        "time": np.array(0.0),
        "robot_pose": np.array([[0.0, 0.0, 0.0]]),
        "robot_velocity": np.zeros((1, 2)),
        "robot_goal": np.array([[4.0, 4.0]]),
        "robot_active": np.array([True]),
        "pedestrian_position": np.zeros((0, 2)),
        "pedestrian_velocity": np.zeros((0, 2)),
        "pedestrian_way": np.zeros((0, 2, 2)),
        "pedestrian_goal": np.zeros((0, 2)),
        "pedestrian_radius": np.zeros(0),
        "pedestrian_speed": np.zeros(0),
        "pedestrian_reactive": np.zeros(0, bool),
        "pedestrian_attentive": np.zeros(0, bool),
        "pedestrian_group": np.zeros(0, int),
        "obstacles": np.zeros((0, 3)),
        "walls": np.zeros((0, 4)),
    }
    return state | {key: np.asarray(value) for key, value in changes.items()}


def person(
    position, velocity=(0.0, 0.0), goal=(-4.0, -4.0), reactive=True, attentive=True, way=None
):
    return {
        "pedestrian_position": np.array([position]),
        "pedestrian_velocity": np.array([velocity]),
        "pedestrian_way": np.array([[goal, goal] if way is None else way]),
        "pedestrian_goal": np.array([goal]),
        "pedestrian_radius": np.full(1, 0.25),
        "pedestrian_speed": np.full(1, 2.0),
        "pedestrian_reactive": np.array([reactive]),
        "pedestrian_attentive": np.array([attentive]),
        "pedestrian_group": np.full(1, -1),
    }


def paint(state, lidar=None, scenario=OPEN):
    return Renderer(scenario, "rgb_array").draw(state, lidar or {})


def pixel(picture, x, y):
    """The colour at a world position of the 10 x 10 m arena."""
    row, column = round(350 - PIXELS_PER_METRE * y), round(350 + PIXELS_PER_METRE * x)
    return tuple(int(value) for value in picture[row, column])


def shown():
    """The windows that are open, oldest first."""
    return [item._window for item in windows._open]


def near(color, other, tolerance=3):
    return np.abs(np.subtract(color, other)).max() <= tolerance


def test_an_open_arena_is_square_and_a_corridor_wide():
    assert paint(make_state()).shape == (700, 700, 3)
    assert paint(make_state()).dtype == np.uint8
    height, width, _ = paint(make_state(), scenario=CORRIDOR).shape
    assert width > 2 * height
    assert height % 2 == width % 2 == 0


def test_the_state_is_only_read():
    state = make_state(**person([1.0, 1.0], [0.5, 0.0]), obstacles=[[2.0, 2.0, 0.4]])
    lidar = {"robot_0": np.full(180, 3.0, np.float32)}
    before, scan = copy.deepcopy(state), lidar["robot_0"].copy()
    paint(state, lidar)
    for key, value in before.items():
        np.testing.assert_array_equal(state[key], value)
    np.testing.assert_array_equal(lidar["robot_0"], scan)


def test_the_same_state_gives_the_same_picture():
    state = make_state(**person([1.0, 1.0], [0.5, 0.0]))
    np.testing.assert_array_equal(paint(state), paint(state))


@pytest.mark.parametrize("position", [(2.0, -3.0), (-4.5, 4.0), (3.1, 0.7)])
def test_people_who_see_the_robot_are_discs_and_others_rings(position):
    seeing = paint(make_state(**person(position, reactive=True)))
    blind = paint(make_state(**person(position, reactive=False)))
    away = paint(make_state(**person(position, attentive=False)))
    np.testing.assert_array_equal(away, blind)
    rim = (position[0] + 0.2, position[1])
    assert near(pixel(seeing, *position), REACTIVE)
    assert near(pixel(seeing, *rim), REACTIVE)
    assert near(pixel(blind, *position), WHITE)
    assert near(pixel(blind, *rim), NONREACTIVE)


@pytest.mark.parametrize("way", [None, [[3, 0], [3, 2]]])
def test_dots_lead_to_a_goal_along_the_way_there(way):
    def is_dotted(first, last):
        line = np.linspace(first, last, 200)
        return any(not near(pixel(picture, x, y), WHITE, 40) for x, y in line)

    picture = paint(make_state(robot_pose=[[-4, -4, 0]], **person([-1, 0], goal=(3, 2), way=way)))
    around = [is_dotted((0.5, 0), (2.5, 0)), is_dotted((3, 0.5), (3, 1.5))]
    assert around == ([False, False] if way is None else [True, True])
    assert is_dotted((0.4, 0.7), (2, 1.5)) is (way is None)


def test_a_walking_person_has_a_tick_ahead_and_a_standing_one_none():
    ahead = (2.4, 2.6 + 0.25 + 0.2)
    walking = paint(make_state(**person((2.4, 2.6), velocity=(0.0, 0.8))))
    standing = paint(make_state(**person((2.4, 2.6), goal=(4.0, -4.0))))
    assert near(pixel(walking, *ahead), REACTIVE)
    assert near(pixel(standing, *ahead), WHITE)


@pytest.mark.parametrize("heading", [0.0, np.pi / 2, np.pi / 4, -2.0])
def test_the_footprint_turns_with_the_heading(heading):
    picture = paint(make_state(robot_pose=[[1.3, -1.4, heading]]))
    along = np.array([np.cos(heading), np.sin(heading)])
    across = np.array([-along[1], along[0]])
    front = np.array([1.3, -1.4]) - 0.15 * along + 0.08 * across  # beside the white arrow
    assert near(pixel(picture, *front), ROBOTS[0])
    beyond = np.array([1.3, -1.4]) + 0.19 * across  # 0.15 m is where the footprint ends
    assert near(pixel(picture, *beyond), WHITE)


def test_a_robot_that_is_done_is_paler():
    side = (-0.15, 0.08)
    assert near(pixel(paint(make_state()), *side), ROBOTS[0])
    done = pixel(paint(make_state(robot_active=[False])), *side)
    assert sum(done) > sum(ROBOTS[0]) + 100


def test_the_fan_ends_where_the_beams_do():
    scan = np.full(180, 6.0, np.float32)
    scan[40:51] = 1.0  # to the left, 80 to 100 degrees
    picture = paint(make_state(), {"robot_0": scan})
    assert pixel(picture, 0.05, 0.85) != WHITE
    assert pixel(picture, 3.05, -0.8) == pixel(picture, 0.05, 0.85)
    assert near(pixel(picture, 0.05, 1.8), WHITE)
    assert sum(pixel(picture, 0.0, 1.0)) < 300  # the hit itself
    assert near(pixel(paint(make_state()), 0.05, 0.85), WHITE)


def test_a_narrow_field_of_view_is_drawn_as_a_sector():
    scenario = OPEN.override({"lidar.field_of_view": 90.0})
    picture = paint(make_state(), {"robot_0": np.full(180, 3.0, np.float32)}, scenario)
    assert not near(pixel(picture, 1.3, 0.3), WHITE)
    assert near(pixel(picture, -1.3, 0.3), WHITE)
    assert near(pixel(picture, 0.3, 1.3), WHITE)


def test_obstacles_and_walls_are_where_they_are():
    picture = paint(make_state(obstacles=[[-2.0, 3.0, 0.5]], walls=[[-5.0, 2.0, 5.0, 2.0]]))
    inside, outside = pixel(picture, -2.3, 3.3), pixel(picture, -2.4, 3.4)
    assert max(inside) < 180
    assert near(outside, WHITE)
    assert max(pixel(picture, 4.3, 2.0)) < 100


def test_every_robot_has_its_own_colour_and_goal():
    poses = [[-2.5, y, 0.0] for y in (-2.5, 0.5, 2.5)]
    goals = [[2.5, y] for y in (2.5, 0.5, -2.5)]
    picture = paint(make_state(robot_pose=poses, robot_goal=goals, robot_active=[True] * 3))
    for color, (x, y, _), goal in zip(ROBOTS, poses, goals, strict=False):
        assert near(pixel(picture, x - 0.15, y + 0.08), color)
        assert near(pixel(picture, *goal), color)


def test_trails_grow_and_a_new_episode_starts_without():
    renderer = Renderer(OPEN, "rgb_array")
    for step in range(6):
        moved = make_state(
            time=0.2 * step,
            robot_pose=[[-3.0 + 0.4 * step, -2.3, 0.0]],
            **person((3.0 - 0.4 * step, 2.3), goal=(-4.0, 2.6)),
        )
        picture = renderer.draw(moved, {})
    assert near(pixel(picture, -2.3, -2.3), tuple(0.25 * 255 + 0.75 * np.array(ROBOTS[0])), 5)
    assert not near(pixel(picture, 2.3, 2.3), WHITE)
    again = renderer.draw(make_state(), {})
    np.testing.assert_array_equal(again, paint(make_state()))


def test_who_has_left_and_entered_anew_leaves_no_trail_between():
    renderer = Renderer(OPEN, "rgb_array")
    for step, x in enumerate((3.0, 2.8, -2.8, -2.6)):
        picture = renderer.draw(make_state(time=0.2 * step, **person((x, 2.3))), {})
    assert not near(pixel(picture, 2.9, 2.3), WHITE) and near(pixel(picture, 0.4, 2.3), WHITE)


def test_drawing_a_state_twice_changes_nothing():
    renderer = Renderer(OPEN, "rgb_array")
    for time, x in ((0.0, 0.0), (0.2, 0.2)):
        state = make_state(time=time, robot_pose=[[x, 0.0, 0.0]])
        first, second = renderer.draw(state, {}), renderer.draw(state, {})
        np.testing.assert_array_equal(first, second)


@pytest.fixture
def screen(monkeypatch):
    """A screen that nobody sees."""
    pygame = pytest.importorskip("pygame")
    monkeypatch.setitem(os.environ, "SDL_VIDEODRIVER", "dummy")
    yield pygame
    assert not pygame.display.get_init(), "the test closes its windows"


QUICK = OPEN.override({"control_period": 0.01})


def test_closing_the_window_stops_the_drawing_and_not_the_episode(screen):
    renderer = Renderer(QUICK, "human")
    assert renderer.draw(make_state(), {}) is None
    (window,) = shown()
    assert window.size == (700, 700)
    screen.event.post(screen.event.Event(screen.QUIT))
    assert renderer.draw(make_state(time=0.01), {}) is None
    assert not screen.display.get_init()
    assert renderer.draw(make_state(time=0.02), {}) is None
    assert not screen.display.get_init()
    renderer.close()


def test_closing_one_window_leaves_the_others(screen):
    first, second, third = (Renderer(QUICK, "human") for _ in range(3))
    for renderer in (first, second, third):
        renderer.draw(make_state(), {})
    assert len(shown()) == 3
    first.close()
    for renderer in (second, third):
        assert renderer.draw(make_state(time=0.01), {}) is None
    window = shown()[0]
    screen.event.post(screen.event.Event(screen.WINDOWCLOSE, window=window))
    third.draw(make_state(time=0.02), {})
    assert len(shown()) == 1
    assert shown()[0] is not window
    second.draw(make_state(time=0.02), {})
    assert len(shown()) == 1
    third.close()


def test_changing_an_observation_leaves_the_picture_alone():
    kept, changed = (CrowdEnv(Scenario(name="s"), "rgb_array") for _ in range(2))
    kept.reset(seed=0)
    changed.reset(seed=0)[0]["robot_0"]["lidar"][:] /= 6.0
    np.testing.assert_array_equal(changed.render(), kept.render())


@pytest.mark.parametrize(("period", "fps"), [(0.2, 5), (0.1, 10), (2.0, 0.5), (0.3, 1 / 0.3)])
def test_the_frame_rate_is_that_of_the_simulation(period, fps):
    env = CrowdEnv(Scenario(name="s", control_period=period))
    assert env.metadata["render_fps"] == pytest.approx(fps)
    assert isinstance(env.metadata["render_fps"], type(fps))


def test_what_is_solid_on_a_map_is_filled():
    env = CrowdEnv(hall(pedestrians__count=0), render_mode="rgb_array")
    env.reset(seed=0)
    picture, view = env.render(), View(20, 12)
    for place, color in (([-5, 3], OBSTACLE), ([5, -3], OBSTACLE), ([1, 3], WHITE)):
        x, y = np.floor(view.pixels(np.array(place) + 0.1) / SUPERSAMPLING).astype(int)
        np.testing.assert_allclose(picture[y, x].astype(int), color, atol=4)


def test_a_map_looks_the_same_wherever_its_coordinates_begin():
    def moved(points):
        flat = np.array(points, dtype=float).reshape(-1, 2) + [3.0, 2.0]
        return flat.reshape(np.shape(points)).tolist()

    regions = {name: moved(region) for name, region in HALL["arena.regions"].items()}
    changes = {
        "arena__centre": [3, 2],
        "arena__walls": moved(HALL["arena.walls"]),
        "arena__polygons": moved(HALL["arena.polygons"]),
        "arena__regions": regions,
    }
    pictures = []
    for scenario in (hall(pedestrians__count=0), hall(pedestrians__count=0, **changes)):
        env = CrowdEnv(scenario, render_mode="rgb_array")
        env.reset(seed=0)
        pictures.append(env.render().astype(int))
    assert np.mean(np.abs(pictures[0] - pictures[1]).max(axis=2) > 8) < 0.01
