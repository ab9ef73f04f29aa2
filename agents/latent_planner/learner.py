"""The learner: networks, optimisers and one update of each from a batch."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from crowdbench_agents.latent_planner.losses import (
    ModelLoss,
    encode_targets,
    model_loss,
    policy_loss,
)
from crowdbench_agents.latent_planner.world_model import WorldModel, make_world_model, squash
from crowdbench_agents.learning import kind
from crowdbench_agents.learning.batch import Batch
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.inputs import Inputs
from crowdbench_agents.learning.precision import training_precision
from crowdbench_agents.learning.validation import Act, PolicyInput
from numpy.typing import NDArray
from torch import Tensor

CPU = torch.device("cpu")

DEAD_SPREAD = 0.01
"""A latent state that differs less than this between observations tells nothing any more."""

_SCALE_RATE = 0.01  # of the running spread of Q


class Learner(kind.Learner):
    """Trains a world model and its policy.

    Args:
        config: all settings.
        seed: of the initial parameters and of the noise in the losses.
        device: where the networks are trained.
    """

    def __init__(self, config: Config, seed: int, device: torch.device = CPU) -> None:
        super().__init__(config, seed, device)
        self.count, self.horizon = config.training.batch, config.planner.horizon
        self.network = self.model = make_world_model(config).to(device)
        self.target = copy.deepcopy(self.model).requires_grad_(False)
        self._q_scale = torch.ones((), device=device)
        self._quantiles = torch.tensor([0.05, 0.95], device=device)
        self._parameters = {
            "encoder": list(self.model.encoder.parameters()),
            "rollout": [
                *self.model.dynamics.parameters(), *self.model.outcome.parameters(),
                *self.model.q_networks.parameters(),
            ],
            "policy": list(self.model.policy_network.parameters()),
        }  # fmt: skip
        rates = config.training
        slow = [*self.model.encoder.parameters(), *self.model.dynamics.parameters()]
        fast = [*self.model.outcome.parameters(), *self.model.q_networks.parameters()]
        groups: list[dict[str, Any]] = [
            {"params": slow, "lr": rates.learning_rate_model},
            {"params": fast},
        ]
        policy = self._parameters["policy"]
        optimizers = {
            "model": torch.optim.Adam(groups, lr=rates.learning_rate, fused=True),
            "policy": torch.optim.Adam(policy, lr=rates.learning_rate, fused=True),
            "alpha": torch.optim.Adam([self.log_alpha], lr=rates.learning_rate),
        }
        self._learn({"model": self.model, "target": self.target}, optimizers)
        self._model_loss, self._policy_loss = model_loss, policy_loss
        if device.type != "cpu":  # on a CPU compiling takes minutes and saves little
            self._model_loss = torch.compile(model_loss, dynamic=False)
            self._policy_loss = torch.compile(policy_loss, dynamic=False)

    @property
    def q_scale(self) -> float:
        """What Q is divided by in the policy's loss."""
        return float(self._q_scale)

    def update(self, batch: Batch) -> dict[str, Tensor]:
        """One step of the world model and one of the policy.

        Args:
            batch: sequences with unscaled rewards.

        Returns:
            The losses' terms, for the log.
        """
        loss, watch, model = self.config.loss, self.watch, self.model
        self._set_learning_rates()
        expert_weight = torch.tensor(
            self.config.expert_weight(self.updates), dtype=torch.float32, device=self.device
        )
        batch = batch._replace(reward=batch.reward * self.config.training.reward_scale)
        batch = batch.to(self.device)
        shape = batch.action.shape
        with watch("encoder"), self.precision():
            targets = encode_targets(self.target, batch, loss, self._noise(*shape))
            z = model.encode(Inputs(*(x[0] for x in batch.inputs)))
        start = z.detach().requires_grad_()
        with watch("rollout"):
            with self.precision():
                result = self._model_loss(model, start, targets, batch, loss, expert_weight)
            # The policy's part of the graph is needed once more, for its own loss.
            at_start, *gradients = torch.autograd.grad(
                result.total, [start, *self._parameters["rollout"]], retain_graph=True
            )
        with watch("encoder"):
            gradients = [
                *torch.autograd.grad(z, self._parameters["encoder"], at_start), *gradients
            ]  # fmt: skip
        terms = dict(result.terms)
        with watch("rollout"):
            trained = [*self._parameters["encoder"], *self._parameters["rollout"]]
            terms["model_gradient"] = self._step("model", trained, gradients)
        with watch("policy"):
            terms |= self._update_policy(result, batch, expert_weight)
            self._update_target(self.target, self.model)
        self.updates += 1
        return terms

    def _update_policy(
        self, result: ModelLoss, batch: Batch, expert_weight: Tensor
    ) -> dict[str, Tensor]:
        loss, alpha = self.config.loss, self.log_alpha.detach().exp()
        with self.precision():
            drawn = squash(*result.policy, self._noise(*batch.action.shape))
            actor = self._policy_loss(
                self.model, result.states, drawn, batch, loss, alpha, self._q_scale, expert_weight
            )
        policy = self._parameters["policy"]
        norm = self._step("policy", policy, torch.autograd.grad(actor.total, policy))
        low, high = torch.quantile(actor.values.flatten(), self._quantiles)
        self._q_scale += _SCALE_RATE * ((high - low).clamp(min=1.0) - self._q_scale)
        if loss.entropy_target is not None:
            excess = actor.terms["entropy"] - loss.entropy_target
            self._step("alpha", [self.log_alpha], [excess])  # the slope of log_alpha x excess
        return actor.terms | {"policy_gradient": norm}

    def check(self, terms: Mapping[str, float]) -> None:
        """Stop a training that has died.

        Args:
            terms: means of what ``update`` returned.

        Raises:
            TrainingError: a loss is not finite, or the latent state no longer varies.
        """
        for name, value in terms.items():
            if not math.isfinite(value):
                raise TrainingError(
                    f"{name} is {value} after {self.updates} updates; lower the learning rates "
                    "or gradient_clip and resume from the last checkpoint"
                )
        if terms["latent_spread"] < DEAD_SPREAD:
            raise TrainingError(
                f"the latent state died after {self.updates} updates: it varies by "
                f"{terms['latent_spread']:.4f} between observations (at least {DEAD_SPREAD}); "
                "lower loss.consistency or use model.dynamics: residual"
            )

    def scalars(self) -> dict[str, float]:
        """Entropy coefficient and scale of Q."""
        return {"alpha": self.alpha, "q_scale": self.q_scale}

    def policy(self) -> Act:
        """Act by the present policy, without noise."""
        act = policy_act(self.model, self.device)

        def in_precision(given: PolicyInput) -> NDArray[np.float32]:
            with self.precision():
                return act(given)

        return in_precision

    def tensors(self) -> dict[str, Tensor]:
        """The world model's parameters."""
        return self.model.state_dict()

    def precision(self) -> torch.autocast:
        """The context in which networks are evaluated in training."""
        return training_precision(self.config.training.bfloat16, self.device.type)

    def state(self) -> dict[str, Any]:
        """Everything needed to continue, as tensors and numbers."""
        return {**super().state(), "q_scale": self._q_scale}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned."""
        super().restore(state)
        with torch.no_grad():
            self._q_scale.copy_(state["q_scale"])

    def _step(self, name: str, parameters: Sequence[Tensor], gradients: Sequence[Tensor]) -> Tensor:
        for parameter, gradient in zip(parameters, gradients, strict=True):
            parameter.grad = gradient
        norm = torch.nn.utils.clip_grad_norm_(parameters, self.config.training.gradient_clip)
        self._optimizers[name].step()
        return norm


def policy_act(model: WorldModel, device: torch.device = CPU) -> Act:
    """Act by a world model's policy alone, without noise."""

    @torch.no_grad()
    def act(given: PolicyInput) -> NDArray[np.float32]:
        inputs = Inputs(*(torch.from_numpy(x).to(device) for x in given.sensed))
        return model.act(model.encode(inputs)).cpu().numpy()

    return act
