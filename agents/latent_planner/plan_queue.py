"""What robots have planned and not yet executed."""

from __future__ import annotations

import numpy as np
import torch
from crowdbench_agents.learning.inputs import ACTION
from numpy.typing import NDArray
from torch import Tensor


class PlanQueue:
    """The latest plan of each of M robots, from which actions are taken one by one.

    Args:
        robots: M.
        horizon: H, actions in a plan.

    Attributes:
        taken: (M,) actions taken since each robot's plan was made.
    """

    def __init__(self, robots: int, horizon: int) -> None:
        self._plans = torch.zeros(robots, horizon, ACTION)
        self.taken = np.zeros(robots, np.int64)

    def clear(self, which: NDArray[np.integer]) -> None:
        """Forget the plans of robots (N,); theirs are zero now."""
        self._plans[which] = 0.0
        self.taken[which] = 0

    def put(self, which: NDArray[np.integer], plans: Tensor) -> None:
        """Replace the plans of robots (N,) by new ones (N, H, 2)."""
        self._plans[which] = plans
        self.taken[which] = 0

    def rest(self, which: NDArray[np.integer]) -> Tensor:
        """(N, H, 2) what is left of the plans of robots (N,), the last action repeated."""
        horizon = self._plans.shape[1]
        taken = torch.from_numpy(self.taken[which])
        steps = (torch.arange(horizon) + taken[:, None]).clamp(max=horizon - 1)
        return self._plans[which].gather(1, steps[..., None].expand(-1, -1, ACTION))

    def take(self, which: NDArray[np.integer]) -> Tensor:
        """(N, 2) the next action of robots (N,); behind a plan's end its last one goes on."""
        at = np.minimum(self.taken[which], self._plans.shape[1] - 1)
        actions = self._plans[torch.from_numpy(which), torch.from_numpy(at)]
        self.taken[which] += 1
        return actions
