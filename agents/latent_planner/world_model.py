"""The world model: encoder, dynamics, reward, end, twin Q and policy, all in latent space.

Symbols as in the paper, section III: z = h(o) is the latent state, a the action normalised to
[-1, 1]^2, d the dynamics, R the reward, Q the value, pi the policy. Nothing is decoded and nothing
is sampled in the latent space.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any, cast

import torch
from crowdbench_agents.learning.config import Config, Model
from crowdbench_agents.learning.encoder import Encoder
from crowdbench_agents.learning.inputs import ACTION, Inputs
from crowdbench_agents.learning.weights import load_network
from torch import Tensor, nn
from torch.nn.functional import layer_norm, linear, softplus

FORMAT = "crowdbench-world-model-1"
"""Of weights files that hold a world model."""

_LOG_STD = (-4.0, 0.5)  # of the policy before tanh


class Mlp(nn.Sequential):
    """Linear layers with SiLU between, each hidden one behind a LayerNorm where asked for.

    ``float32_output`` keeps the last layer in float32 under autocast: values need more than 8 bits.
    """

    def __init__(self, sizes: list[int], norm: bool, float32_output: bool = True) -> None:
        layers: list[nn.Module] = []
        for inside, outside in itertools.pairwise(sizes[:-1]):
            layers += [nn.Linear(inside, outside), *([nn.LayerNorm(outside)] * norm), nn.SiLU()]
        super().__init__(*layers, nn.Linear(sizes[-2], sizes[-1]))
        self._float32_output = float32_output

    def forward(self, x: Tensor) -> Tensor:
        """(..., inputs) -> (..., outputs)."""
        return self.behind_first(self[0](x))

    def behind_first(self, x: Tensor) -> Tensor:
        """The outputs for what the first layer returns."""
        *hidden, last = self
        for layer in hidden[1:]:
            x = layer(x)
        if not self._float32_output:
            return last(x)
        with torch.autocast(x.device.type, enabled=False):
            return last(x.float())

    def start_at_zero(self) -> Mlp:
        """Zero the last layer, so that the network starts as the constant 0."""
        last = self[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        return self


class WorldModel(nn.Module):
    """All networks of the planner.

    Args:
        model: sizes and forms.
        cells: cells along each side of the obstacle map.
    """

    def __init__(self, model: Model, cells: int) -> None:
        super().__init__()
        self.settings = model
        latent, hidden = model.latent, model.hidden
        self.encoder = Encoder(cells, latent, model.encoder)
        self.dynamics = Mlp(
            [latent + ACTION, model.dynamics_hidden, latent], norm=False, float32_output=False
        )
        if model.dynamics == "residual":
            self.dynamics.start_at_zero()
        self.outcome = Mlp([latent + ACTION, hidden, 2], norm=False).start_at_zero()
        self.q_networks = nn.ModuleList(
            Mlp([latent + ACTION, hidden, hidden, 1], norm=True).start_at_zero() for _ in range(2)
        )
        self.policy_network = Mlp([latent, hidden, hidden, 2 * ACTION], norm=True)

    def normalise(self, z: Tensor) -> Tensor:
        """The latent state's normalisation."""
        if self.settings.latent_norm == "layer":
            return layer_norm(z, z.shape[-1:])
        if self.settings.latent_norm == "simplex":
            return z.unflatten(-1, (-1, 8)).softmax(dim=-1).flatten(-2)
        return z

    def encode(self, inputs: Inputs) -> Tensor:
        """z = h(o): inputs (..., ) -> (..., latent)."""
        lead = inputs.goal.shape[:-1]
        flat = Inputs(inputs.map.flatten(0, -3), *(x.reshape(-1, 2) for x in inputs[1:]))
        return self.normalise(self.encoder(flat)).float().unflatten(0, lead)

    def next(self, z: Tensor, action: Tensor) -> Tensor:
        """z' = d(z, a): (..., latent), (..., 2) -> (..., latent)."""
        return self.advance(z, self.dynamics(torch.cat([z, action], dim=-1)))

    def advance(self, z: Tensor, change: Tensor) -> Tensor:
        """The next state, for what the dynamics network returns in z."""
        return self.normalise(z + change if self.settings.dynamics == "residual" else change)

    def reward_and_end(self, z: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """R(z, a) (...,) and the logit (...,) that the episode ends (arrival, collision) by a."""
        reward, end = self.outcome(torch.cat([z, action], dim=-1)).unbind(dim=-1)
        return reward, end

    def q(self, z: Tensor, action: Tensor) -> Tensor:
        """Q(z, a): both estimates, (2, ...)."""
        joint = torch.cat([z, action], dim=-1)
        return torch.stack([network(joint).squeeze(-1) for network in self.q_networks])

    def q_along_action(self, z: Tensor, action: Tensor) -> Tensor:
        """Q(z, a) as ``q``, up to rounding, for less where only the action has a gradient.

        The first layers' products for z and for a are apart, and that of z has none.
        """
        states, actions = z.flatten(0, -2), action.flatten(0, -2)
        values = []
        for network in self.q_networks:
            first = cast(nn.Linear, cast(Mlp, network)[0])
            for_z, for_action = first.weight.split([z.shape[-1], ACTION], dim=1)
            x = torch.addmm(linear(states, for_z, first.bias), actions, for_action.t())
            values.append(cast(Mlp, network).behind_first(x).squeeze(-1))
        return torch.stack(values).unflatten(1, z.shape[:-1])

    def policy(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log standard deviation of pi before tanh, (..., 2) each."""
        mean, spread = self.policy_network(z).float().chunk(2, dim=-1)
        low, high = _LOG_STD
        return mean, low + (high - low) * (torch.tanh(spread) + 1) / 2

    def act(self, z: Tensor) -> Tensor:
        """The policy's action without noise, (..., 2) in [-1, 1]."""
        return torch.tanh(self.policy(z)[0])

    def sample(self, z: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Draw a = tanh(mean + std * noise); noise (..., 2) is standard normal.

        Returns:
            The action (..., 2) and log pi(a given z) (...,), the tanh included.
        """
        return squash(*self.policy(z), noise)


def squash(mean: Tensor, log_std: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """a = tanh(mean + std * noise) and log pi(a given z), see ``WorldModel.sample``."""
    before = mean + log_std.exp() * noise
    log_prob = -0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi)
    # log(1 - tanh(x)^2) written so that it neither overflows nor cancels
    log_slope = 2 * (math.log(2) - before - softplus(-2 * before))
    return torch.tanh(before), (log_prob - log_slope).sum(dim=-1)


def make_world_model(config: Config) -> WorldModel:
    """The world model of a configuration, with random parameters."""
    return WorldModel(config.model, config.perception.cells)


def load_world_model(path: str | Path) -> tuple[WorldModel, Config, dict[str, Any]]:
    """Make a world model from a weights file, as ``load_network`` does."""
    return load_network(Path(path), FORMAT, make_world_model)
