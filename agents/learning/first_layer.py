"""The first layer of the coarse encoder from the bits of the map, for training on a CPU.

Nine of ten cells of a map are empty, and where the layer's patches do not overlap, an occupied cell
adds one of 256 vectors per place in its patch to one patch: 256, since that is how many bytes there
are. Those vectors are tabled anew for each batch, and the rest is adding rows of the table up. The
result is the convolution's up to rounding, without unpacking the map.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import pad

import crowdbench
from crowdbench.compiled import compiled

FRAMES = crowdbench.ObstacleMaps.FRAMES

PATCH = 4
"""Cells along a side of a patch; kernel and stride of the layer."""
BYTES = 256


def convolve_bits(maps: Tensor, layer: nn.Conv3d) -> Tensor:
    """What the layer makes of the frames of some maps.

    Args:
        maps: (B, cells, cells) uint8, bit k of a cell is frame k.
        layer: of one input channel, with kernel 4 x 4 x 4, stride 2 x 4 x 4 and padding 1 x 0 x 0.

    Returns:
        (B, outputs, 4, cells / 4, cells / 4), channels last in memory.
    """
    assert layer.bias is not None
    with torch.autocast("cpu", enabled=False):
        table = _table(layer.weight)
    result: Tensor = _AddRows.apply(maps, table, layer.bias)
    return result.permute(0, 4, 1, 2, 3)


def _table(weight: Tensor) -> Tensor:
    """What a cell adds: (places in a patch, bytes, steps, outputs).

    A step of the output sees the frames 2 step - 1 .. 2 step + 2.
    """
    kernel, steps = weight[:, 0], FRAMES // 2
    frames = []
    for step in range(steps):
        first = 2 * step - 1
        seen = kernel[:, max(0, -first) : FRAMES - first]
        before = max(0, first)
        frames.append(pad(seen, (0, 0, 0, 0, before, FRAMES - before - seen.shape[1])))
    bits = (torch.arange(BYTES)[:, None] >> torch.arange(FRAMES)) & 1
    each = torch.stack(frames).flatten(3)  # steps, outputs, frames, places
    return torch.einsum("bf,sofp->pbso", bits.to(weight.dtype), each).contiguous()


class _AddRows(torch.autograd.Function):
    """Adds the rows of a table up, and the gradients of patches in turn to those of the rows."""

    @staticmethod
    def forward(ctx: Any, maps: Tensor, table: Tensor, bias: Tensor) -> Tensor:
        ctx.save_for_backward(maps)
        ctx.shape = table.shape
        count, cells = maps.shape[:2]
        side = cells // PATCH
        result = bias.detach().repeat(count, table.shape[2], side, side, 1)
        _exchange(maps.numpy(), table.detach().numpy(), result.numpy(), True)
        return result

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[None, Tensor, Tensor]:
        (maps,) = ctx.saved_tensors
        gradient = gradients[0].contiguous()
        rows = torch.zeros(ctx.shape)
        _exchange(maps.numpy(), rows.numpy(), gradient.numpy(), False)
        return None, rows, gradient.sum(dim=(0, 1, 2, 3))


@compiled(fastmath=True)
def _exchange(
    maps: NDArray[np.uint8],
    rows: NDArray[np.float32],
    patches: NDArray[np.float32],
    forward: bool,
) -> None:  # pragma: no cover
    """Add rows of the table to the patches in which something is, or patches to those rows."""
    for sample in range(maps.shape[0]):
        for i in range(maps.shape[1]):
            for j in range(maps.shape[2]):
                byte = maps[sample, i, j]
                if byte:
                    place = (i % PATCH) * PATCH + j % PATCH
                    for step in range(rows.shape[2]):
                        row = rows[place, byte, step]
                        patch = patches[sample, step, i // PATCH, j // PATCH]
                        if forward:
                            patch += row
                        else:
                            row += patch
