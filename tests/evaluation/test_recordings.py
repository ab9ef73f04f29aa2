"""Stored episodes seen again: the same episodes, from a results folder or from the record."""

import dataclasses

import numpy as np
import pytest

from crowdbench.evaluation.joined import cells_of, local_rows, published_and_local
from crowdbench.evaluation.publish import publish
from crowdbench.evaluation.record import load_record, write_cell
from crowdbench.evaluation.recordings import find_recordings
from crowdbench.evaluation.results import ResultsError

SCENARIO = "unimodal_slow"


def seen_again(folder, **chosen):
    return find_recordings(published_and_local(folder, **chosen))


def assert_same(one, other):
    for field in dataclasses.fields(one):
        if field.name not in ("inference_s", "processor_share"):
            values = getattr(one, field.name), getattr(other, field.name)
            np.testing.assert_array_equal(*values, err_msg=field.name)
    np.testing.assert_allclose(one.inference_s, other.inference_s, rtol=1e-6)


def test_local_episodes_are_seen_again_as_they_were(whole):
    run = whole.run(SCENARIO, "straight_line", 3)
    (recording,) = seen_again(whole.folder)
    assert recording.sources == {3: str(whole.folder)}
    (again,) = recording.episodes(3)
    assert_same(run, again)


def test_published_episodes_are_seen_again_as_they_were(whole, record, tmp_path):
    run = whole.run(SCENARIO, "straight_line", 3)
    publish([(SCENARIO, "straight_line", 100)], whole.folder, record)
    (recording,) = seen_again(tmp_path / "nothing")
    assert recording.sources == {3: "published"}
    (again,) = recording.episodes(3)
    assert_same(run, again)


def test_a_published_episode_that_was_not_timed_is_seen_again(whole, record, tmp_path):
    run = whole.run(SCENARIO, "straight_line", 3)
    publish([(SCENARIO, "straight_line", 100)], whole.folder, record)
    rows = load_record().drop(columns="source")
    rows["inference_s"] = np.nan
    (cell,) = cells_of(rows).values()
    write_cell(record, cell, rows, {(3, "robot_0"): run.commands})
    (recording,) = seen_again(tmp_path / "nothing")
    (again,) = recording.episodes(3)
    assert_same(dataclasses.replace(run, inference_s=np.full(run.steps, np.nan)), again)


def test_an_episode_without_commands_cannot_be_seen_again(episodes, record):
    episodes.add("orca", SCENARIO, spl=[0.5])
    assert seen_again(episodes.folder) == []


def test_published_commands_that_are_not_of_the_episode_are_found_out(whole, record, tmp_path):
    whole.run(SCENARIO, "straight_line", 3)
    publish([(SCENARIO, "straight_line", 100)], whole.folder, record)
    rows = load_record().drop(columns="source")
    rows["outcome"] = "timeout"
    (cell,) = cells_of(rows).values()
    steps = int(rows["steps"].iloc[0])
    write_cell(record, cell, rows, {(3, "robot_0"): np.zeros((steps, 2))})
    (recording,) = seen_again(tmp_path / "nothing")
    with pytest.raises(ResultsError, match=r"published: straight_line, .*seed 3"):
        recording.episodes(3)


def test_of_many_the_lowest_seeds_are_shown(whole, tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text("extends: unimodal_slow\ntime_limit: 0.4\n")
    for seed in (9, 3, 5):
        whole.run(path, "straight_line", seed)
    (recording,) = find_recordings(local_rows(whole.folder), at_most=2)
    assert recording.seeds == (3, 5)


def test_published_and_local_episodes_of_one_cell_are_one_recording(
    whole, make_whole, tmp_path, record
):
    other = make_whole(tmp_path / "other")
    runs = [whole.run(SCENARIO, "straight_line", 3), other.run(SCENARIO, "straight_line", 4)]
    publish([(SCENARIO, "straight_line", 100)], whole.folder, record)
    (recording,) = seen_again(other.folder)
    assert recording.sources == {3: "published", 4: str(other.folder)}
    for run in runs:
        assert_same(run, recording.episodes(run.seed)[0])
