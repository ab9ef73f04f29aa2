"""The training loop of all learned agents: how a run begins, goes on and ends, whatever it trains.

Many environments run in one process. Each round every environment takes one step, the step goes
into the replay, and the networks are updated. Demonstrations come first and stay in each batch.
"""

from __future__ import annotations

import json
import time
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from crowdbench_agents.learning.batch import Batch, join
from crowdbench_agents.learning.checkpoints import (
    load_checkpoint,
    require_fitting,
    run_folder,
    run_name,
    save_checkpoint,
)
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.demonstrations import open_replays
from crowdbench_agents.learning.experts import Experts
from crowdbench_agents.learning.journal import Journal, stop_on_signals
from crowdbench_agents.learning.memory import keep_freed_memory
from crowdbench_agents.learning.precision import describe_precision
from crowdbench_agents.learning.sampler import ScenarioSampler, scenario_digests
from crowdbench_agents.learning.trained_robot import TrainedRobot
from crowdbench_agents.learning.validation import Act, validate
from crowdbench_agents.learning.vector_env import VectorEnv
from crowdbench_agents.learning.weights import save_weights

RUNS, CURVES = Path("runs"), Path("results/training")
NOTE_SECONDS = 15  # between notes on progress
CHECK_UPDATES = 100  # between checks, and notes, while learning from demonstrations alone


class TrainingRun(ABC):
    """One training run and all that has to survive an interruption.

    A kind of agent says how its networks act and learn; the environments, the replay, the expert
    and what a run leaves behind are the same for all.

    Args:
        folder: of the run.
        config: all settings.
        seed: of parameters, episodes and exploration.
        social: whether the reward includes the social term.
    """

    form: str
    """Which networks the weights are of, as in ``save_weights``."""

    def __init__(self, folder: Path, config: Config, seed: int, social: bool) -> None:
        settings = config.training
        self.folder, self.config = folder, config
        self.sampler = ScenarioSampler(seed)
        self.digests = scenario_digests(self.sampler.success)
        self.rng = np.random.default_rng([seed, 2])
        count = settings.environments
        self.envs = VectorEnv(count, self.sampler, config.perception.geometry)
        self.replay, self.demonstrations = open_replays(folder, config, self.envs, social)
        # The planner acts in the first environments, the expert labels the last.
        labelled = np.arange(count - settings.labelled_environments, count)
        self.experts = Experts(settings.expert, self.envs, labelled)
        self.facts = {
            "run": folder.name, "seed": seed, "social": social, "scenarios": self.digests,
            "robot": TrainedRobot.of(self.envs.robot).model_dump(),
            "arithmetic": describe_precision(settings.bfloat16),
        }  # fmt: skip
        self.seconds, self.best = 0.0, -1.0

    @property
    @abstractmethod
    def steps(self) -> int:
        """Environment steps so far."""

    @property
    @abstractmethod
    def updates(self) -> int:
        """Updates so far."""

    @property
    @abstractmethod
    def decisions(self) -> int:
        """Decisions so far, each executed for one or more steps."""

    @property
    @abstractmethod
    def updates_begin(self) -> bool:
        """Whether there is enough in the replay for updates between the steps."""

    @abstractmethod
    def begin(self) -> None:
        """Start an episode in every environment."""

    @abstractmethod
    def step(self) -> None:
        """One control step in every environment."""

    @abstractmethod
    def update(self) -> dict[str, torch.Tensor]:
        """One update of the networks; returns the losses' terms, for the log."""

    @abstractmethod
    def check(self, terms: Mapping[str, float]) -> None:
        """Stop a training that has died or diverged.

        Args:
            terms: means of what ``update`` returned.

        Raises:
            TrainingError: it has; the message says how that shows and what helps.
        """

    @abstractmethod
    def scalars(self) -> dict[str, float]:
        """Numbers for the log beside the losses' terms."""

    @abstractmethod
    def policy(self) -> Act:
        """Act by the present policy, without noise."""

    @abstractmethod
    def tensors(self) -> dict[str, torch.Tensor]:
        """The weights, as they are shipped."""

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """What a checkpoint has to hold of this kind of agent: tensors, numbers and text."""

    @abstractmethod
    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned."""

    def sample(self, count: int, horizon: int) -> Batch:
        """Draw sequences of H steps from the replay and the demonstrations.

        Args:
            count: sequences.
            horizon: H.
        """
        settings = self.config.training
        options = horizon, self.rng, settings.collision_share, settings.reflect
        if self.demonstrations is None:
            return self.replay.sample(count, *options)
        if len(self.replay) < settings.warmup:
            return self.demonstrations.sample(count, *options)
        shown = round(settings.demonstration_share * count)
        if not shown:
            return self.replay.sample(count, *options)
        if shown == count:
            return self.demonstrations.sample(count, *options)
        batch = self.replay.sample(count - shown, *options)
        return join(batch, self.demonstrations.sample(shown, *options))

    def validate(self, journal: Journal) -> None:
        """Tell the success of the policy on validation seeds, and keep the best."""
        settings = self.config.training
        geometry = self.config.perception.geometry
        result = validate(self.policy(), geometry, settings.validation_episodes)
        counts = {
            "steps": self.steps, "decisions": self.decisions, "updates": self.updates,
            "seconds": self.seconds,
        }  # fmt: skip
        row = journal.validated(result, counts, self.sampler.success)
        if result.mean >= self.best:
            self.best = result.mean
            self.export("best", row)

    def export(self, name: str, row: Mapping[str, Any]) -> None:
        """Write the weights to ``name``.safetensors, with how they came about."""
        path = self.folder / f"{name}.safetensors"
        save_weights(path, self.tensors(), self.config, {**self.facts, **row}, self.form)

    def save(self) -> None:
        """Write a checkpoint atomically.

        Raises:
            TrainingError: no room on the disk.
        """
        counters = {"steps": self.steps, "seconds": self.seconds, "best": self.best}
        state = {
            "rng": json.dumps(self.rng.bit_generator.state),
            "sampler": json.dumps([self.sampler.success, self.sampler.episodes]),
            "counters": json.dumps(counters | {"updates": self.updates}),
        }
        save_checkpoint(self.folder, state | self.state(), self.digests, self.form)

    def restore(self) -> None:
        """Continue from the checkpoint in the run's folder.

        Raises:
            TrainingError: it is damaged, of another version or other networks, or its scenarios
                have changed.
        """
        state = load_checkpoint(self.folder, self.form)
        require_fitting(self.folder, state, self.state())
        self.rng.bit_generator.state = json.loads(state["rng"])
        self.sampler.success, self.sampler.episodes = json.loads(state["sampler"])
        counters = json.loads(state["counters"])
        self.seconds, self.best = counters["seconds"], counters["best"]
        self.set_state(state | counters)


def train(
    kind: Callable[[Path, Config, int, bool], TrainingRun],
    name: str,
    config: Config,
    *,
    minutes: float | None = None,
    steps: int | None = None,
    resume: bool = False,
    seed: int = 0,
    social: bool = True,
) -> Path:
    """Train an agent.

    Args:
        kind: makes a run of its folder, configuration, seed and ``social``.
        name: of the run; its folder is ``runs/<name>``. Letters, digits and _.- only.
        config: all settings.
        minutes: wall time to train in this call.
        steps: environment steps at which to stop, those of earlier calls included.
        resume: continue the run of this name.
        seed: of parameters, episodes and exploration.
        social: whether the reward includes the social term.

    Returns:
        The run's folder with ``best.safetensors`` and ``last.safetensors``.

    Raises:
        TrainingError: a name that no run can have, nothing to resume, a run in the way, a
            checkpoint that cannot be used, a diverged training, a full disk.
    """
    folder, curve = RUNS / run_name(name), CURVES / f"{name}.csv"
    with run_folder(folder, resume):
        keep_freed_memory()
        torch.set_num_threads(1)
        run = kind(folder, config, seed, social)
        if resume:
            run.restore()
        else:
            curve.unlink(missing_ok=True)
        total = minutes * 60 if minutes is not None else steps if steps is not None else np.inf
        with stop_on_signals() as stopping, Journal(name, folder, curve, total) as journal:
            journal.say(f"networks learn in {describe_precision(config.training.bfloat16)}")
            _loop(run, journal, minutes, steps, stopping)
            if stopping():
                journal.say("stopped; --resume continues this run")
            run.save()
            run.export("last", {"steps": run.steps, "seconds": run.seconds})
    return folder


def _loop(
    run: TrainingRun,
    journal: Journal,
    minutes: float | None,
    steps: int | None,
    stopping: Callable[[], bool],
) -> None:
    settings = run.config.training
    begun, before = time.perf_counter(), run.seconds
    sums: dict[str, torch.Tensor] = defaultdict(lambda: torch.zeros(()))
    count, owed, last_note = 0, 0.0, (run.steps, begun)
    saved = validated = time.perf_counter()

    def update() -> None:
        nonlocal count
        for key, value in run.update().items():
            sums[key] = sums[key] + value
        count += 1

    def means() -> dict[str, float]:
        return {key: float(value) / count for key, value in sums.items()}

    def elapsed() -> float:
        return time.perf_counter() - begun

    if run.demonstrations is not None:
        while run.updates < settings.pretraining:
            update()
            if stopping():
                return
            if count % CHECK_UPDATES == 0:
                run.check(means())
                shares = f"{run.updates}/{settings.pretraining} updates on demonstrations"
                journal.advance(elapsed() if minutes is not None else run.steps, shares)
                run.seconds = before + elapsed()
        if count:
            run.validate(journal)
            saved = validated = time.perf_counter()
    run.begin()
    while not stopping():
        run.step()
        if run.updates_begin:
            owed += settings.updates_per_step
        while owed >= 1:
            update()
            owed -= 1
        now = time.perf_counter()
        run.seconds = before + now - begun
        if now - last_note[1] > NOTE_SECONDS and count:
            terms = means()
            run.check(terms)
            speed = (run.steps - last_note[0]) / (now - last_note[1])
            success = float(np.mean(list(run.sampler.success.values())))
            losses = {f"loss/{key}": value for key, value in (terms | run.scalars()).items()}
            journal.scalars(losses, run.steps)
            journal.scalars({"success_in_training": success, "steps_per_s": speed}, run.steps)
            note = f"success {success:.2f}, {speed:.0f} steps/s, {run.updates} updates"
            journal.advance(elapsed() if minutes is not None else run.steps, note)
            sums.clear()
            count, last_note = 0, (run.steps, now)
        done = (minutes is not None and elapsed() >= minutes * 60) or (
            steps is not None and run.steps >= steps
        )
        if done or now - validated > 60 * settings.validation_minutes:
            run.validate(journal)
            validated = time.perf_counter()
        if done:
            return
        if now - saved > 60 * settings.checkpoint_minutes:
            run.save()
            saved = time.perf_counter()
