"""Acting while training: actions drawn from the policy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from crowdbench_agents.learning import kind
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.inputs import ACTION, ActionBounds, Inputs, Sensed
from crowdbench_agents.learning.kind import Acts
from crowdbench_agents.learning.replay import NOBODY
from crowdbench_agents.sac.networks import Policy, encode
from numpy.typing import NDArray


class Explorer(kind.Explorer):
    """Acts in E environments, at random until a run without demonstrations has warmed up.

    Args:
        network: the policy that is being trained.
        config: all settings.
        bounds: of the robot's actions, which is not needed.
        lanes: (E,) numbers of its environments among all those of the run.
        seed: of all randomness in acting.
    """

    def __init__(
        self,
        network: Policy,
        config: Config,
        bounds: ActionBounds,
        lanes: NDArray[np.integer],
        seed: int,
    ) -> None:
        self.decisions = 0
        self.generator = torch.Generator().manual_seed(seed)
        self._network, self._config, self._count = network, config, len(lanes)
        settings = config.training
        self._random = 0 if settings.demonstrations else settings.warmup

    def begin(self, which: NDArray[np.integer], velocity: NDArray[np.float32]) -> None:
        """Nothing goes on from one step to the next."""

    @torch.no_grad()
    def act(self, sensed: Sensed) -> Acts:
        """The next action of every environment; nothing of it is to be imitated."""
        shape, at_random = (self._count, ACTION), self.decisions < self._random
        self.decisions += self._count
        if at_random:
            action = 2 * torch.rand(shape, generator=self.generator) - 1
        else:
            inputs = Inputs(*map(torch.from_numpy, sensed))
            features = encode(self._network.encoder, inputs, self._config.training.bfloat16)
            noise = torch.randn(shape, generator=self.generator)
            action, _ = self._network.sample(features, noise)
        nobody = np.full(self._count, NOBODY, np.uint8)
        return Acts(action.numpy(), np.zeros(shape, np.float32), nobody)

    def state(self) -> dict[str, Any]:
        """Counter and random state."""
        return {"decisions": self.decisions, "generator": self.generator.get_state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned."""
        self.decisions = state["decisions"]
        self.generator.set_state(state["generator"])
