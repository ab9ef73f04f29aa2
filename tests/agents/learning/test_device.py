"""Where networks are trained."""

import pytest
import torch
from crowdbench_agents.learning import device
from crowdbench_agents.learning.device import find_actors, find_device, learner_threads
from crowdbench_agents.learning.errors import TrainingError

CPU, GPU = torch.device("cpu"), torch.device("cuda")


def test_auto_takes_a_gpu_where_there_is_one(monkeypatch):
    for there, found in ((True, GPU), (False, CPU)):
        monkeypatch.setattr(torch.cuda, "is_available", lambda there=there: there)
        assert find_device("auto") == found
        assert find_device("cpu") == CPU


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("cuda", "device: cuda is asked for, but .*; use auto or cpu"),
        ("tpu", "device: expected auto, cpu or cuda, got 'tpu'"),
    ],
)
def test_a_device_that_is_not_there_is_refused_in_a_line(monkeypatch, name, message):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(TrainingError, match=message):
        find_device(name)


@pytest.mark.parametrize(
    ("cores", "where", "count", "threads"),
    [(1, CPU, 0, 1), (2, CPU, 1, 1), (8, CPU, 4, 4), (2, GPU, 1, 1), (64, CPU, 8, 56)],
)
def test_actors_and_learner_share_the_cores(monkeypatch, cores, where, count, threads):
    monkeypatch.setattr(device, "core_count", lambda: cores)
    assert find_actors(None, 8, where) == count
    assert learner_threads(count, where) == threads


@pytest.mark.parametrize("count", [-1, 9])
def test_more_actors_than_environments_are_refused(count):
    with pytest.raises(TrainingError, match=rf"actors: should be 0 to 8 .*, got {count}"):
        find_actors(count, 8, CPU)
