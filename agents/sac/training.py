"""Training of SAC, on the observations and episodes of all learned agents."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from crowdbench_agents.learning import training
from crowdbench_agents.learning.config import Config, load_config
from crowdbench_agents.learning.inputs import ACTION, Inputs
from crowdbench_agents.learning.replay import EXPERT, NOBODY
from crowdbench_agents.learning.training import TrainingRun
from crowdbench_agents.learning.validation import Act, PolicyInput
from crowdbench_agents.sac.exploration import Explorer
from crowdbench_agents.sac.learner import Learner
from crowdbench_agents.sac.networks import FORMAT
from numpy.typing import NDArray

BATCH = 256


class SacRun(TrainingRun):
    """One training run of SAC."""

    form = FORMAT

    def __init__(self, folder: Path, config: Config, seed: int, social: bool) -> None:
        super().__init__(folder, config, seed, social)
        self.learner = Learner(config, seed)
        everywhere = np.arange(self.envs.count)
        self.explorer = Explorer(self.learner.network, config, everywhere, seed)

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self.explorer.decisions

    @property
    def updates(self) -> int:
        """Updates so far."""
        return self.learner.updates

    @property
    def decisions(self) -> int:
        """One per environment step."""
        return self.steps

    @property
    def updates_begin(self) -> bool:
        """Whether there is something to learn from: at once where there are demonstrations."""
        return self.demonstrations is not None or self.steps > self.config.training.warmup

    def begin(self) -> None:
        """Start an episode in every environment."""
        self.replay.mark_episode_ends()
        self._begin(np.arange(self.envs.count))

    def step(self) -> None:
        """One control step in every environment."""
        envs, count = self.envs, self.envs.count
        action = self.explorer.act(envs.sensed)
        reference, source = np.zeros((count, ACTION), np.float32), np.full(count, NOBODY, np.uint8)
        reference[self.experts.which] = self.experts.labels()
        source[self.experts.which] = EXPERT
        before = envs.sensed.copy()
        result = envs.step(np.arange(count), envs.bounds.physical(action))
        self.replay.append_step(before, action, result, reference, source, envs.sensed)
        over = np.flatnonzero(result.over)
        for index in over:
            self.sampler.record(envs.scenario[index], result.outcome[index] == "success")
        self._begin(over)

    def update(self) -> dict[str, torch.Tensor]:
        """One update of critic, actor and entropy coefficient."""
        return self.learner.update(self.sample(BATCH, self.config.loss.n_step))

    def check(self, terms: Mapping[str, float]) -> None:
        """Stop a training that has diverged; see ``Learner.check``."""
        self.learner.check(terms)

    def scalars(self) -> dict[str, float]:
        """The entropy coefficient."""
        return {"alpha": self.learner.alpha}

    def policy(self) -> Act:
        """Act by the present actor, without noise."""
        actor = self.learner.network.actor

        @torch.no_grad()
        def act(given: PolicyInput) -> NDArray[np.float32]:
            return actor(Inputs(*map(torch.from_numpy, given.sensed))).numpy()

        return act

    def tensors(self) -> dict[str, torch.Tensor]:
        """The actor's parameters."""
        return self.learner.network.actor.state_dict()

    def state(self) -> dict[str, Any]:
        """Learner and explorer."""
        return {"learner": self.learner.state(), "explorer": self.explorer.state()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned."""
        self.learner.restore(state["learner"])
        self.explorer.restore(state["explorer"])

    def _begin(self, which: NDArray[np.integer]) -> None:
        self.envs.begin(which)
        self.experts.begin(which)


def train(
    name: str = "sac",
    minutes: float | None = None,
    steps: int | None = None,
    resume: bool = False,
    seed: int = 0,
    social: bool = True,
    overrides: Mapping[str, Any] | None = None,
) -> Path:
    """Train SAC; see ``learning.training.train``.

    Args:
        name, minutes, steps, resume, seed, social: as there.
        overrides: fields of the shipped configuration, e.g. ``{"training.warmup": 0}``.
    """
    config = load_config().override(overrides or {})
    return training.train(
        SacRun, name, config,
        minutes=minutes, steps=steps, resume=resume, seed=seed, social=social,
    )  # fmt: skip
