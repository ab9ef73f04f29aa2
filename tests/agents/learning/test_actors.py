"""Actors in processes of their own: their pace, what they act by, and what their death does."""

import multiprocessing
import os
import signal
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from crowdbench_agents.learning import actors
from crowdbench_agents.learning.actor import Job, work
from crowdbench_agents.learning.actors import AHEAD, Actors
from crowdbench_agents.learning.demonstrations import open_replay
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.sampler import ScenarioSampler
from crowdbench_agents.learning.shared import STAGES
from crowdbench_agents.learning.worlds import as_they_are
from simple_kind import BROKEN_KIND, KIND, SLOW_KIND, SMALL, Number

import crowdbench

ENVIRONMENTS = SMALL.training.environments
WORLDS = as_they_are(["corridor_sparse", "unimodal_slow"])


@contextmanager
def acting(folder, kind, count):
    """Actors that have begun, their network, and what they say; ended in the end."""
    network, said = Number(), []
    folder.mkdir(exist_ok=True)
    sampler = ScenarioSampler(0, WORLDS)
    made = Actors(kind, network, SMALL, WORLDS, folder, sampler, 0, count)
    try:
        made.begin(said.append, lambda: False)
        yield made, network, said
    finally:
        made.close()


def replay(folder):
    robot = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario("unimodal_slow"))
    return open_replay(folder, SMALL, robot, social=True)


def test_two_actors_keep_to_the_pace_of_a_slow_learner_and_act_by_its_newest_weights(tmp_path):
    with acting(tmp_path, KIND, 2) as (made, network, said):
        with torch.no_grad():
            network.number.fill_(0.5)
        for _ in range(actors.PASSED_ON_EVERY):
            made.updated()
        for done in range(1, 6):
            made.step()
            time.sleep(0.05)
            assert done * ENVIRONMENTS <= made.steps <= (done + AHEAD) * ENVIRONMENTS
        waited = made._ledger.seconds[:, STAGES.index("waiting")]
        while made.steps < (5 + AHEAD) * ENVIRONMENTS or not waited.all():
            time.sleep(0.01)
        assert made.steps == (5 + AHEAD) * ENVIRONMENTS, "they wait where they may be"
        spent = made.seconds()
        assert all(spent[f"actors: {name}"] > 0 for name in STAGES), spent
        episodes = made._sampler.episodes
        assert made.state()["decisions"] == made.steps
    kept = replay(tmp_path)
    assert len(kept) == made.steps
    # The first steps may have been by the weights before.
    newest = kept._data.action[np.arange(ENVIRONMENTS), kept.lengths() - 1]
    np.testing.assert_array_equal(newest, np.tile(np.float32([-1, 0.5]), (ENVIRONMENTS, 1)))
    labelled = kept._data.source[:, : len(kept) // ENVIRONMENTS].any(axis=1)
    assert labelled.tolist() == [False, False, False, True]
    assert episodes == ENVIRONMENTS, "each has its own, and none is left out"
    assert not said
    assert not list(Path("/dev/shm").glob(f"pym-{os.getpid()}-*"))


def test_a_fast_learner_waits_for_a_slow_actor_and_one_that_dies_is_replaced(tmp_path):
    with acting(tmp_path, SLOW_KIND, 1) as (made, _, said):
        for done in range(1, 4):
            made.step()
            assert made.steps >= done * ENVIRONMENTS
        assert made.seconds()["waiting"] > 0.05
        process, _ = made._processes[0]
        os.kill(process.pid, signal.SIGKILL)
        before = made.steps
        for _ in range(AHEAD + 1):
            made.step()
        assert made.steps > before
        assert said == ["actor 0 was ended by SIGKILL; it is started again"]
        running, _ = made._processes[0]
    assert not running.is_alive()
    kept = replay(tmp_path)
    assert len(kept) == made.steps
    assert kept._data.final.sum() == ENVIRONMENTS, "what was going on has ended"


def test_actors_that_die_again_and_again_end_the_run_with_their_error(tmp_path, monkeypatch):
    monkeypatch.setattr(actors, "DEATHS", 1)
    reason = r"^actor 0 stopped: ValueError: there is nothing to explore \(.*simple_kind.py:\d+\); "
    with (
        acting(tmp_path, BROKEN_KIND, 1) as (made, _, _),
        pytest.raises(TrainingError, match=reason),
    ):
        made.step()


def test_an_actor_that_hangs_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(actors, "HUNG_SECONDS", 0.05)
    monkeypatch.setattr(actors, "DEATHS", 1)
    with (
        acting(tmp_path, KIND, 1) as (made, _, _),
        pytest.raises(TrainingError, match="actor 0 gave no sign of life for 0 s"),
    ):
        made.step()


def test_an_actor_ends_whose_learner_died_while_it_was_started(tmp_path, monkeypatch):
    """Its parent is another process from its first line on."""
    network = Number()
    made = Actors(KIND, network, SMALL, WORLDS, tmp_path, ScenarioSampler(0, WORLDS), 0, 1)
    made._weights.publish(network)
    monkeypatch.setattr(signal, "signal", lambda number, handler: None)
    monkeypatch.setattr(multiprocessing, "parent_process", lambda: SimpleNamespace(pid=-1))
    stop = threading.Timer(5.0, lambda: made._ledger.stop.fill(1))
    stop.start()
    try:
        work(Job(KIND, SMALL, WORLDS, tmp_path, 0, np.arange(ENVIRONMENTS), 0, 0, 0, 1),
             made._ledger, made._weights, None)  # fmt: skip
        assert not made._ledger.stop[0], "it ended by itself"
    finally:
        stop.cancel()
