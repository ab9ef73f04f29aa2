"""People who walk as recorded: synthetic recordings, replayed, crossed and refused."""

import subprocess
import sys

import numpy as np
import pytest
from crossings import crossing, walking

import crowdbench
from crowdbench import ScenarioError, load_scenario
from crowdbench.evaluation.metrics import metrics
from crowdbench.evaluation.resimulate import resimulate
from crowdbench.evaluation.rollout import run_episode
from crowdbench.people import read_recording
from crowdbench.scenario.recorded import AHEAD, most_tracks
from crowdbench.simulation.env import CrowdEnv
from crowdbench.simulation.recorded import CATCH_UP, Recorded, Tracks
from crowdbench.simulation.walking import Crowd
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


def follower(position, robot, sees=True):
    """Somebody who walks by a recording (T, P, 2), beside a robot that stands."""
    model = Recorded()
    model.follow(Tracks(position, 0.2, begin=0.0))
    count = position.shape[1]

    def crowd(places, velocity):
        return Crowd(
            position=places, velocity=velocity, heading=np.zeros(count), goal=position[-1],
            preferred_speed=np.ones(count), preferred_velocity=velocity,
            radius=np.full(count, 0.25),
            present=np.ones(count, bool),
            sees_robot=np.full((count, 1), sees), robot_position=np.array([robot], float),
            robot_velocity=np.zeros((1, 2)), robot_radius=0.25, responsibility=1.0,
            obstacles=np.empty((0, 3)), walls=np.empty((0, 4)), period=0.2,
        )  # fmt: skip

    return model, crowd


def test_who_sees_a_robot_in_the_way_goes_around_it_and_comes_back():
    track = np.column_stack([np.arange(80) * 0.2 - 6.0, np.zeros(80)])[:, None]
    model, crowd = follower(track, robot=[0.0, 0.1])
    place, velocity, fastest, gap = track[0].copy(), np.zeros((1, 2)), 0.0, np.inf
    for step in range(78):
        velocity = model.velocities(crowd(place.copy(), velocity), 0.2 * step)
        place += 0.2 * velocity
        fastest = max(fastest, np.linalg.norm(velocity))
        gap = min(gap, np.linalg.norm(place - [0.0, 0.1]))
    assert gap > 0.49  # the sum of the radii
    assert fastest <= 1.0 + CATCH_UP + 1e-9
    np.testing.assert_allclose(place[0], track[78, 0], atol=1e-6)


def test_who_does_not_see_it_walks_on():
    track = np.column_stack([np.arange(40) * 0.2 - 4.0, np.zeros(40)])[:, None]
    model, crowd = follower(track, robot=[0.0, 0.1], sees=False)
    for step in range(39):
        velocity = model.velocities(crowd(track[step].copy(), np.zeros((1, 2))), 0.2 * step)
        np.testing.assert_allclose(velocity, [[1.0, 0.0]], atol=1e-9)


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


def test_nobody_appears_on_top_of_a_robot():
    track = np.full((10, 2, 2), np.nan)
    track[3:, 0] = [0.3, 0.0]
    track[2:, 1] = [5.0, 0.0]
    robot = np.zeros((1, 2))
    model, _ = follower(track, robot[0])
    absent, reach = np.zeros(2, bool), np.full(2, 0.5)
    assert [model.present(absent, reach, robot, step).tolist() for step in (1, 2, 3)] == [
        [False, False], [False, True], [False, True],
    ]  # fmt: skip
    assert model.held.tolist() == [True, False]
    assert model.present(absent, reach, np.array([[0.0, 2.0]]), 4).all()
    assert model.present(absent, reach, np.empty((0, 2)), 4).all()
    # Who is there already stays, however near the robot is.
    assert model.present(~absent, reach, robot, 4).all()


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
