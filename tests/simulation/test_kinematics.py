"""Drives: motion against closed forms and against integration in small steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pages import unpack

import crowdbench
from crowdbench import Scenario, ScenarioError
from crowdbench.extensions import DRIVES
from crowdbench.simulation.kinematics import Drive, make_drive
from crowdbench.simulation.world import World

ALONE = Scenario(name="alone", pedestrians={"count": 0})
SIDEWAYS = ALONE.override({"robots.drive": "omnidirectional", "robots.speed": [-1.0, 1.0]})
SCENARIOS = {"differential": ALONE, "omnidirectional": SIDEWAYS}
ANY = st.floats(-1, 1).map(lambda value: round(value, 9))


def frame(heading):
    """Columns: ahead and left in the world."""
    return np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])


def integrated(name, heading, velocity, duration, steps=20_000):
    """Displacement and heading after many tiny steps of the drive's equations of motion."""
    turning = velocity[1] if name == "differential" else 0.0
    moving = np.array([velocity[0], 0.0 if name == "differential" else velocity[1]])
    dt = duration / steps
    headings = heading + turning * dt * (np.arange(steps) + 0.5)
    x = np.sum(moving[0] * np.cos(headings) - moving[1] * np.sin(headings)) * dt
    y = np.sum(moving[0] * np.sin(headings) + moving[1] * np.cos(headings)) * dt
    return np.array([x, y]), heading + turning * duration


@pytest.mark.parametrize("name", SCENARIOS)
@settings(deadline=None, max_examples=30)
@given(heading=st.floats(-3, 3), first=ANY, second=ANY)
def test_a_step_goes_where_tiny_steps_go(name, heading, first, second):
    drive = make_drive(SCENARIOS[name])
    x, y, after = drive.advance(heading, (first, second), 0.2)
    moved, turned = integrated(name, heading, (first, second), 0.2)
    np.testing.assert_allclose([0.2 * x, 0.2 * y], moved, atol=1e-9)
    assert after == pytest.approx(turned)
    assert drive.turn_rate((first, second)) * 0.2 == pytest.approx(after - heading)


@pytest.mark.parametrize("name", SCENARIOS)
@given(heading=st.floats(-3, 3), first=ANY, second=ANY)
def test_travel_is_the_velocity_of_an_instant(name, heading, first, second):
    drive = make_drive(SCENARIOS[name])
    x, y, speed = drive.travel(heading, (first, second))
    assert np.hypot(x, y) == pytest.approx(1.0)
    now = drive.advance(heading, (first, second), 1e-9)[:2]
    np.testing.assert_allclose([speed * x, speed * y], now, atol=1e-8)


@settings(deadline=None, max_examples=30)
@given(ahead=ANY, left=ANY, steps=st.integers(1, 10))
def test_an_omnidirectional_robot_moves_in_its_own_frame_and_keeps_its_heading(ahead, left, steps):
    world = World(SIDEWAYS, 0)
    start = world.pose[0].copy()
    for _ in range(steps):
        world.step(np.array([[ahead, left]]))
    moving = frame(start[2]) @ [ahead, left]
    np.testing.assert_allclose(world.pose[0, :2], start[:2] + 0.2 * steps * moving, atol=1e-9)
    assert world.pose[0, 2] == start[2]
    np.testing.assert_allclose(world.world_velocity[0], moving, atol=1e-12)
    assert world.speed[0] == pytest.approx(np.hypot(ahead, left))
    np.testing.assert_array_equal(world.velocity[0], [ahead, left])


def test_the_world_velocity_of_a_differential_robot_is_along_its_heading():
    world = World(ALONE, 0)
    world.step(np.array([[0.7, -1.0]]))
    expected = 0.7 * frame(world.pose[0, 2])[:, 0]
    np.testing.assert_allclose(world.world_velocity[0], expected, atol=1e-12)
    assert world.speed[0] == 0.7


def test_acceleration_bounds_the_change_of_both_speeds():
    world = World(SIDEWAYS.override({"robots.acceleration": [0.5, 1.0]}), 0)
    seen = []
    for _ in range(3):
        world.step(np.array([[1.0, -1.0]]))
        seen.append(world.velocity[0].copy())
    np.testing.assert_allclose(seen, [[0.1, -0.2], [0.2, -0.4], [0.3, -0.6]])


def test_the_environment_has_the_drives_bounds():
    robots = {"drive": "omnidirectional", "speed": [-0.5, 0.8], "lateral_speed": [-0.2, 0.3]}
    env = crowdbench.parallel_env("unimodal_slow", robots=robots)
    space = env.action_space("robot_0")
    np.testing.assert_allclose([space.low, space.high], [[-0.5, -0.2], [0.8, 0.3]])
    env.reset(seed=0)
    seen, *_ = env.step({"robot_0": np.array([2.0, 2.0])})
    np.testing.assert_allclose(seen["robot_0"]["velocity"], [0.8, 0.3])
    state = env.state()
    moving = frame(state["robot_pose"][0, 2]) @ [0.8, 0.3]
    np.testing.assert_allclose(state["robot_world_velocity"], [moving])
    np.testing.assert_allclose(state["robot_speed"], [np.hypot(0.8, 0.3)])
    for key, space in env.state_space.items():
        assert space.contains(state[key]), key


def test_a_pedestrian_agent_sees_a_robot_move_sideways():
    changes = {"robots.drive": "omnidirectional", "pedestrians.control": "agents"}
    env = crowdbench.parallel_env("unimodal_slow", **changes)
    env.reset(seed=0)
    seen, *_ = env.step({"robot_0": np.array([0.0, 0.5])})
    state = env.state()
    left = frame(state["robot_pose"][0, 2])[:, 1]
    expected = 0.5 * left - state["pedestrian_velocity"][0]
    np.testing.assert_allclose(seen["pedestrian_0"]["robots"][0, 2:], expected, atol=1e-6)


class Slow(Drive):
    """Refuses robots that are fast."""

    def __init__(self, robots):
        super().__init__(robots)
        if robots.speed[1] > 0.5:
            raise ValueError(f"robots.speed: expected at most 0.5, got {robots.speed[1]}")

    def turn_rate(self, velocity): ...

    def advance(self, heading, velocity, duration): ...

    def travel(self, heading, velocity): ...


def test_a_drive_that_cannot_be_used_is_refused_with_the_field(monkeypatch):
    monkeypatch.setitem(DRIVES._known, "test", Slow)
    told = "robots.drive: 'test': robots.speed: expected at most 0.5, got 1.0"
    with pytest.raises(ScenarioError, match=told):
        crowdbench.parallel_env("unimodal_slow", **{"robots.drive": "test"})


def test_a_drive_of_another_package_is_found_by_its_name(tmp_path, monkeypatch):
    """The one of docs/add_a_drive.md: its robot goes in a circle of radius L / tan(angle)."""
    list(unpack("docs/add_a_drive.md", tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(DRIVES, "_points", None)
    monkeypatch.setattr(DRIVES, "_known", dict(DRIVES._known))
    assert list(DRIVES)[-1] == "car"
    world = World(ALONE.override({"robots.drive": "car"}), 0)
    x, y, heading = world.pose[0].copy()
    radius, places = 0.3 / np.tan(0.4), []
    for _ in range(20):
        world.step(np.array([[0.5, 0.4]]))
        places.append(world.pose[0, :2].copy())
        ahead = [np.cos(world.pose[0, 2]), np.sin(world.pose[0, 2])]
        np.testing.assert_allclose(world.world_velocity[0], np.multiply(0.5, ahead), atol=1e-9)
    centre = np.array([x - radius * np.sin(heading), y + radius * np.cos(heading)])
    np.testing.assert_allclose(np.linalg.norm(places - centre, axis=1), radius, atol=1e-6)
    assert world.pose[0, 2] - heading == pytest.approx(20 * 0.2 * 0.5 / radius)
