"""Training of the TD-MPC-style baseline: the latent planner's trainer with other settings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from crowdbench_agents.latent_planner.training import KIND
from crowdbench_agents.learning import training
from crowdbench_agents.learning.config import load_config
from crowdbench_agents.learning.settings import RunSettings

DIFFERENCES = {
    "loss.imitation": 0.0,
    "planner.smoothness_weight": 0.0,
    "training.planning_environments": 12,
    "training.replanned_states": 0.0,
}
"""No imitation of the planner and no smoothness term; the social reward is left out as well.

Nothing is planned again, since plans are not imitated; MPPI acts in more environments instead.
"""


def train(
    name: str = "tdmpc",
    minutes: float | None = None,
    steps: int | None = None,
    resume: bool = False,
    seed: int | None = None,
    social: bool | None = None,
    overrides: Mapping[str, Any] | None = None,
    device: str = "auto",
    actors: int | None = None,
) -> Path:
    """Train the TD-MPC-style baseline; arguments as for the latent planner."""
    return training.train(
        KIND, name, RunSettings("tdmpc", load_config().override(DIFFERENCES), social=False),
        overrides=overrides, minutes=minutes, steps=steps, resume=resume, seed=seed, social=social,
        device=device, actors=actors,
    )  # fmt: skip
