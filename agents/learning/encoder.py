"""The encoder of all learned agents: from a batch of observations to features."""

from __future__ import annotations

from typing import Literal

import torch
from crowdbench_agents.learning.first_layer import convolve_bits
from crowdbench_agents.learning.inputs import Inputs
from torch import Tensor, nn

import crowdbench

FRAMES = crowdbench.ObstacleMaps.FRAMES
_DISTANCE_SCALE = 5.0  # [m], brings goal features near one


class Encoder(nn.Module):
    """h: f_map (4-layer CNN), f_vel and f_goal, concatenated and fused into z.

    Args:
        cells: cells along each side of the map.
        latent: features of z.
        form: of f_map. "coarse" has 3D kernels whose first layer takes patches of 4 x 4 cells and
            4 frames. In "fine" the first layer takes patches of 4 x 4 cells at every second cell
            and all 8 frames at once, so that what moves is seen before resolution is lost; it
            foresees collisions better (docs/training_notes.md) at twice the arithmetic.
    """

    _frame: Tensor

    def __init__(self, cells: int, latent: int, form: Literal["coarse", "fine"]) -> None:
        super().__init__()
        self._fine = form == "fine"
        self.f_map = _fine_map() if self._fine else _coarse_map()
        self.f_vel = nn.Sequential(nn.Linear(2, 32), nn.SiLU())
        self.f_goal = nn.Sequential(nn.Linear(5, 64), nn.SiLU())
        features = 64 * (cells // 8) ** 2 if self._fine else 128 * (cells // 16) ** 2
        self.fuse = nn.Linear(features + 32 + 64, latent)
        bits = torch.tensor([1 << frame for frame in range(FRAMES)], dtype=torch.uint8)
        self.register_buffer("_frame", bits.view(-1, 1, 1), persistent=False)

    def forward(self, inputs: Inputs) -> Tensor:
        """Inputs (B, ...) -> features (B, latent), not yet normalised."""
        distance = inputs.goal.norm(dim=-1, keepdim=True).clamp(min=1e-3)
        goal = torch.cat(
            [inputs.goal / _DISTANCE_SCALE, distance / _DISTANCE_SCALE, inputs.goal / distance], -1
        )
        parts = [self._see(inputs.map), self.f_vel(inputs.velocity), self.f_goal(goal)]
        return self.fuse(torch.cat(parts, dim=-1))

    def _see(self, maps: Tensor) -> Tensor:
        """f_map of maps (B, cells, cells)."""
        first = self.f_map[0]
        if self.training and not self._fine and maps.device.type == "cpu":
            assert isinstance(first, nn.Conv3d)
            return self.f_map[1:](convolve_bits(maps, first))
        frames = (maps.unsqueeze(-3) & self._frame).clamp(max=1)
        frames = frames.to(self.fuse.weight.dtype)
        if self._fine:
            frames = frames.contiguous(memory_format=torch.channels_last)
        else:
            frames = frames.unsqueeze(1)
        return self.f_map(frames)


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
    ).to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]


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
    ).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
