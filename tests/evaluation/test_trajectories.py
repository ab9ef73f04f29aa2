from __future__ import annotations

import dataclasses
import gzip
import json

import numpy as np
import pytest

from crowdbench.evaluation.metrics import metrics
from crowdbench.evaluation.results import Cell, ResultsError
from crowdbench.evaluation.trajectories import (
    TrajectoryStore,
    encode_episode,
    load_episode,
    trajectory_index,
)
from crowdbench.simulation.contact import Contact

CELL = Cell("random", "0123456789ab", "planner", "{}", "0.1.0", "", "a file")


@pytest.fixture
def store(tmp_path):
    return TrajectoryStore(tmp_path)


@pytest.fixture
def episodes(random_episode):
    return [dataclasses.replace(random_episode(seed, steps=12), seed=seed) for seed in range(3)]


def same(one, other):
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b, strict=True, err_msg=field.name)
        else:
            assert a == b, field.name


def test_an_episode_comes_back_bit_for_bit(store, episodes):
    episode = dataclasses.replace(
        episodes[0],
        outcome="collision",
        contact=Contact("pedestrian", 2, 0.1 + 0.2, -1e-300),
        diagnostics={"fails": 2.0, "worst": float("-inf")},
        other_robots=np.full((13, 1, 3), np.nan),
        error="it broke",
    )
    store.append(CELL, [encode_episode(CELL, episode)])
    same(load_episode(store.path(CELL), 0), episode)


def test_an_empty_world_keeps_its_shapes(store, make_episode):
    episode = make_episode([[0, 0, 0]])
    store.append(CELL, [encode_episode(CELL, episode)])
    same(load_episode(store.path(CELL), 0), episode)


def test_metrics_of_the_stored_episode_are_those_of_the_original(store, episodes):
    store.append(CELL, [encode_episode(CELL, item) for item in episodes])
    for item in episodes:
        again = metrics(load_episode(store.path(CELL), item.seed))
        np.testing.assert_equal(again, metrics(item))


def test_the_file_is_gzip_with_one_strict_json_document_per_line(store, episodes):
    store.append(CELL, [encode_episode(CELL, item) for item in episodes])

    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    lines = gzip.decompress(store.path(CELL).read_bytes()).decode().splitlines()
    assert [json.loads(line, parse_constant=refuse)["seed"] for line in lines] == [0, 1, 2]


def test_an_episode_cut_off_anywhere_is_dropped_and_nothing_else(store, episodes):
    members = [encode_episode(CELL, item) for item in episodes]
    store.append(CELL, members)
    path = store.path(CELL)
    whole = path.read_bytes()
    assert whole == b"".join(members)
    ends = np.cumsum([len(member) for member in members])
    for cut in [*range(0, len(whole), 97), *(ends - 1), *ends, *(ends[:-1] + 1)]:
        path.write_bytes(whole[:cut])
        complete = int(np.sum(ends <= cut))
        assert [entry.seed for entry in trajectory_index(path)] == list(range(complete))
        assert store.stored(CELL) == {seed: {"robot_0"} for seed in range(complete)}
        store.append(CELL, members)
        assert path.read_bytes() == whole


def test_an_episode_is_found_by_seed_and_robot_and_measurement(store, episodes):
    later = dataclasses.replace(CELL, code="another file")
    second = dataclasses.replace(episodes[0], robot="robot_1", error="second")
    newer = dataclasses.replace(episodes[0], error="newer")
    store.append(CELL, [encode_episode(CELL, item) for item in (episodes[0], second)])
    store.append(later, [encode_episode(later, newer)])
    assert store.stored(CELL) == {0: {"robot_0", "robot_1"}}
    assert store.stored(later) == {0: {"robot_0"}}
    assert load_episode(store.path(CELL), 0).error == "newer"
    assert load_episode(store.path(CELL), 0, "robot_1").error == "second"


def test_what_is_not_there_is_named(store, episodes):
    with pytest.raises(ResultsError, match=r"no episode with seed 0 of robot_0"):
        load_episode(store.path(CELL), 0)
    store.append(CELL, [encode_episode(CELL, episodes[0])])
    with pytest.raises(ResultsError, match=r"no episode with seed 8 of robot_0"):
        load_episode(store.path(CELL), 8)


def test_a_damaged_file_is_reported_with_its_name(store, episodes):
    store.append(CELL, [encode_episode(CELL, episodes[0])])
    path = store.path(CELL)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(ResultsError, match=r"the episode at byte 0 cannot be read") as caught:
        load_episode(path, 0)
    assert str(path) in str(caught.value)
    path.write_bytes(b"not gzip at all, but long enough to hold a header")
    with pytest.raises(ResultsError, match="not a trajectory file") as caught:
        trajectory_index(path)
    assert str(path) in str(caught.value)
