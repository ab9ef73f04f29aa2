"""Where networks are trained, and how many processes act for them."""

from __future__ import annotations

import os

import torch
from crowdbench_agents.learning.errors import TrainingError

from crowdbench.messages import short


def find_device(name: str) -> torch.device:
    """The device of a name: ``auto`` takes a GPU where there is one.

    Raises:
        TrainingError: another name, or a GPU is asked for and there is none.
    """
    if name not in ("auto", "cpu", "cuda"):
        raise TrainingError(f"device: expected auto, cpu or cuda, got {short(name)}")
    if name == "cpu":
        return torch.device("cpu")
    if torch.cuda.is_available():
        return torch.device("cuda")
    if name == "auto":
        return torch.device("cpu")
    built = torch.version.cuda is not None
    why = "no GPU is found" if built else "this PyTorch is built without CUDA"
    raise TrainingError(f"device: cuda is asked for, but {why}; use auto or cpu")


def find_actors(count: int | None, environments: int, device: torch.device) -> int:
    """How many processes act.

    Args:
        count: how many are asked for; None leaves it to the machine: half of the cores beside a
            learner on the CPU, all but one beside one on a GPU.
        environments: of the run.
        device: of the learner.

    Raises:
        TrainingError: fewer than none, or more than there are environments.
    """
    if count is None:
        cores = core_count()
        return min(environments, cores // 2 if device.type == "cpu" else cores - 1)
    if not 0 <= count <= environments:
        raise TrainingError(
            f"actors: should be 0 to {environments} (training.environments), got {count}"
        )
    return count


def describe_actors(count: int) -> str:
    """Who acts, in words."""
    if not count:
        return "acting in the learner's process"
    return f"{count} actor{'s' * (count > 1)} of {core_count()} cores"


def learner_threads(actors: int, device: torch.device) -> int:
    """Threads for the learner: the cores that actors leave, where it learns on the CPU."""
    return max(1, core_count() - actors) if actors and device.type == "cpu" else 1


def core_count() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
