"""Which arithmetic networks are trained in: bfloat16 where it is asked for and the CPU has it."""

from __future__ import annotations

import torch

NO_INSTRUCTIONS = "this CPU has no instructions for bfloat16, in which it would be slower"


def cpu_has_bfloat16() -> bool:
    """Whether this CPU multiplies bfloat16 numbers faster than float32 ones.

    Without instructions of its own (AVX512-BF16) every product is emulated: an update took 14
    times as long. oneDNN, which runs the products, may also have been kept from using them
    (``ONEDNN_MAX_CPU_ISA``).
    """
    # PyTorch's public functions tell neither in the oldest version that is supported.
    instructions: bool = torch.cpu._is_avx512_bf16_supported()
    return instructions and _onednn_uses_bfloat16()


def training_precision(bfloat16: bool, device: str = "cpu") -> torch.autocast:
    """The context in which networks are evaluated in training; may be entered again and again.

    Args:
        bfloat16: whether it is asked for; without it everything is float32.
        device: where they are.
    """
    able = device != "cpu" or cpu_has_bfloat16()
    return torch.autocast(device, torch.bfloat16, enabled=bfloat16 and able)


def describe_precision(bfloat16: bool, device: str = "cpu") -> str:
    """What ``training_precision`` chooses, in words, and why."""
    if not bfloat16:
        return "float32"
    if device != "cpu":
        return "bfloat16"
    return "bfloat16" if cpu_has_bfloat16() else f"float32 ({NO_INSTRUCTIONS})"


def _onednn_uses_bfloat16() -> bool:
    uses: bool = torch.ops.mkldnn._is_mkldnn_bf16_supported()
    return uses
