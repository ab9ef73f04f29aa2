"""The world model: encoder, dynamics, reward, end, twin Q and policy, all in latent space.

Symbols as in the paper, section III: z = h(o) is the latent state, a the action normalised to
[-1, 1]^2, d the dynamics, R the reward, Q the value, pi the policy. Nothing is decoded and nothing
is sampled in the latent space.
"""

from __future__ import annotations

import itertools
import math
from typing import Literal, NamedTuple

import numpy as np
import torch
from crowdbench_agents.latent_planner.config import Model
from crowdbench_agents.perception import FRAMES, reflect
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import layer_norm, softplus

import crowdbench

ACTION = 2
REFLECT = torch.tensor([1.0, -1.0])
"""Factors on (x, y) or (v, w) that swap left and right."""

_LOG_STD = (-4.0, 0.5)  # of the policy before tanh
_DISTANCE_SCALE = 5.0  # [m], brings goal features near one


class Inputs(NamedTuple):
    """A batch of observations; leading dimensions (...) are equal.

    Attributes:
        map: (..., cells, cells) uint8, see crowdbench_agents.perception.
        velocity: (..., 2) v [m/s], w [rad/s].
        goal: (..., 2) goal in the robot frame [m].
    """

    map: Tensor
    velocity: Tensor
    goal: Tensor

    def reflected(self) -> Inputs:
        """The same with left and right swapped."""
        turned = torch.from_numpy(reflect(self.map.numpy()))
        return Inputs(turned, self.velocity * REFLECT, self.goal * REFLECT)


class ActionBounds(NamedTuple):
    """Converts actions normalised to [-1, 1] to v [m/s], w [rad/s] and back."""

    centre: NDArray[np.float32]
    half: NDArray[np.float32]

    @classmethod
    def of(cls, robot: crowdbench.RobotSpec) -> ActionBounds:
        """The bounds of a robot."""
        low, high = np.array([robot.speed, robot.turn_rate], np.float32).T
        return cls((low + high) / 2, (high - low) / 2)

    def physical(self, action: NDArray[np.floating]) -> NDArray[np.floating]:
        """(..., 2) normalised -> v [m/s], w [rad/s]."""
        return action * self.half + self.centre

    def normalised(self, action: NDArray[np.floating]) -> NDArray[np.floating]:
        """(..., 2) v [m/s], w [rad/s] -> normalised."""
        return (action - self.centre) / self.half


class Mlp(nn.Sequential):
    """Linear layers with SiLU between, each hidden one behind a LayerNorm where asked for.

    ``exact`` keeps the last layer in float32 under autocast: values need more than 8 bits.
    """

    def __init__(self, sizes: list[int], norm: bool, exact: bool = True) -> None:
        layers: list[nn.Module] = []
        for inside, outside in itertools.pairwise(sizes[:-1]):
            layers += [nn.Linear(inside, outside), *([nn.LayerNorm(outside)] * norm), nn.SiLU()]
        super().__init__(*layers, nn.Linear(sizes[-2], sizes[-1]))
        self._exact = exact

    def forward(self, x: Tensor) -> Tensor:
        """(..., inputs) -> (..., outputs)."""
        *hidden, last = self
        for layer in hidden:
            x = layer(x)
        if not self._exact:
            return last(x)
        with torch.autocast("cpu", enabled=False):
            return last(x.float())

    def start_at_zero(self) -> Mlp:
        """Zero the last layer, so that the network starts as the constant 0."""
        last = self[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        return self


class Encoder(nn.Module):
    """h: f_map (4-layer CNN), f_vel and f_goal, concatenated and fused into z.

    Args:
        cells: cells along each side of the map.
        latent: features of z.
        form: of f_map. "coarse" has 3D kernels whose first layer takes patches of 4 x 4 cells and
            4 frames. In "fine" the first layer takes patches of 4 x 4 cells at every second cell
            and all 8 frames at once, so that what moves is seen before resolution is lost; it
            foresees collisions better (docs/training.md) at twice the arithmetic.
    """

    def __init__(self, cells: int, latent: int, form: Literal["coarse", "fine"]) -> None:
        super().__init__()
        self._fine = form == "fine"
        self.f_map = _fine_map() if self._fine else _coarse_map()
        self.f_vel = nn.Sequential(nn.Linear(2, 32), nn.SiLU())
        self.f_goal = nn.Sequential(nn.Linear(5, 64), nn.SiLU())
        features = 64 * (cells // 8) ** 2 if self._fine else 128 * (cells // 16) ** 2
        self.fuse = nn.Linear(features + 32 + 64, latent)
        self.register_buffer("_bits", torch.arange(FRAMES, dtype=torch.uint8), persistent=False)

    def forward(self, inputs: Inputs) -> Tensor:
        """Inputs (B, ...) -> features (B, latent), not yet normalised."""
        frames = (inputs.map.unsqueeze(-3) >> self._bits.view(-1, 1, 1)) & 1
        frames = frames.to(self.fuse.weight.dtype)
        if self._fine:
            frames = frames.contiguous(memory_format=torch.channels_last)
        else:
            frames = frames.unsqueeze(1)
        distance = inputs.goal.norm(dim=-1, keepdim=True).clamp(min=1e-3)
        goal = torch.cat(
            [inputs.goal / _DISTANCE_SCALE, distance / _DISTANCE_SCALE, inputs.goal / distance], -1
        )
        parts = [self.f_map(frames), self.f_vel(inputs.velocity), self.f_goal(goal)]
        return self.fuse(torch.cat(parts, dim=-1))


def _coarse_map() -> nn.Sequential:
    """(B, 1, 8, cells, cells) -> (B, 128 (cells / 16)^2); two frames are left after two layers."""
    return nn.Sequential(
        nn.Conv3d(1, 16, kernel_size=4, stride=(2, 4, 4), padding=(1, 0, 0)),
        nn.SiLU(),
        nn.Conv3d(16, 32, kernel_size=3, stride=2, padding=1),
        nn.SiLU(),
        nn.Conv3d(32, 64, kernel_size=(2, 3, 3), stride=2, padding=(0, 1, 1)),
        nn.SiLU(),
        nn.Conv3d(64, 128, kernel_size=(1, 3, 3), padding=(0, 1, 1)),
        nn.SiLU(),
        nn.Flatten(),
    ).to(memory_format=torch.channels_last_3d)


def _fine_map() -> nn.Sequential:
    """(B, 8, cells, cells) -> (B, 64 (cells / 8)^2).

    A 3D kernel over all frames is a 2D one with the frames as channels, which is faster.
    """
    return nn.Sequential(
        nn.Conv2d(FRAMES, 32, kernel_size=4, stride=2, padding=1),
        nn.SiLU(),
        nn.Conv2d(32, 64, kernel_size=4, stride=2, padding=1),
        nn.SiLU(),
        nn.Conv2d(64, 64, kernel_size=3, stride=2, padding=1),
        nn.SiLU(),
        nn.Conv2d(64, 64, kernel_size=3, padding=1),
        nn.SiLU(),
        nn.Flatten(),
    ).to(memory_format=torch.channels_last)


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
            [latent + ACTION, model.dynamics_hidden, latent], norm=False, exact=False
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
        change = self.dynamics(torch.cat([z, action], dim=-1))
        return self.normalise(z + change if self.settings.dynamics == "residual" else change)

    def reward_and_end(self, z: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """R(z, a) (...,) and the logit (...,) that the episode ends (arrival, collision) by a."""
        reward, end = self.outcome(torch.cat([z, action], dim=-1)).unbind(dim=-1)
        return reward, end

    def q(self, z: Tensor, action: Tensor) -> Tensor:
        """Q(z, a): both estimates, (2, ...)."""
        joint = torch.cat([z, action], dim=-1)
        return torch.stack([network(joint).squeeze(-1) for network in self.q_networks])

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
        mean, log_std = self.policy(z)
        before = mean + log_std.exp() * noise
        log_prob = -0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi)
        # log(1 - tanh(x)^2) written so that it neither overflows nor cancels
        log_slope = 2 * (math.log(2) - before - softplus(-2 * before))
        return torch.tanh(before), (log_prob - log_slope).sum(dim=-1)
