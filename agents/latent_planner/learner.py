"""The learner: networks, optimisers and one update of each from a batch."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from crowdbench_agents.latent_planner.losses import model_loss, policy_loss
from crowdbench_agents.latent_planner.world_model import WorldModel
from crowdbench_agents.learning import kind
from crowdbench_agents.learning.batch import Batch
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.inputs import Inputs
from crowdbench_agents.learning.precision import training_precision
from crowdbench_agents.learning.stopwatch import Stopwatch
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
        torch.manual_seed(seed)
        self.config = config
        self.count, self.horizon = config.training.batch, config.planner.horizon
        self.watch = Stopwatch()
        self.generator = torch.Generator().manual_seed(seed)
        self.model = WorldModel(config.model, config.perception.cells)
        self.target = copy.deepcopy(self.model).requires_grad_(False)
        self.q_scale = 1.0
        self.updates = 0
        entropy = max(config.loss.entropy, 1e-8)
        self.log_alpha = torch.tensor(math.log(entropy), requires_grad=True)
        rates = config.training
        slow = [*self.model.encoder.parameters(), *self.model.dynamics.parameters()]
        fast = [*self.model.outcome.parameters(), *self.model.q_networks.parameters()]
        self._model_parameters = [*slow, *fast]
        self._policy_parameters = list(self.model.policy_network.parameters())
        groups: list[dict[str, Any]] = [
            {"params": slow, "lr": rates.learning_rate_model},
            {"params": fast},
        ]
        self._optimizers = {
            "model": torch.optim.Adam(groups, lr=rates.learning_rate, fused=True),
            "policy": torch.optim.Adam(self._policy_parameters, lr=rates.learning_rate, fused=True),
            "alpha": torch.optim.Adam([self.log_alpha], lr=rates.learning_rate),
        }
        self._rates = {
            name: [group["lr"] for group in optimizer.param_groups]
            for name, optimizer in self._optimizers.items()
        }

    @property
    def network(self) -> WorldModel:
        """The world model."""
        return self.model

    @property
    def alpha(self) -> float:
        """Entropy coefficient."""
        return float(self.log_alpha.detach().exp())

    def update(self, batch: Batch) -> dict[str, Tensor]:
        """One step of the world model and one of the policy.

        Args:
            batch: sequences with unscaled rewards.

        Returns:
            The losses' terms, for the log.
        """
        loss = self.config.loss
        expert_weight = self.config.expert_weight(self.updates)
        self._set_learning_rates()
        batch = batch._replace(reward=batch.reward * self.config.training.reward_scale)
        with self.precision():
            result = model_loss(
                self.model, self.target, batch, loss, self._noise(batch.action.shape),
                expert_weight,
            )  # fmt: skip
        terms = dict(result.terms)
        terms["model_gradient"] = self._step("model", result.total, self._model_parameters)

        self._train_only_policy(True)
        with self.precision():
            actor = policy_loss(
                self.model, result.latents, batch, loss, self.alpha, self.q_scale,
                self._noise(batch.action.shape), expert_weight,
            )  # fmt: skip
        terms |= actor.terms
        terms["policy_gradient"] = self._step("policy", actor.total, self._policy_parameters)
        self._train_only_policy(False)
        self._update_scale(actor.values)
        if loss.entropy_target is not None:
            excess = actor.terms["entropy"] - loss.entropy_target
            self._step("alpha", self.log_alpha * excess, [self.log_alpha])
        self._update_target()
        self.updates += 1
        return terms

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
        act = policy_act(self.model)

        def in_precision(given: PolicyInput) -> NDArray[np.float32]:
            with self.precision():
                return act(given)

        return in_precision

    def tensors(self) -> dict[str, Tensor]:
        """The world model's parameters."""
        return self.model.state_dict()

    def precision(self) -> torch.autocast:
        """The context in which networks are evaluated in training."""
        return training_precision(self.config.training.bfloat16)

    def state(self) -> dict[str, Any]:
        """Everything needed to continue, as tensors and numbers."""
        return {
            "model": self.model.state_dict(),
            "target": self.target.state_dict(),
            "optimizers": {name: o.state_dict() for name, o in self._optimizers.items()},
            "log_alpha": self.log_alpha.detach().clone(),
            "q_scale": self.q_scale,
            "updates": self.updates,
            "generator": self.generator.get_state(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned."""
        self.model.load_state_dict(state["model"])
        self.target.load_state_dict(state["target"])
        for name, optimizer in self._optimizers.items():
            optimizer.load_state_dict(state["optimizers"][name])
        with torch.no_grad():
            self.log_alpha.copy_(state["log_alpha"])
        self.q_scale, self.updates = state["q_scale"], state["updates"]
        self.generator.set_state(state["generator"])

    def _set_learning_rates(self) -> None:
        factor = self.config.learning_rate_factor(self.updates)
        for name, optimizer in self._optimizers.items():
            for group, rate in zip(optimizer.param_groups, self._rates[name], strict=True):
                group["lr"] = rate * factor

    def _noise(self, shape: torch.Size) -> Tensor:
        return torch.randn(shape, generator=self.generator)

    def _step(self, name: str, loss: Tensor, parameters: list[Any]) -> Tensor:
        optimizer = self._optimizers[name]
        optimizer.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(parameters, self.config.training.gradient_clip)
        optimizer.step()
        return norm

    def _train_only_policy(self, only: bool) -> None:
        """Spare the gradients of Q's parameters while its value is what the policy follows."""
        self.model.q_networks.requires_grad_(not only)

    def _update_scale(self, values: Tensor) -> None:
        low, high = torch.quantile(values.flatten(), torch.tensor([0.05, 0.95]))
        spread = max(float(high - low), 1.0)
        self.q_scale += _SCALE_RATE * (spread - self.q_scale)

    @torch.no_grad()
    def _update_target(self) -> None:
        rate = self.config.training.target_rate
        slow: list[Tensor] = list(self.target.parameters())
        fast: list[Tensor] = list(self.model.parameters())
        torch._foreach_lerp_(slow, fast, rate)


def policy_act(model: WorldModel) -> Act:
    """Act by a world model's policy alone, without noise."""

    @torch.no_grad()
    def act(given: PolicyInput) -> NDArray[np.float32]:
        return model.act(model.encode(Inputs(*map(torch.from_numpy, given.sensed)))).numpy()

    return act
