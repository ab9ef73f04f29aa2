"""What is learned from: sequences of steps, side by side."""

from __future__ import annotations

from typing import NamedTuple

import torch
from crowdbench_agents.learning.inputs import Inputs
from torch import Tensor


class Batch(NamedTuple):
    """B sequences of H steps, time first.

    Attributes:
        inputs: (H + 1, B, ...) observations.
        action: (H, B, 2) executed, in [-1, 1].
        reward: (H, B) the environment's, with or without the social term, less the price of
            detours.
        end: (H, B) 1 where the action ended the episode by arrival or collision.
        collision: (H, B) 1 where the action ended it by collision.
        valid: (H, B) 1 up to the end of the episode, 0 behind it.
        reference: (H, B, 2) what somebody else would have done, in [-1, 1].
        planned: (H, B) 1 where that is MPPI's plan.
        labelled: (H, B) 1 where that is the expert's label.
    """

    inputs: Inputs
    action: Tensor
    reward: Tensor
    end: Tensor
    collision: Tensor
    valid: Tensor
    reference: Tensor
    planned: Tensor
    labelled: Tensor

    def to(self, device: torch.device) -> Batch:
        """The same on a device; maps travel as bits and are unpacked there."""
        if device.type == "cpu":
            return self

        def move(tensor: Tensor) -> Tensor:
            return tensor.pin_memory().to(device, non_blocking=True)

        return Batch(Inputs(*map(move, self.inputs)), *map(move, self[1:]))


def join(first: Batch, second: Batch) -> Batch:
    """Two batches side by side."""

    def cat(a: Tensor, b: Tensor) -> Tensor:
        return torch.cat([a, b], dim=1)

    inputs = Inputs(*map(cat, first.inputs, second.inputs))
    return Batch(inputs, *map(cat, first[1:], second[1:]))
