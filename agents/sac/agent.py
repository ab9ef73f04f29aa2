"""Soft Actor-Critic as an agent: the trained actor's mean action."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from crowdbench_agents.learning.agent import LearnedAgent
from numpy.typing import NDArray

if TYPE_CHECKING:
    from crowdbench_agents.learning.config import Config
    from crowdbench_agents.learning.inputs import Inputs
    from crowdbench_agents.sac.networks import SacActor
    from torch import Tensor


class Sac(LearnedAgent):
    """Maps what it sees to an action, without planning.

    Args:
        weights: name of shipped weights, or path of a ``.safetensors`` file.
    """

    version: ClassVar[str] = "0.1.0"
    trainer: ClassVar[str] = "sac"
    folder: ClassVar[Path] = Path(__file__).parent / "weights"

    def __init__(self, *, weights: str = "sac") -> None:
        super().__init__(weights)

    def _choose(self, inputs: Inputs) -> NDArray[np.float32]:
        actor: SacActor = self._network
        return actor(inputs)[0].numpy()

    def _policy(self) -> Callable[[Inputs], Tensor]:
        actor: SacActor = self._network
        return actor

    def _load(self, path: Path) -> tuple[SacActor, Config, dict[str, Any]]:
        from crowdbench_agents.sac.networks import load_actor

        return load_actor(path)
