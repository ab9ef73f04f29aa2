"""The main function of an actor: a process that acts in some of a run's environments."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.demonstrations import open_replay
from crowdbench_agents.learning.kind import Kind
from crowdbench_agents.learning.memory import keep_freed_memory
from crowdbench_agents.learning.rollout import Rollout
from crowdbench_agents.learning.sampler import ScenarioSampler
from crowdbench_agents.learning.shared import STAGES, Ledger, SharedWeights
from crowdbench_agents.learning.worlds import Worlds, robot_of
from numpy.typing import NDArray

from crowdbench.messages import describe_error

POLL = 0.002
"""How long to sleep before looking again whether it is one's turn [s]."""


class Job(NamedTuple):
    """What an actor has to do.

    Attributes:
        kind: of agent.
        config: all settings.
        worlds: in which.
        folder: of the run, with its replay.
        number: of the actor, 0 up.
        lanes: (E,) its environments, of all of the run.
        seed: of its exploration.
        run_seed: that of the run, which says whose episode seeds these are.
        episodes: number of the episode before its first one.
        stride: from one of its episodes to the next.
    """

    kind: Kind
    config: Config
    worlds: Worlds
    folder: Path
    number: int
    lanes: NDArray[np.integer]
    seed: int
    run_seed: int
    episodes: int
    stride: int


def work(job: Job, ledger: Ledger, weights: SharedWeights, told: Connection) -> None:
    """Act until the ledger says to stop or the learner is gone.

    Args:
        job: what to do.
        ledger: how far to go, and where progress is told.
        weights: to act by.
        told: where an error is told, in a line.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the learner, which ends this
    learner = multiprocessing.parent_process()  # getppid() is another one where it has died by now
    assert learner is not None
    try:
        torch.set_num_threads(1)
        keep_freed_memory()
        rollout, sampler, network = _prepare(job, ledger)
        weights.fetch(network)
        rollout.begin()
        while not ledger.stop[0] and os.getppid() == learner.pid:
            ledger.heartbeat[job.number] = time.monotonic()
            if not _may_step(job, ledger):
                with rollout.watch("waiting"):
                    time.sleep(POLL)
                _tell_seconds(job, ledger, rollout)
                continue
            weights.fetch(network)
            _step(job, ledger, rollout, sampler)
    except Exception as error:
        told.send(describe_error(error))
        raise SystemExit(1) from None


def _prepare(job: Job, ledger: Ledger) -> tuple[Rollout, ScenarioSampler, torch.nn.Module]:
    done = job.episodes + job.stride * int(ledger.episodes[job.number])  # by one that has died
    sampler = ScenarioSampler(job.run_seed, ledger.scenarios, done, job.stride)
    robot = robot_of(job.worlds)
    replay = open_replay(job.folder, job.config, robot, social=True)
    network = job.kind.network(job.config).eval().requires_grad_(False)
    rollout = Rollout(
        job.kind, network, job.config, job.lanes, job.worlds, sampler, replay, job.seed
    )
    return rollout, sampler, network


def _may_step(job: Job, ledger: Ledger) -> bool:
    share = len(job.lanes) / job.config.training.environments
    return bool(ledger.steps[job.number] + len(job.lanes) <= ledger.allowed[0] * share + 0.5)


def _step(job: Job, ledger: Ledger, rollout: Rollout, sampler: ScenarioSampler) -> None:
    explorer, number = rollout.explorer, job.number
    # Exploration decays with everybody's decisions, and scenarios are drawn by everybody's success.
    explorer.decisions = before = int(ledger.decisions.sum())
    sampler.success = followed = dict(zip(ledger.scenarios, ledger.success.tolist(), strict=True))
    known = dict(followed)
    rollout.step()
    for place, name in enumerate(ledger.scenarios):
        if sampler.success[name] != known[name]:
            ledger.success[place] += sampler.success[name] - known[name]
    ledger.decisions[number] += explorer.decisions - before
    ledger.episodes[number] = (sampler.episodes - job.episodes) // job.stride
    _tell_seconds(job, ledger, rollout)
    ledger.steps[number] += len(job.lanes)


def _tell_seconds(job: Job, ledger: Ledger, rollout: Rollout) -> None:
    for name, seconds in rollout.watch.take().items():
        ledger.seconds[job.number, STAGES.index(name)] += seconds
