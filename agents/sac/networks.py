"""The trained SAC actor, without Stable-Baselines3: the shared encoder and an MLP."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from crowdbench_agents.learning.config import Config, Model
from crowdbench_agents.learning.encoder import Encoder
from crowdbench_agents.learning.inputs import ACTION, Inputs
from crowdbench_agents.learning.weights import load_network
from torch import Tensor, nn
from torch.nn.functional import layer_norm

FORMAT = "crowdbench-sac-actor-1"


class SacActor(nn.Module):
    """Observation -> mean action; the layout of the actor that Stable-Baselines3 trains.

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
        z = self.encoder(inputs)
        return torch.tanh(self.mean(self.hidden(layer_norm(z, z.shape[-1:]))))


def load_actor(path: str | Path) -> tuple[SacActor, Config, dict[str, Any]]:
    """Make an actor from a weights file, as ``load_network`` does."""
    return load_network(
        Path(path), FORMAT, lambda config: SacActor(config.perception.cells, config.model)
    )
