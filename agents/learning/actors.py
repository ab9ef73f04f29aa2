"""Acting in other processes while the learner learns: how they are started, paced and ended."""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
from crowdbench_agents.learning.acting import Acting
from crowdbench_agents.learning.actor import POLL, Job, work
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.kind import Kind
from crowdbench_agents.learning.sampler import ScenarioSampler
from crowdbench_agents.learning.shared import STAGES, Ledger, SharedWeights
from crowdbench_agents.learning.stopwatch import Stopwatch
from crowdbench_agents.learning.worlds import Worlds
from torch import nn

AHEAD = 2
"""Steps of all environments by which actors may be ahead of the learner: none waits for the other
where both are about as fast."""
PASSED_ON_EVERY = 4
"""Updates between versions of the weights that actors act by."""
HUNG_SECONDS = 300.0
"""Without a sign of life, after which an actor is started again; compiling takes the longest."""
DEATHS = 3
"""In a row, without ``HEALTHY_STEPS`` between them, after which a run gives up."""
HEALTHY_STEPS = 100
"""Of each of its environments, after which earlier deaths of an actor are forgotten."""
PATIENCE = 10.0
"""For actors to end by themselves [s]."""


class Actors(Acting):
    """N processes that act, each in its share of a run's environments.

    The learner tells how many steps there may be, so that the ratio of steps to updates holds
    however fast either side is.

    Args:
        kind: of agent.
        learned: the network that is trained.
        config: all settings.
        worlds: in which.
        folder: of the run, with its replay.
        sampler: of the run; its episodes and its success follow those of the actors.
        seed: of the run.
        count: N.
    """

    def __init__(
        self,
        kind: Kind,
        learned: nn.Module,
        config: Config,
        worlds: Worlds,
        folder: Path,
        sampler: ScenarioSampler,
        seed: int,
        count: int,
    ) -> None:
        self._kind, self._learned, self._config, self._worlds = kind, learned, config, worlds
        self._folder, self._sampler, self._seed, self._count = folder, sampler, seed, count
        self._context = multiprocessing.get_context("spawn")
        self._ledger = Ledger(count, list(sampler.success), self._context)
        self._weights = SharedWeights(learned, self._ledger, self._context, folder / "weights.lock")
        self._lanes = [np.arange(config.training.environments)[i::count] for i in range(count)]
        self._watch = Stopwatch()
        self._told = np.zeros(len(STAGES))
        self._before, self._decisions_before, self._episodes_before = 0, 0, 0
        self._wanted = self._unpublished = 0
        self._processes: dict[int, tuple[BaseProcess, Connection]] = {}
        self._deaths, self._last_start = [0] * count, np.zeros(count)
        self._say: Callable[[str], None] = lambda text: None
        self._stopping: Callable[[], bool] = lambda: False

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self._before + int(self._ledger.steps.sum())

    @property
    def decisions(self) -> int:
        """Decisions so far."""
        return int(self._ledger.decisions.sum())

    def begin(self, say: Callable[[str], None], stopping: Callable[[], bool]) -> None:
        """Start the processes."""
        self._say, self._stopping = say, stopping
        ledger = self._ledger
        self._episodes_before = self._sampler.episodes
        ledger.success[:] = list(self._sampler.success.values())
        ledger.decisions[0] = self._decisions_before
        self._weights.publish(self._learned)
        for number in range(self._count):
            self._start(number)

    def step(self) -> None:
        """Wait until all environments together have taken one more step, each on average."""
        environments, ledger = self._config.training.environments, self._ledger
        self._wanted += environments
        ledger.allowed[0] = self._wanted + AHEAD * environments
        self._look_after()
        with self._watch("waiting"):
            while ledger.steps.sum() < self._wanted and not self._stopping():
                time.sleep(POLL)
                self._look_after()
        self._sampler.success = dict(zip(ledger.scenarios, ledger.success.tolist(), strict=True))
        self._sampler.episodes = self._episodes_before + self._count * int(ledger.episodes.max())

    def updated(self) -> None:
        """Pass on the weights now and then."""
        self._unpublished += 1
        if self._unpublished >= PASSED_ON_EVERY and self._processes:
            self._weights.publish(self._learned)
            self._unpublished = 0

    def seconds(self) -> dict[str, float]:
        """Seconds since this was last asked: the learner's waiting, and the mean of the actors'."""
        now = self._ledger.seconds.mean(axis=0)
        spent, self._told = now - self._told, now
        actors = {f"actors: {name}": float(s) for name, s in zip(STAGES, spent, strict=True)}
        return self._watch.take() | actors

    def state(self) -> dict[str, Any]:
        """Counters; the randomness of actors begins anew with them."""
        return {"steps": self.steps, "decisions": self.decisions, "explorer": {}}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Count on from what ``state`` returned."""
        self._before, self._decisions_before = state["steps"], state["decisions"]

    def close(self) -> None:
        """End the processes: ask first, then insist."""
        self._ledger.stop[0] = 1
        deadline = time.monotonic() + PATIENCE
        for process, told in self._processes.values():
            process.join(max(0.0, deadline - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()
            told.close()
        self._processes.clear()

    def _start(self, number: int) -> None:
        told, tells = self._context.Pipe(duplex=False)
        ledger, start = self._ledger, int(self._ledger.steps[number])
        # Nothing is drawn twice, neither after a death nor after an interruption.
        drawn = np.random.SeedSequence([self._seed, 3, number, self._before, start])
        job = Job(
            self._kind, self._config, self._worlds, self._folder, number, self._lanes[number],
            int(drawn.generate_state(1)[0]), self._seed,
            self._episodes_before + number - self._count + 1, self._count,
        )  # fmt: skip
        ledger.heartbeat[number], self._last_start[number] = time.monotonic(), start
        process = self._context.Process(
            target=work, args=(job, ledger, self._weights, tells), name=f"actor {number}",
            daemon=True,
        )  # fmt: skip
        process.start()
        tells.close()
        self._processes[number] = process, told

    def _look_after(self) -> None:
        """Start an actor again that has died or hangs, unless that happens again and again.

        Raises:
            TrainingError: it does.
        """
        for number, (process, told) in list(self._processes.items()):
            silent = time.monotonic() - self._ledger.heartbeat[number]
            if process.is_alive() and silent < HUNG_SECONDS:
                continue
            reason = f"gave no sign of life for {silent:.0f} s"
            if not process.is_alive():
                reason = _last_words(process, told)
            process.kill()
            process.join()
            told.close()
            made = self._ledger.steps[number] - self._last_start[number]
            healthy = made >= HEALTHY_STEPS * len(self._lanes[number])
            self._deaths[number] = 1 if healthy else self._deaths[number] + 1
            if self._deaths[number] >= DEATHS:
                del self._processes[number]
                raise TrainingError(
                    f"actor {number} {reason}; that was its last of {DEATHS} attempts "
                    "(--actors 0 acts in the learner's process)"
                )
            self._say(f"actor {number} {reason}; it is started again")
            self._start(number)


def _last_words(process: BaseProcess, told: Connection) -> str:
    """Why a process has ended."""
    process.join()
    if told.poll():
        try:
            return f"stopped: {told.recv()}"
        except (EOFError, OSError):
            pass
    code = process.exitcode or 0
    if code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    return f"ended with exit code {code}"
