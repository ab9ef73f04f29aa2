"""A training run: what it learns from, what it leaves behind, what survives an interruption."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from crowdbench_agents.learning.acting import Acting, InProcess
from crowdbench_agents.learning.actors import Actors
from crowdbench_agents.learning.batch import Batch, join
from crowdbench_agents.learning.checkpoints import (
    require_fitting,
    save_checkpoint,
)
from crowdbench_agents.learning.demonstrations import Demonstrations, open_replay
from crowdbench_agents.learning.errors import to_disk
from crowdbench_agents.learning.journal import Journal
from crowdbench_agents.learning.kind import Kind
from crowdbench_agents.learning.precision import describe_precision
from crowdbench_agents.learning.rollout import Rollout
from crowdbench_agents.learning.sampler import ScenarioSampler
from crowdbench_agents.learning.settings import RunSettings
from crowdbench_agents.learning.trained_robot import TrainedRobot
from crowdbench_agents.learning.validation import Act, validate
from crowdbench_agents.learning.weights import save_weights
from crowdbench_agents.learning.worlds import digests, robot_of, training_worlds


class TrainingRun:
    """One training run and all that has to survive an interruption.

    A kind of agent says how its networks act and learn; the environments, the replay, the expert
    and what a run leaves behind are the same for all.

    Args:
        kind: of agent.
        folder: of the run.
        settings: what decides what it learns.
        device: where networks are trained.
        actors: processes that act; with 0 this one does, in turn with learning.

    Attributes:
        needed: rows in the replay before the next update.
        demonstrations: where they are asked for; they may have to be recorded first.
    """

    def __init__(
        self,
        kind: Kind,
        folder: Path,
        settings: RunSettings,
        device: torch.device,
        actors: int,
    ) -> None:
        config, seed, social = settings.config, settings.seed, settings.social
        training = config.training
        self.form, self.folder, self.config = kind.form, folder, config
        self._settings = settings
        self._worlds = training_worlds(training)
        self.sampler = ScenarioSampler(seed, self._worlds)
        self.digests = digests(self._worlds)
        self.rng = np.random.default_rng([seed, 2])
        robot = robot_of(self._worlds)
        self.replay = open_replay(folder, config, robot, social)
        self.demonstrations: Demonstrations | None = None
        if training.demonstrations:
            self.demonstrations = Demonstrations(folder.parent, config, social, self._worlds)
        self.facts = {
            "run": folder.name, "seed": seed, "social": social, "scenarios": self.digests,
            "robot": TrainedRobot.of(robot).model_dump(),
            "arithmetic": describe_precision(training.bfloat16, device.type),
        }  # fmt: skip
        self.seconds, self.best = 0.0, -1.0
        self.needed = training.warmup
        self.learner = kind.learner(config, seed, device)
        self.acting = self._make_acting(kind, seed, actors)

    def _make_acting(self, kind: Kind, seed: int, actors: int) -> Acting:
        if actors:
            return Actors(
                kind, self.learner.network, self.config, self._worlds, self.folder, self.sampler,
                seed, actors,
            )  # fmt: skip
        everywhere = np.arange(self.config.training.environments)
        learned = self.learner.network
        here = next(learned.parameters()).device.type == "cpu"
        network = learned if here else kind.network(self.config).requires_grad_(False)
        rollout = Rollout(
            kind, network, self.config, everywhere, self._worlds, self.sampler, self.replay, seed
        )
        return InProcess(rollout, network, learned)

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self.acting.steps

    @property
    def updates(self) -> int:
        """Updates so far."""
        return self.learner.updates

    @property
    def decisions(self) -> int:
        """Decisions so far, each executed for one or more steps."""
        return self.acting.decisions

    @property
    def updates_begin(self) -> bool:
        """Whether the replay has warmed up."""
        return len(self.replay) >= self.needed

    def begin(self, say: Callable[[str], None], stopping: Callable[[], bool]) -> None:
        """Start an episode in every environment."""
        self.acting.begin(say, stopping)

    def step(self) -> None:
        """One more control step in every environment."""
        self.acting.step()

    def update(self) -> dict[str, torch.Tensor]:
        """One update of the networks; returns the losses' terms, for the log."""
        with self.learner.watch("sampling"):
            batch = self.sample(self.learner.count, self.learner.horizon)
        terms = self.learner.update(batch)
        self.acting.updated()
        return terms

    def check(self, terms: Mapping[str, float]) -> None:
        """Stop a training that has died or diverged; see ``Learner.check``."""
        self.learner.check(terms)

    def scalars(self) -> dict[str, float]:
        """Numbers for the log beside the losses' terms."""
        return self.learner.scalars()

    def policy(self) -> Act:
        """Act by the present policy, without noise."""
        return self.learner.policy()

    def tensors(self) -> dict[str, torch.Tensor]:
        """The weights, as they are shipped."""
        return self.learner.tensors()

    def spent(self) -> dict[str, float]:
        """Seconds since this was last asked, by what they were spent on."""
        return self.learner.watch.take() | self.acting.seconds()

    def close(self) -> None:
        """End all that was started."""
        self.acting.close()

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
        # As they are: what variants are trained for.
        worlds = {name: variants[:1] for name, variants in self._worlds.items()}
        result = validate(self.policy(), geometry, settings.validation_episodes, worlds)
        counts = {
            "steps": self.steps, "decisions": self.decisions, "updates": self.updates,
            "seconds": self.seconds,
        }  # fmt: skip
        row = journal.validated(result, counts, self.sampler.success)
        if result.mean >= self.best:
            self.best = result.mean
            self.export("best", row)

    def export(self, name: str, row: Mapping[str, Any]) -> None:
        """Write the weights to ``name``.safetensors, with how they came about.

        Raises:
            TrainingError: no room on the disk.
        """
        path = self.folder / f"{name}.safetensors"
        with to_disk(path, "resume from the last checkpoint"):
            save_weights(path, self.tensors(), self.config, {**self.facts, **row}, self.form)

    def save(self) -> None:
        """Write a checkpoint atomically: everything but the replay.

        Raises:
            TrainingError: no room on the disk, or numbers that are not finite.
        """
        counters = {
            "steps": self.steps, "updates": self.updates, "seconds": self.seconds,
            "best": self.best, "kept": len(self.replay),
        }  # fmt: skip
        state = {
            "settings": self._settings.document(),
            "rng": self.rng.bit_generator.state,
            "sampler": {"success": self.sampler.success, "episodes": self.sampler.episodes},
            "counters": counters,
            "learner": self.learner.state(),
            "acting": self.acting.state(),
        }
        save_checkpoint(self.folder, state, self.digests, self.form)

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from the state of the checkpoint in the run's folder.

        Where the replay is not there, it is filled again before the next update.

        Raises:
            TrainingError: it is of other networks.
        """
        require_fitting(self.folder, state, {"learner": self.learner.state()})
        self.rng.bit_generator.state = state["rng"]
        counters, sampler = state["counters"], state["sampler"]
        self.sampler.success, self.sampler.episodes = sampler["success"], sampler["episodes"]
        self.seconds, self.best = counters["seconds"], counters["best"]
        self.needed = max(self.needed, min(counters["kept"], self.config.training.refill))
        self.learner.restore(state["learner"])
        self.acting.restore(state["acting"])
