"""Training of the latent planner: world model, policy and planner, acting and learning in turn."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from crowdbench_agents.latent_planner.exploration import Explorer
from crowdbench_agents.latent_planner.learner import Learner
from crowdbench_agents.latent_planner.world_model import FORMAT, WorldModel
from crowdbench_agents.learning import training
from crowdbench_agents.learning.config import Config, load_config
from crowdbench_agents.learning.inputs import Inputs
from crowdbench_agents.learning.replay import EXPERT
from crowdbench_agents.learning.training import TrainingRun
from crowdbench_agents.learning.validation import Act, PolicyInput
from numpy.typing import NDArray


class LatentPlannerRun(TrainingRun):
    """One training run of a world model, its policy and its planner."""

    form = FORMAT

    def __init__(self, folder: Path, config: Config, seed: int, social: bool) -> None:
        super().__init__(folder, config, seed, social)
        self.learner = Learner(config, seed)
        self.explorer = Explorer(self.learner.model, config, self.envs.bounds, seed)
        self._steps = 0

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self._steps

    @property
    def updates(self) -> int:
        """Updates so far."""
        return self.learner.updates

    @property
    def decisions(self) -> int:
        """Decisions so far, each executed for one or more steps."""
        return self.explorer.decisions

    @property
    def updates_begin(self) -> bool:
        """Whether the replay has warmed up."""
        return len(self.replay) >= self.config.training.warmup

    def begin(self) -> None:
        """Start an episode in every environment."""
        self.replay.mark_episode_ends()
        self._begin(np.arange(self.envs.count))

    def step(self) -> None:
        """One control step in every environment."""
        envs, everywhere = self.envs, np.arange(self.envs.count)
        with self.learner.precision():
            acts = self.explorer.act(envs.sensed)
        acts.reference[self.experts.which] = self.experts.labels()
        acts.source[self.experts.which] = EXPERT
        before = envs.sensed.copy()
        result = envs.step(everywhere, envs.bounds.physical(acts.action))
        self.replay.append_step(
            before, acts.action, result, acts.reference, acts.source, envs.sensed
        )
        self._steps += len(everywhere)
        over = np.flatnonzero(result.over)
        for index in over:
            self.sampler.record(envs.scenario[index], result.outcome[index] == "success")
        if len(over):
            self._begin(over)

    def update(self) -> dict[str, torch.Tensor]:
        """One update of the world model and of the policy."""
        batch = self.sample(self.config.training.batch, self.config.planner.horizon)
        return self.learner.update(batch)

    def check(self, terms: Mapping[str, float]) -> None:
        """Stop a training that has died; see ``Learner.check``."""
        self.learner.check(terms)

    def scalars(self) -> dict[str, float]:
        """Entropy coefficient and scale of Q."""
        return {"alpha": self.learner.alpha, "q_scale": self.learner.q_scale}

    def policy(self) -> Act:
        """Act by the present policy, without noise."""
        act = policy_act(self.learner.model)

        def in_precision(given: PolicyInput) -> NDArray[np.float32]:
            with self.learner.precision():
                return act(given)

        return in_precision

    def tensors(self) -> dict[str, torch.Tensor]:
        """The world model's parameters."""
        return self.learner.model.state_dict()

    def state(self) -> dict[str, Any]:
        """Learner and explorer."""
        explorer = self.explorer.state()
        return {
            "learner": self.learner.state(),
            "generator": explorer.pop("generator"),
            "explorer": json.dumps(explorer),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned."""
        self.learner.restore(state["learner"])
        self.explorer.restore(json.loads(state["explorer"]) | {"generator": state["generator"]})
        self._steps = state["steps"]

    def _begin(self, which: NDArray[np.integer]) -> None:
        self.envs.begin(which)
        self.experts.begin(which)
        self.explorer.begin(which, self.envs.bounds.normalised(self.envs.sensed.velocity[which]))


def policy_act(model: WorldModel) -> Act:
    """Act by a world model's policy alone, without noise."""

    @torch.no_grad()
    def act(given: PolicyInput) -> NDArray[np.float32]:
        return model.act(model.encode(Inputs(*map(torch.from_numpy, given.sensed)))).numpy()

    return act


def train(
    name: str = "latent_planner",
    minutes: float | None = None,
    steps: int | None = None,
    resume: bool = False,
    seed: int = 0,
    social: bool = True,
    overrides: Mapping[str, Any] | None = None,
) -> Path:
    """Train a latent planner; see ``learning.training.train``.

    Args:
        name, minutes, steps, resume, seed, social: as there.
        overrides: fields of the shipped configuration, e.g. ``{"training.batch": 64}``.
    """
    config = load_config().override(overrides or {})
    return training.train(
        LatentPlannerRun, name, config,
        minutes=minutes, steps=steps, resume=resume, seed=seed, social=social,
    )  # fmt: skip
