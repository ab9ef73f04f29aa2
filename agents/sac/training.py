"""Training of SAC with Stable-Baselines3, on the observations and episodes of all learned agents.

The encoder, the sampling of scenarios, the discount, the reward scale, the reflection, the
multi-step returns, the demonstrations and the expert labels are those of all learned agents; the
learning algorithm is Stable-Baselines3's, with the imitation of the expert added to the actor's
loss.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from crowdbench_agents.learning import training
from crowdbench_agents.learning.config import Config, load_config
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.experts import Experts
from crowdbench_agents.learning.inputs import Inputs
from crowdbench_agents.learning.run import TrainingRun
from crowdbench_agents.learning.validation import Act, PolicyInput
from crowdbench_agents.learning.vector_env import VectorEnv
from crowdbench_agents.sac.adapters import CrowdReplay, CrowdVecEnv, MapFeatures
from crowdbench_agents.sac.networks import FORMAT, SacActor
from numpy.typing import NDArray
from stable_baselines3 import SAC
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

BATCH = 256
ONE_STEP = TrainFreq(1, TrainFrequencyUnit.STEP)
ENDLESS = 10**12  # steps; the training loop ends a run


class SacRun(TrainingRun):
    """One training run of Stable-Baselines3's SAC."""

    form = FORMAT

    def __init__(self, folder: Path, config: Config, seed: int, social: bool) -> None:
        super().__init__(folder, config, seed, social)
        settings = config.training
        count = settings.environments
        self.envs = VectorEnv(count, self.sampler, config.perception.geometry)
        labelled = np.arange(count - settings.labelled_environments, count)
        self.experts = Experts(settings.expert, self.envs, labelled)
        features = {
            "cells": config.perception.cells, "settings": config.model,
            "bfloat16": settings.bfloat16,
        }  # fmt: skip
        target = config.loss.entropy_target
        self.model = SAC(
            "MultiInputPolicy",
            CrowdVecEnv(self.envs, self.sampler, self.experts),
            learning_rate=settings.learning_rate,
            # With demonstrations there is something to learn from, and a policy, at once.
            learning_starts=0 if self.demonstrations else settings.warmup,
            batch_size=BATCH,
            tau=settings.target_rate,
            gamma=config.loss.discount,
            replay_buffer_class=CrowdReplay,
            replay_buffer_kwargs={"config": config, "replay": self.replay, "draw": self.sample},
            ent_coef=f"auto_{config.loss.entropy}",
            target_entropy="auto" if target is None else target,
            policy_kwargs={
                "net_arch": [config.model.hidden, config.model.hidden],
                "features_extractor_class": MapFeatures,
                "features_extractor_kwargs": features,
            },
            seed=seed,
            device="cpu",
        )
        assert isinstance(self.model.replay_buffer, CrowdReplay)
        self._buffer = self.model.replay_buffer
        self.model.set_logger(Logger(None, []))
        self.model.lr_schedule = lambda _progress: (
            settings.learning_rate * config.learning_rate_factor(self.updates)
        )
        self.model.actor.optimizer.register_step_pre_hook(lambda *_: self.imitate())

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self.model.num_timesteps

    @property
    def updates(self) -> int:
        """Updates so far."""
        return self.model._n_updates

    @property
    def decisions(self) -> int:
        """One per environment step."""
        return self.steps

    @property
    def updates_begin(self) -> bool:
        """Whether Stable-Baselines3 would begin to learn."""
        return self.steps > self.model.learning_starts

    def begin(self, say: Callable[[str], None], stopping: Callable[[], bool]) -> None:
        """Start an episode in every environment."""
        self.replay.mark_episode_ends(np.arange(self.envs.count))
        _, self._callback = self.model._setup_learn(ENDLESS, reset_num_timesteps=False)

    def step(self) -> None:
        """One control step in every environment."""
        model = self.model
        assert model.env is not None
        model.collect_rollouts(
            model.env, self._callback, ONE_STEP, self._buffer,
            learning_starts=model.learning_starts,
        )  # fmt: skip

    def update(self) -> dict[str, torch.Tensor]:
        """One update of critic, actor and entropy coefficient."""
        self.model.train(1, BATCH)
        return {}

    def imitate(self) -> None:
        """Add the gradient of expert_weight x |a - a_expert|^2, averaged over the batch.

        As in the latent planner's policy loss, a is drawn from the policy.
        """
        batch = self._buffer.sampled
        weight = self.config.expert_weight(self.updates)
        labelled = np.flatnonzero(batch.labelled[0])
        if weight == 0 or not len(labelled):
            return
        seen = {key: value[0][labelled] for key, value in batch.inputs._asdict().items()}
        action, _ = self.model.actor.action_log_prob(seen)
        error = (action - batch.reference[0][labelled]).square().sum(dim=-1)
        (weight * error.sum() / len(batch.labelled[0])).backward()

    def check(self, terms: Mapping[str, float]) -> None:
        """Stop a training that has diverged.

        Raises:
            TrainingError: a parameter is not finite.
        """
        if not all(torch.isfinite(p).all() for p in self.model.policy.parameters()):
            raise TrainingError("a parameter is not finite; lower the learning rate and resume")

    def scalars(self) -> dict[str, float]:
        """The entropy coefficient."""
        return {"alpha": float(self._entropy()[0].detach().exp())}

    def actor(self) -> SacActor:
        """The present actor on its own."""
        source: Any = self.model.policy.actor
        actor = SacActor(self.config.perception.cells, self.config.model)
        actor.encoder.load_state_dict(source.features_extractor.encoder.state_dict())
        actor.hidden.load_state_dict(source.latent_pi.state_dict())
        actor.mean.load_state_dict(source.mu.state_dict())
        return actor.eval().requires_grad_(False)

    def policy(self) -> Act:
        """Act by the present actor, without noise."""
        actor = self.actor()

        def act(given: PolicyInput) -> NDArray[np.float32]:
            return actor(Inputs(*map(torch.from_numpy, given.sensed))).numpy()

        return act

    def tensors(self) -> dict[str, torch.Tensor]:
        """The actor's parameters."""
        return self.actor().state_dict()

    def state(self) -> dict[str, Any]:
        """Networks, optimisers and random state."""
        model, (log_alpha, optimizer) = self.model, self._entropy()
        return {
            "policy": model.policy.state_dict(),
            "actor_optimizer": model.actor.optimizer.state_dict(),
            "critic_optimizer": model.critic.optimizer.state_dict(),
            "alpha_optimizer": optimizer.state_dict(),
            "log_alpha": log_alpha.detach().clone(),
            "torch_rng": torch.get_rng_state(),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned."""
        model, (log_alpha, optimizer) = self.model, self._entropy()
        model.policy.load_state_dict(state["policy"])
        model.actor.optimizer.load_state_dict(state["actor_optimizer"])
        model.critic.optimizer.load_state_dict(state["critic_optimizer"])
        optimizer.load_state_dict(state["alpha_optimizer"])
        with torch.no_grad():
            log_alpha.copy_(state["log_alpha"])
        torch.set_rng_state(state["torch_rng"])
        model.num_timesteps, model._n_updates = state["steps"], state["updates"]

    def spent(self) -> dict[str, float]:
        """Nothing is measured."""
        return {}

    def close(self) -> None:
        """Nothing was started."""

    def _entropy(self) -> tuple[torch.Tensor, torch.optim.Optimizer]:
        """Logarithm of the entropy coefficient and its optimiser, there because it is tuned."""
        log_alpha, optimizer = self.model.log_ent_coef, self.model.ent_coef_optimizer
        assert log_alpha is not None
        assert optimizer is not None
        return log_alpha, optimizer


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
    return training.train_run(
        SacRun, name, config,
        minutes=minutes, steps=steps, resume=resume, seed=seed, social=social,
    )  # fmt: skip
