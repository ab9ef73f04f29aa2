"""Training of SAC: what learns and what acts, for the loop of all learned agents."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from crowdbench_agents.learning import training
from crowdbench_agents.learning.config import load_config
from crowdbench_agents.learning.kind import Kind
from crowdbench_agents.learning.settings import RunSettings
from crowdbench_agents.sac.exploration import Explorer
from crowdbench_agents.sac.learner import Learner
from crowdbench_agents.sac.networks import FORMAT, make_policy

KIND = Kind(FORMAT, Learner, make_policy, Explorer)


def train(
    name: str = "sac",
    minutes: float | None = None,
    steps: int | None = None,
    resume: bool = False,
    seed: int | None = None,
    social: bool | None = None,
    overrides: Mapping[str, Any] | None = None,
    device: str = "auto",
    actors: int | None = None,
) -> Path:
    """Train SAC; see ``learning.training.train``.

    Args:
        name, minutes, steps, resume, seed, social, device, actors: as there.
        overrides: fields of the shipped configuration, e.g. ``{"training.warmup": 0}``.
    """
    return training.train(
        KIND, name, RunSettings("sac", load_config()),
        overrides=overrides, minutes=minutes, steps=steps, resume=resume, seed=seed, social=social,
        device=device, actors=actors,
    )  # fmt: skip
