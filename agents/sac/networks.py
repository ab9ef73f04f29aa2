"""SAC's networks: actor and critic, each with the shared encoder in front of MLPs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import torch
from crowdbench_agents.learning.config import Config, Model
from crowdbench_agents.learning.encoder import Encoder
from crowdbench_agents.learning.inputs import ACTION, Inputs
from crowdbench_agents.learning.precision import training_precision
from crowdbench_agents.learning.weights import load_network
from torch import Tensor, nn
from torch.nn.functional import layer_norm

FORMAT = "crowdbench-sac-actor-1"

_LOG_STD = (-20.0, 2.0)  # of the policy before tanh
_TANH_SLOPE = 1e-6  # added to it, so that its logarithm is finite


def encode(encoder: Encoder, inputs: Inputs, bfloat16: bool) -> Tensor:
    """Inputs (B, ...) -> features (B, latent) in float32.

    Args:
        encoder: the only part that is ever evaluated in bfloat16.
        inputs: observations.
        bfloat16: whether it is asked for, see ``training_precision``.
    """
    with training_precision(bfloat16, inputs.goal.device.type):
        z = encoder(inputs)
    return normalise(z)


def normalise(z: Tensor) -> Tensor:
    """What an encoder returned (B, latent) -> features (B, latent) in float32."""
    return layer_norm(z.float(), z.shape[-1:])


class SacActor(nn.Module):
    """Observation -> mean action: the part of the policy that acts.

    Args:
        cells: cells along each side of the obstacle map.
        settings: form and sizes.
    """

    def __init__(self, cells: int, settings: Model) -> None:
        super().__init__()
        latent, hidden = settings.latent, settings.hidden
        self.encoder = Encoder(cells, latent, settings.encoder)
        self.hidden = nn.Sequential(
            nn.Linear(latent, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU()
        )
        self.mean = nn.Linear(hidden, ACTION)

    def forward(self, inputs: Inputs) -> Tensor:
        """Inputs (B, ...) -> actions (B, 2) in [-1, 1]."""
        return torch.tanh(self.mean(self.hidden(normalise(self.encoder(inputs)))))


class Policy(SacActor):
    """pi: a Gaussian whose mean and spread depend on the observation, squashed by tanh.

    Args:
        cells, settings: as for the actor.
    """

    def __init__(self, cells: int, settings: Model) -> None:
        super().__init__(cells, settings)
        self.log_std = nn.Linear(settings.hidden, ACTION)

    def sample(self, features: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Draw a = tanh(mean + std * noise); noise (B, 2) is standard normal.

        Returns:
            The action (B, 2) and log pi(a given the observation) (B,), the tanh included.
        """
        hidden = self.hidden(features)
        log_std = self.log_std(hidden).clamp(*_LOG_STD)
        action = torch.tanh(self.mean(hidden) + log_std.exp() * noise)
        log_prob = -0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi)
        log_slope = torch.log(1 - action.square() + _TANH_SLOPE)
        return action, (log_prob - log_slope).sum(dim=-1)

    def tensors(self) -> dict[str, Tensor]:
        """The parameters of what acts, a ``SacActor``."""
        return {
            name: tensor
            for name, tensor in self.state_dict().items()
            if not name.startswith("log_std.")
        }


def make_policy(config: Config) -> Policy:
    """The policy of a configuration, with random parameters."""
    return Policy(config.perception.cells, config.model)


class Critic(nn.Module):
    """Q: two estimates behind an encoder of their own.

    Args:
        cells, settings: as for the actor.
    """

    def __init__(self, cells: int, settings: Model) -> None:
        super().__init__()
        latent, hidden = settings.latent, settings.hidden
        self.encoder = Encoder(cells, latent, settings.encoder)
        self.q_networks = nn.ModuleList(
            nn.Sequential(
                nn.Linear(latent + ACTION, hidden), nn.ReLU(),
                nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, 1),
            )
            for _ in range(2)
        )  # fmt: skip

    def forward(self, features: Tensor, action: Tensor) -> Tensor:
        """Features (B, latent), actions (B, 2) -> both estimates (2, B)."""
        joint = torch.cat([features, action], dim=-1)
        return torch.stack([network(joint).squeeze(-1) for network in self.q_networks])


def load_actor(path: str | Path) -> tuple[SacActor, Config, dict[str, Any]]:
    """Make an actor from a weights file, as ``load_network`` does."""
    return load_network(
        Path(path), FORMAT, lambda config: SacActor(config.perception.cells, config.model)
    )
