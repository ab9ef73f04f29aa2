"""Nobody passes through anything, however fast, small or coarsely stepped; against shapely."""

import numpy as np
import pytest
from bodies import put, turn
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.affinity import rotate, translate
from shapely.geometry import LineString, Point, box

from crowdbench import Scenario, ScenarioError, scenario_names
from crowdbench.scenario import load_scenario
from crowdbench.simulation.env import CrowdEnv
from crowdbench.simulation.kinematics import Differential
from crowdbench.simulation.substeps import MOST, physics
from crowdbench.simulation.world import World

HALF_WIDTH = 2.0
REACH = 72.0
"""Walls end this far from the centre, and nobody gets there [m]."""
SPEEDS = st.floats(0.2, 20.0)


def corridor(**changes):
    """A corridor whose walls reach much farther than anybody gets."""
    plain = Scenario(
        name="corridor", time_limit=100, arena={"kind": "corridor", "length": 24, "width": 4},
        lidar={"range": 60, "beams": 8}, robots={"travel": 4}, pedestrians={"count": 10},
    )  # fmt: skip
    return plain.override(changes)


def allowed(half_extent, speed):
    """A period that such bodies and speeds may have, turns and diagonals included [s]."""
    return 0.48 * MOST * half_extent / (1.5 * speed + 3.0)


def footprint(scenario, pose):
    x, y = scenario.robots.length / 2, scenario.robots.width / 2
    turned = rotate(box(-x, -y, x, y), pose[2], origin=(0, 0), use_radians=True)
    return translate(turned, pose[0], pose[1])


def touches(scenario, state):
    """Whether the first robot overlaps anything by more than rounding."""
    body = footprint(scenario, state["robot_pose"][0])
    people = [
        Point(p).buffer(scenario.pedestrians.radius, quad_segs=64)
        for p in state["pedestrian_position"]
    ]
    obstacles = [Point(x, y).buffer(radius, quad_segs=64) for x, y, radius in state["obstacles"]]
    walls = [LineString(wall.reshape(2, 2)) for wall in state["walls"]]
    return any(body.intersection(other).length > 1e-3 for other in (*people, *obstacles, *walls))


@settings(max_examples=40, deadline=None)
@given(
    speed=SPEEDS,
    walking=st.floats(0.2, 10.0),
    turn_rate=st.floats(-3.0, 3.0),
    period=st.floats(0.02, 2.0),
    substeps=st.integers(1, 50),
    length=st.floats(0.1, 1.2),
    width=st.floats(0.1, 1.2),
    radius=st.floats(0.1, 0.4),
    drive=st.sampled_from(["differential", "omnidirectional"]),
    seed=st.integers(0, 10**6),
)
def test_nobody_is_ever_beyond_a_wall_and_who_ends_in_contact_has_collided(
    speed, walking, turn_rate, period, substeps, length, width, radius, drive, seed
):
    fastest = max(speed, walking)
    period = min(period, 30.0 / fastest, allowed(min(length, width, 2 * radius) / 2, fastest))
    scenario = corridor(
        **{
            "control_period": period, "substeps": substeps, "robots.speed": [0.0, speed],
            "robots.turn_rate": [-3.0, 3.0], "robots.lateral_speed": [-speed, speed],
            "robots.length": length, "robots.width": width, "robots.drive": drive,
            "pedestrians.radius": radius, "pedestrians.speed": [0.2, walking],
            "pedestrians.model": "straight", "obstacles.count": 1,
        }
    )  # fmt: skip
    env = CrowdEnv(scenario)
    env.reset(seed=seed)
    for _ in range(max(1, min(15, int(40.0 / (period * max(speed, walking)))))):
        _, _, _, _, infos = env.step({"robot_0": (speed, turn_rate)})
        state = env.state()
        across = [*state["robot_pose"][:, 1], *state["pedestrian_position"][:, 1]]
        along = [*state["robot_pose"][:, 0], *state["pedestrian_position"][:, 0]]
        assert np.abs(along).max() < REACH
        assert np.abs(across).max() < HALF_WIDTH
        if touches(scenario, state):
            assert infos["robot_0"]["outcome"] == "collision"
        if not env.agents:
            break


@settings(max_examples=20, deadline=None)
@given(
    speed=SPEEDS,
    period=st.floats(0.05, 2.0),
    substeps=st.integers(1, 4),
    width=st.floats(0.04, 0.4),
    radius=st.floats(0.02, 0.3),
    angle=st.floats(-3.0, 3.0),
)
def test_a_robot_does_not_drive_through_somebody_who_stands(
    speed, period, substeps, width, radius, angle
):
    """Placed in its way, hit by the middle of its front, and before the period ends."""
    period = min(period, allowed(min(width / 2, radius), speed))
    scenario = Scenario(
        name="pin", control_period=period, substeps=substeps, time_limit=20,
        robots={"speed": [0, speed], "length": width, "width": width},
        pedestrians={"count": 1, "radius": radius, "control": "agents"},
    )  # fmt: skip
    env = CrowdEnv(scenario)
    env.reset(seed=0)
    world = env._world
    ahead = np.array([np.cos(angle), np.sin(angle)])
    turn(world, 0, angle)
    gap = 0.5 * speed * period
    put(world, 1, world.pose[0, :2] + ahead * (gap + width / 2 + radius))
    _, _, _, _, infos = env.step({"robot_0": (speed, 0.0), "pedestrian_0": (0.0, 0.0)})
    assert infos["robot_0"]["outcome"] == "collision"
    assert infos["robot_0"]["contact"].kind == "pedestrian"
    to_person = env.state()["pedestrian_position"][0] - env.state()["robot_pose"][0, :2]
    assert to_person @ ahead > 0.0


def test_nobody_is_pushed_through_a_wall():
    """Somebody between a fast robot and a wall slips out sideways at most."""
    scenario = corridor(**{"robots.speed": [0, 10], "control_period": 1.0, "substeps": 1,
                           "pedestrians.count": 1, "pedestrians.model": "straight"})  # fmt: skip
    world = World(scenario, 0)
    turn(world, 0, np.pi / 2)
    put(world, 1, world.pose[0, :2] + [0.0, 0.6])
    for _ in range(5):
        world.step(np.array([[10.0, 0.0]]))
        robot, person = world.pose[0, :2], world.pedestrians.position[0]
        assert max(robot[1], person[1]) < HALF_WIDTH
        assert np.linalg.norm(robot - person) > 0.25


@pytest.mark.parametrize("name", scenario_names("paper"))
def test_shipped_scenarios_need_no_more_steps_than_they_name(name):
    scenario = load_scenario(name)
    drive = Differential(scenario.robots)
    corner = np.hypot(scenario.robots.length, scenario.robots.width) / 2
    fastest = drive.high[0] + corner * drive.high[1]
    for speed in (0.0, 0.5, fastest, scenario.pedestrians.speed[1]):
        assert physics(scenario, speed) == (scenario.substeps, 1e-8)


def test_what_would_need_too_many_steps_is_refused_with_the_bound_before_anything_runs():
    tiny = {"robots.width": 0.002, "robots.speed": [0, 20], "control_period": 2.0}
    with pytest.raises(ScenarioError, match=r"robots\.width.*control_period <= ") as refused:
        CrowdEnv(corridor(**tiny))
    allowed = float(str(refused.value).rpartition("<= ")[2])
    CrowdEnv(corridor(**tiny | {"control_period": 0.99 * allowed}))
    with pytest.raises(ScenarioError, match=f"allowed: {MOST:,}"):
        physics(corridor(), 1e6)
