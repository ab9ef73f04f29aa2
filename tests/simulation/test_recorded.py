"""People who walk as recorded: synthetic recordings, replayed, crossed and refused."""

import subprocess
import sys

import numpy as np
import pytest
from crossings import FPS, crossing, walking

import crowdbench
from crowdbench import ScenarioError, load_scenario
from crowdbench.evaluation.metrics import metrics
from crowdbench.evaluation.resimulate import resimulate
from crowdbench.evaluation.rollout import run_episode
from crowdbench.people import read_recording
from crowdbench.scenario.recorded import AHEAD, most_tracks
from crowdbench.scenario.room import robot_radius
from crowdbench.simulation.env import CrowdEnv
from crowdbench.simulation.recorded import CATCH_UP, Tracks
from crowdbench.simulation.world import World

STANDING = {"robot_0": np.zeros(2)}


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "walk.csv"
    path.write_text(walking())
    return path


def steps(env, seed, action=STANDING):
    """States of an episode, the first included."""
    env.reset(seed=seed)
    yield env.state()
    while env.agents:
        env.step(action)
        yield env.state()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nobody_walks_otherwise_than_recorded(recording, seed):
    env = CrowdEnv(crossing(recording, **{"pedestrians.reactive": 0.0}))
    known = read_recording(recording)
    origin = sum(known.extent) / 2
    states = list(steps(env, seed))
    begin = World(env.scenario, seed).layout.tracks.begin
    assert len(states) > 50
    for k, state in enumerate(states):
        expected = known.at(begin + 0.2 * k).positions - origin
        np.testing.assert_allclose(_there(state), expected, atol=1e-9)


@pytest.mark.parametrize("period", [1 / FPS, 2 / FPS])
def test_at_frames_people_are_where_the_file_has_them(recording, period):
    """Its rows themselves."""
    rows = np.loadtxt(recording, delimiter=",", skiprows=1)
    env = CrowdEnv(crossing(recording, control_period=period, **{"pedestrians.reactive": 0.0}))
    origin = (rows[:, 2:].min(axis=0) + rows[:, 2:].max(axis=0)) / 2
    for seed in (1, 2):
        states = list(steps(env, seed))
        first = round(World(env.scenario, seed).layout.tracks.begin * FPS)
        for k, state in enumerate(states):
            frame = first + k * round(period * FPS)
            expected = rows[np.rint(rows[:, 1] * FPS) == frame, 2:] - origin
            found = _there(state)
            assert len(found) == len(expected) > 0
            np.testing.assert_allclose(sorted(found.tolist()), sorted(expected.tolist()), atol=1e-9)


def test_nobody_is_followed_who_comes_after_the_time_that_rows_are_counted_for(recording):
    # 67 periods of 0.3 s are 20.1 s; nobody who leaves at first meets who comes after 20.05 s.
    recording.write_text("id,time,x_m,y_m\n1,0,0,0\n1,0.04,0.04,0\n2,20.05,5,0\n2,20.15,5.1,0\n")
    known = read_recording(recording)
    assert most_tracks(known, 10 + AHEAD) == 1
    tracks = Tracks.of(known, np.zeros(2), 0.0, 10.0, 0.3, 1)
    assert np.isfinite(tracks.position[:, 0, 0]).tolist() == [True] + [False] * 66


def _there(state):
    position = state["pedestrian_position"]
    return position[np.isfinite(position[:, 0])]


def test_people_come_and_go(recording):
    env = CrowdEnv(crossing(recording, **{"pedestrians.reactive": 0.0}))
    present = np.array([np.isfinite(state["pedestrian_position"][:, 0]) for state in steps(env, 4)])
    changes = np.diff(present.astype(int), axis=0)
    assert (changes == 1).any() and (changes == -1).any()
    assert present.any(axis=1).all()


def past_a_robot(recording, **changes):
    """Somebody who walks along x at 1 m/s, and would walk through a robot at (0, 0.1)."""
    lines = [f"1,{k / 5},{k / 5 - 8},0" for k in range(81)]
    recording.write_text("\n".join(["id,time,x_m,y_m", *lines]))
    ends = {"robots.start": [0.0, 0.1], "robots.goal": [0.0, 3.0]}
    return World(crossing(recording, **ends, **changes), 3)


def test_who_sees_a_robot_in_the_way_goes_around_it_and_comes_back(recording):
    settings = {"reactive": 1.0, "responsibility": 1.0, "field_of_view": 360}
    world = past_a_robot(recording, **{f"pedestrians.{key}": settings[key] for key in settings})
    people, tracks = world.pedestrians, world.layout.tracks
    aside, speeds = 0.0, []
    last = np.isfinite(tracks.position[:, 0, 0]).sum() - 1
    for _ in range(last):
        world.step(np.zeros((1, 2)))
        aside = max(aside, abs(people.position[0, 1]))
        speeds.append(np.linalg.norm(people.chosen[0]))
    assert not world.contacts
    assert not world.recorded()["recorded_held"].any()
    assert aside > 0.2
    assert 1.2 < max(speeds) <= 1.0 + CATCH_UP + 1e-9
    np.testing.assert_allclose(people.position, tracks.at(last), atol=1e-6)


def test_who_does_not_see_it_walks_on(recording):
    world = past_a_robot(recording, **{"pedestrians.reactive": 0.0})
    while world.pedestrians.position[0, 0] < -0.8:
        world.step(np.zeros((1, 2)))
        np.testing.assert_allclose(world.pedestrians.chosen, [[1.0, 0.0]], atol=1e-9)
    for _ in range(3):
        world.step(np.zeros((1, 2)))
    assert world.contacts
    # Who is there already stays, however near the robot is.
    assert world.pedestrians.present.all()
    assert not world.recorded()["recorded_held"].any()


def test_who_has_been_pushed_off_the_way_comes_back_a_little_faster_than_recorded(recording):
    world = past_a_robot(recording, **{"pedestrians.reactive": 0.0})
    people, tracks = world.pedestrians, world.layout.tracks
    people.position[0] -= [0.3, 0.4]
    ahead = tracks.at(1)[0] - people.position[0]
    world.step(np.zeros((1, 2)))
    expected = (1.0 + CATCH_UP) * ahead / np.linalg.norm(ahead)
    np.testing.assert_allclose(people.chosen[0], expected, atol=1e-9)


def test_what_lies_ahead_is_what_comes(recording):
    env = CrowdEnv(crossing(recording, **{"pedestrians.reactive": 0.0}))
    states = list(steps(env, 6))
    for k in range(0, len(states) - 11, 5):
        ahead = states[k]["recorded_ahead"][9]
        np.testing.assert_allclose(ahead, states[k + 10]["pedestrian_position"], atol=1e-9)
    for state in states:
        for key, space in env.state_space.items():
            assert space.shape == state[key].shape, key


def test_lanes_and_stored_commands_give_the_same_episode(recording):
    scenario = crossing(recording, **{"pedestrians.reactive": 0.5})
    (episode,) = run_episode(scenario, "straight_line", 7)
    env = CrowdEnv(scenario)
    (again,) = resimulate(env, 7, [episode.commands], label="straight_line", errors=[None])
    np.testing.assert_array_equal(again.pedestrian_position, episode.pedestrian_position)
    assert metrics(again).keys() == metrics(episode).keys()
    lanes = crowdbench.vector_env(scenario, 3, autoreset_mode="Disabled")
    lanes.reset(seed=6)
    for command in episode.commands:
        lanes.step(np.tile(command.astype(np.float32), (3, 1)))
    single = CrowdEnv(scenario)
    single.reset(seed=7)
    for command in episode.commands:
        single.step({"robot_0": command.astype(np.float32)})
    for key, value in single.state().items():
        np.testing.assert_array_equal(lanes.state(1)[key], value, err_msg=key)


def test_nobody_appears_on_top_of_a_robot(recording):
    lines = [f"1,{k / 5},{k / 5 - 6},0" for k in range(61)]
    lines += [f"2,{k / 5},0,{3 + k / 150}" for k in range(20, 61)]
    recording.write_text("\n".join(["id,time,x_m,y_m", *lines]))
    ends = {"robots.start": [0.0, 1.3], "robots.goal": [0.0, -1.7]}
    scenario = crossing(recording, **ends, **{"pedestrians.reactive": 0.0})
    world = World(scenario, 3)
    tracks, radius = world.layout.tracks, robot_radius(scenario.robots)
    before, waited = world.pedestrians.present.copy(), 0
    for step in range(1, 40):
        world.step(np.array([[1.0 if waited > 4 else 0.0, 0.0]]))
        expected = np.isfinite(tracks.at(step)[:, 0])
        gaps = np.linalg.norm(tracks.at(step) - world.pose[0, :2], axis=1)
        kept = expected & ~before & (gaps <= radius + world.pedestrians.radius)
        waited += kept.any()
        np.testing.assert_array_equal(world.pedestrians.present, expected & ~kept)
        before = world.pedestrians.present.copy()
    assert waited > 4
    assert world.recorded()["recorded_held"].tolist() == [False, True]
    there = world.pedestrians.present
    assert there.any()
    np.testing.assert_allclose(world.pedestrians.position[there], tracks.at(39)[there], atol=1e-9)


@pytest.mark.parametrize("leaves", [False, True])
def test_a_robot_that_has_left_holds_nobody_back(recording, leaves):
    x, y = read_recording(recording).positions[0] - sum(read_recording(recording).extent) / 2
    ends = {"robots.start": [x, y], "robots.goal": [5.0, 0.0]}
    world = World(crossing(recording, **ends, **{"pedestrians.reactive": 0.0}), 3)
    if leaves:
        world.remove(0)
    for _ in range(60):
        world.step(np.zeros((1, 2)))
    assert world.recorded()["recorded_held"].any() != leaves


def test_metrics_know_only_those_who_are_there(recording):
    (episode,) = run_episode(crossing(recording), "straight_line", 8)
    values = metrics(episode)
    assert 0 <= values["min_clearance"] < 6
    assert np.isfinite(values["social_work"])


def test_the_digest_follows_the_file_not_its_place(recording, tmp_path):
    other = tmp_path / "elsewhere"
    other.mkdir()
    copy = other / "copy.csv"
    copy.write_bytes(recording.read_bytes())
    assert crossing(copy).digest == crossing(recording).digest
    copy.write_text(walking(speed=1.1))
    assert crossing(copy).digest != crossing(recording).digest


def test_a_path_starts_at_the_scenarios_file(recording):
    path = recording.with_name("crossing.yaml")
    path.write_text(
        "extends: open\nrobots: {travel: 6}\npedestrians: {model: recorded, recording: walk.csv}\n"
    )
    scenario = load_scenario(path)
    assert scenario.pedestrians.count == 6
    assert scenario.pedestrians.recording.file == str(recording)
    assert load_scenario(scenario, **{"robots.travel": 5}).robots.travel == 5


@pytest.mark.parametrize(
    "changes, told",
    [
        ({"pedestrians.recording": "nowhere.csv"}, "nowhere.csv': No such file"),
        ({"pedestrians.recording.file": ""}, "pedestrians.recording: missing"),
        ({"pedestrians.model": "orca"}, "allowed: none with pedestrians.model 'orca' (ped"),
        ({"pedestrians.control": "agents"}, "pedestrians.control"),
        ({"arena.kind": "corridor"}, "allowed for recorded people: open or map"),
        ({"obstacles.count": 2}, "obstacles.count"),
        ({"pedestrians.streams": [{"start": "a", "goal": "b"}]}, "pedestrians.streams"),
        ({"pedestrians.recording.sha256": "0" * 64}, "is another file than the one noted"),
        ({"pedestrians.recording.unit": "cm"}, "positions in m, and cm is given"),
    ],
)  # fmt: skip
def test_what_does_not_go_together_is_named(recording, changes, told):
    document = crossing(recording).model_dump()
    with pytest.raises(ScenarioError, match=told.replace("(", r"\(")):
        crowdbench.Scenario.model_validate(document).override(changes)


def test_who_does_not_read_recordings_does_not_load_what_reads_them():
    loaded = subprocess.run(
        [sys.executable, "-c", "import crowdbench.simulation.env, sys; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert "crowdbench.simulation.recorded" in loaded
    assert not {"crowdbench.people.reading", "pandas"} & set(loaded)
