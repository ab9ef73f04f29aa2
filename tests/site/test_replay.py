"""Replays on disk against the log they are made from."""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import json
import sqlite3

import numpy as np
import pytest

from crowdbench.evaluation.database import FILE, ResultsError
from crowdbench.evaluation.joined import local_rows
from crowdbench.evaluation.recordings import find_recordings
from crowdbench.evaluation.stored import defined_scenario
from crowdbench.scenario import ScenarioError, load_scenario
from crowdbench.simulation.env import CrowdEnv
from crowdbench.site import replay
from crowdbench.site.replay import (
    encode,
    script_json,
    write_replays,
)

SCENARIO = load_scenario("multimodal_fast", time_limit=6.0)


def unpacked(text, *shape):
    return np.frombuffer(base64.b64decode(text), dtype="<f4").reshape(shape)


def read(path):
    """The episodes that a data file hands over, and the name it says it has."""
    text = path.read_text(encoding="ascii")
    assert text.startswith("crowdbench.receive(") and text.endswith(");\n")
    name, episodes = json.loads("[" + text[len("crowdbench.receive(") : -3] + "]")
    return name, episodes


def recording_of(whole):
    """What can be seen of the one cell that is there."""
    found = find_recordings(local_rows(whole.folder))
    return found[0] if found else None


@pytest.fixture(scope="module")
def episode():
    from crowdbench.evaluation.rollout import run_episode

    return run_episode(SCENARIO, "straight_line", seed=900004)[0]


def test_positions_are_the_logs(episode):
    stored = encode(episode)
    states, people = episode.pedestrian_position.shape[:2]
    for name, array in (
        ("pose", episode.robot_pose),
        ("position", episode.pedestrian_position),
        ("velocity", episode.pedestrian_velocity),
    ):
        np.testing.assert_array_equal(
            unpacked(stored[name], *array.shape), array.astype(np.float32), err_msg=name
        )
    motion = unpacked(stored["motion"], *episode.actions.shape)
    np.testing.assert_allclose(motion, episode.actions, atol=1e-6)  # of a differential drive
    assert (stored["people"], stored["steps"]) == (people, states - 1)
    np.testing.assert_allclose(stored["goal"], episode.goal, atol=1e-6)


def test_goals_and_legs_are_the_logs_at_every_state(episode):
    stored = encode(episode)
    for person, (goals, legs) in enumerate(zip(stored["goals"], stored["legs"], strict=True)):
        for state in range(episode.steps + 1):
            goal = [row for row in goals if row[0] <= state][-1][1:]
            np.testing.assert_allclose(goal, episode.pedestrian_goal[state, person], atol=1e-6)
            intent, time = [row for row in legs if row[0] <= state][-1][1:]
            assert intent == episode.pedestrian_intent[state, person]
            assert time == pytest.approx(episode.pedestrian_switch_time[state, person], abs=1e-5)
    assert sum(map(len, stored["legs"])) < episode.steps, "only what changes is kept"


def test_numbers_that_json_lacks_become_null(episode):
    switch = np.full_like(episode.pedestrian_switch_time, np.inf)
    document = json.loads(script_json(encode(dataclasses.replace(
        episode, pedestrian_switch_time=switch))))  # fmt: skip
    assert document["legs"][0][0][2] is None


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_who_sees_the_robot_is_drawn_again_as_it_was(whole, tmp_path, share):
    world = SCENARIO.override({"pedestrians.reactive": share, "time_limit": 1.0})
    whole.run(world, "straight_line", 900001)
    env = CrowdEnv(world)
    env.reset(seed=900001)
    recording = recording_of(whole)
    (file,), _ = write_replays(recording, tmp_path)
    (stored,) = read(tmp_path / file)[1]
    reactive = env.state()["pedestrian_reactive"].tolist()
    assert stored["sees"] == [[[0, sees]] for sees in reactive]


def test_who_looks_away_does_not_see_the_robot_meanwhile(episode):
    away = np.ones_like(episode.pedestrian_attentive)
    away[1:3, 0] = False
    first, *others = encode(dataclasses.replace(episode, pedestrian_attentive=away))["sees"]
    assert first == [[0, 1], [1, 0], [3, 1]]
    assert others == [[[0, 1]]] * len(others)


def test_of_a_scenario_that_is_not_known_any_more_nothing_can_be_seen(whole):
    world = SCENARIO.override({"time_limit": 1.0})
    whole.run(world, "straight_line", 900001)
    with contextlib.closing(sqlite3.connect(whole.folder / FILE)) as database, database:
        database.execute("UPDATE cells SET definition = ?", (SCENARIO.model_dump_json(),))
    assert recording_of(whole) is None


def test_commands_of_another_episode_are_told_from_those_of_this_one(whole, tmp_path):
    whole.run(SCENARIO.override({"time_limit": 1.0}), "straight_line", 900001)
    with contextlib.closing(sqlite3.connect(whole.folder / FILE)) as database, database:
        database.execute("UPDATE episodes SET outcome = 'success'")
    told = "straight_line, seed 900001, robot_0: said to end with success"
    with pytest.raises(ResultsError, match=told):
        write_replays(recording_of(whole), tmp_path)


def test_files_stay_below_the_limit_and_lists_say_where_episodes_are(whole, tmp_path, monkeypatch):
    world = SCENARIO.override({"time_limit": 1.0})
    for seed in range(900000, 900006):
        whole.run(world, "straight_line", seed)
    recording = recording_of(whole)
    size = len(script_json(encode(next(iter(whole.episodes.values())))))
    monkeypatch.setattr(replay, "LARGEST_FILE", int(2.5 * size))
    files, listed = write_replays(recording, tmp_path)
    assert len(files) == 3 and len(set(files)) == 3
    assert all((tmp_path / file).stat().st_size < 3 * size for file in files)
    for line in listed:
        name, episodes = read(tmp_path / files[line["file"]])
        assert name == files[line["file"]]
        assert line["seed"] in [stored["seed"] for stored in episodes]


def test_an_episode_too_long_for_a_file_is_listed_without_one(whole, tmp_path, monkeypatch):
    whole.run(SCENARIO.override({"time_limit": 1.0}), "straight_line", 900000)
    recording = recording_of(whole)
    monkeypatch.setattr(replay, "LARGEST_FILE", 100)
    files, (line,) = write_replays(recording, tmp_path)
    assert (files, line["file"]) == ([], None)


def test_of_an_episode_that_was_run_again_the_latest_counts(whole):
    world = SCENARIO.override({"time_limit": 1.0})
    for agent, weights in (("straight_line", "old"), ("orca", "new")):
        whole.run(world, agent, 900000, label="planner", weights=weights)
        drives = whole.episodes[f"multimodal_fast@{world.digest}", "planner", 900000, "robot_0"]
        recording = recording_of(whole)
        assert recording.cell.weights_sha256 == weights
        (seen,) = recording.episodes(900000)
        np.testing.assert_array_equal(seen.robot_pose, drives.robot_pose)
        if weights == "old":
            older = recording
    assert not np.array_equal(older.episodes(900000)[0].robot_pose, drives.robot_pose)


@pytest.mark.parametrize(
    "text", ["</script>", "<!--", "]]>", "&amp;", "\u2028\u2029", '"\\', "\udc80", "é"]
)
def test_text_in_a_script_is_harmless_and_comes_back(text):
    written = script_json({"name": text})
    assert written.isascii()
    assert not set(written) & set("<>&")
    assert json.loads(written) == {"name": text}


def test_a_scenario_is_found_only_as_it_was():
    plain, changed = load_scenario("multimodal_fast"), SCENARIO
    assert defined_scenario("multimodal_fast", plain.digest, "") == plain
    assert defined_scenario("multimodal_fast", changed.digest, "") is None
    assert defined_scenario("no_such", plain.digest, "") is None
    label = f"multimodal_fast@{changed.digest}"
    assert defined_scenario(label, changed.digest, "") is None
    assert defined_scenario(label, changed.digest, changed.model_dump_json()) == changed
    assert defined_scenario(label, changed.digest, plain.model_dump_json()) is None
    with pytest.raises(ScenarioError, match=r"@.{12}' cannot be made again: name: missing"):
        defined_scenario(label, changed.digest, "{}")
