"""The training run of a kind of agent: its learner, and those who act for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from crowdbench_agents.learning.acting import Acting, InProcess
from crowdbench_agents.learning.actors import Actors
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.kind import Kind
from crowdbench_agents.learning.rollout import Rollout
from crowdbench_agents.learning.run import TrainingRun
from crowdbench_agents.learning.validation import Act


class KindRun(TrainingRun):
    """One training run of a kind of agent.

    Args:
        kind: of agent.
        folder, config, seed, social: as in ``TrainingRun``.
        device: where networks are trained.
        actors: processes that act; with 0 this one does, in turn with learning.
    """

    def __init__(
        self,
        kind: Kind,
        folder: Path,
        config: Config,
        seed: int,
        social: bool,
        device: torch.device,
        actors: int,
    ) -> None:
        self.form = kind.form
        super().__init__(folder, config, seed, social, device.type)
        self.learner = kind.learner(config, seed, device)
        self.acting = self._make_acting(kind, seed, actors)

    def _make_acting(self, kind: Kind, seed: int, actors: int) -> Acting:
        if actors:
            return Actors(
                kind, self.learner.network, self.config, self.folder, self.sampler, seed, actors
            )
        everywhere = np.arange(self.config.training.environments)
        learned = self.learner.network
        here = next(learned.parameters()).device.type == "cpu"
        network = learned if here else kind.network(self.config).requires_grad_(False)
        rollout = Rollout(kind, network, self.config, everywhere, self.sampler, self.replay, seed)
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

    def state(self) -> dict[str, Any]:
        """Learner and actors."""
        return {"learner": self.learner.state(), "acting": self.acting.state()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned."""
        self.learner.restore(state["learner"])
        self.acting.restore(state["acting"])

    def spent(self) -> dict[str, float]:
        """Seconds since this was last asked, by what they were spent on."""
        return self.learner.watch.take() | self.acting.seconds()

    def close(self) -> None:
        """End all that was started."""
        self.acting.close()
