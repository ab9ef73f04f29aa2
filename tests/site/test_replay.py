"""Replays on disk against the log they are made from."""

from __future__ import annotations

import base64
import dataclasses
import json

import numpy as np
import pytest

from crowdbench.evaluation.trajectories import read_episode
from crowdbench.scenario import load_scenario
from crowdbench.simulation.env import CrowdEnv
from crowdbench.site import replay
from crowdbench.site.replay import (
    encode,
    find_recording,
    find_scenario,
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


@pytest.fixture(scope="module")
def episode():
    from crowdbench.evaluation.rollout import run_episode

    return run_episode(SCENARIO, "straight_line", seed=900004)[0]


def test_positions_are_the_logs(episode):
    stored = encode(episode, None)
    states, people = episode.pedestrian_position.shape[:2]
    for name, array in (
        ("pose", episode.robot_pose),
        ("actions", episode.actions),
        ("position", episode.pedestrian_position),
        ("velocity", episode.pedestrian_velocity),
    ):
        np.testing.assert_array_equal(
            unpacked(stored[name], *array.shape), array.astype(np.float32), err_msg=name
        )
    assert (stored["people"], stored["steps"]) == (people, states - 1)
    np.testing.assert_allclose(stored["goal"], episode.goal, atol=1e-6)


def test_goals_and_legs_are_the_logs_at_every_state(episode):
    stored = encode(episode, None)
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
        episode, pedestrian_switch_time=switch), None)))  # fmt: skip
    assert document["legs"][0][0][2] is None


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_who_sees_the_robot_is_drawn_again_as_it_was(whole, tmp_path, share):
    world = SCENARIO.override({"pedestrians.reactive": share, "time_limit": 1.0})
    whole.run(world, "straight_line", 900001)
    env = CrowdEnv(world)
    env.reset(seed=900001)
    recording = find_recording(next(whole.folder.glob("trajectories/*/*.gz")))
    (file,), _ = write_replays(recording, world, tmp_path)
    (stored,) = read(tmp_path / file)[1]
    assert stored["reactive"] == env.state()["pedestrian_reactive"].tolist()


def test_who_sees_the_robot_is_left_open_where_it_is_not_known(whole, tmp_path):
    whole.run(SCENARIO.override({"time_limit": 1.0}), "straight_line", 900001)
    recording = find_recording(next(whole.folder.glob("trajectories/*/*.gz")))
    other = SCENARIO.override({"pedestrians.count": 3})
    for scenario in (None, other):
        (file,), _ = write_replays(recording, scenario, tmp_path)
        assert read(tmp_path / file)[1][0]["reactive"] is None


def test_files_stay_below_the_limit_and_lists_say_where_episodes_are(whole, tmp_path, monkeypatch):
    world = SCENARIO.override({"time_limit": 1.0})
    for seed in range(900000, 900006):
        whole.run(world, "straight_line", seed)
    recording = find_recording(next(whole.folder.glob("trajectories/*/*.gz")))
    size = len(script_json(encode(next(iter(whole.episodes.values())), None)))
    monkeypatch.setattr(replay, "LARGEST_FILE", int(2.5 * size))
    files, listed = write_replays(recording, world, tmp_path)
    assert len(files) == 3 and len(set(files)) == 3
    assert all((tmp_path / file).stat().st_size < 3 * size for file in files)
    for line in listed:
        name, episodes = read(tmp_path / files[line["file"]])
        assert name == files[line["file"]]
        assert line["seed"] in [stored["seed"] for stored in episodes]


def test_an_episode_too_long_for_a_file_is_listed_without_one(whole, tmp_path, monkeypatch):
    whole.run(SCENARIO.override({"time_limit": 1.0}), "straight_line", 900000)
    recording = find_recording(next(whole.folder.glob("trajectories/*/*.gz")))
    monkeypatch.setattr(replay, "LARGEST_FILE", 100)
    files, (line,) = write_replays(recording, None, tmp_path)
    assert (files, line["file"]) == ([], None)


def test_of_an_episode_that_was_run_again_the_latest_counts(whole):
    world = SCENARIO.override({"time_limit": 1.0})
    for weights in ("old", "new"):
        whole.run(world, "straight_line", 900000, weights=weights, error=weights)
    path = next(whole.folder.glob("trajectories/*/*.gz"))
    (entry,) = find_recording(path).entries
    assert read_episode(path, entry).error == "new"
    identity = list(entry.identity)
    (older,) = find_recording(path, ["old" if part == "new" else part for part in identity]).entries
    assert read_episode(path, older).error == "old"
    assert find_recording(path, ["another", "identity"]) is None


@pytest.mark.parametrize(
    "text", ["</script>", "<!--", "]]>", "&amp;", "\u2028\u2029", '"\\', "\udc80", "é"]
)
def test_text_in_a_script_is_harmless_and_comes_back(text):
    written = script_json({"name": text})
    assert written.isascii()
    assert not set(written) & set("<>&")
    assert json.loads(written) == {"name": text}


def test_a_scenario_is_found_only_as_it_was(tmp_path):
    plain, changed = load_scenario("multimodal_fast"), SCENARIO
    assert find_scenario("multimodal_fast", plain.digest, None) == plain
    assert find_scenario("multimodal_fast", changed.digest, None) is None
    assert find_scenario("no_such", plain.digest, None) is None
    label = f"multimodal_fast@{changed.digest}"
    assert find_scenario(label, changed.digest, tmp_path) is None
    (tmp_path / "scenario.json").write_text(changed.model_dump_json())
    assert find_scenario(label, changed.digest, tmp_path) == changed
    (tmp_path / "scenario.json").write_text("{}")
    assert find_scenario(label, changed.digest, tmp_path) is None
