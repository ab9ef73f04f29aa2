"""A price on detours, taken off the rewards that are learned from."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.worlds import Worlds
from numpy.typing import NDArray


class Detour(NamedTuple):
    """What each metre costs that is driven beyond those gained towards the goal.

    Up to a potential (Ng, Harada and Russell 1999) it is a price on the length of the way, which is
    what SPL asks for, but going straight to the goal costs nothing.

    Attributes:
        metre: the price of a metre.
        period: duration of a step [s].
    """

    metre: float
    period: float

    def price(
        self, velocity: NDArray[np.float32], goal: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """(H, B) for velocities v [m/s], w [rad/s] and goals [m], as observed, (H + 1, B, 2)."""
        driven = np.abs(velocity[1:, :, 0]) * self.period  # observed after the step
        gained = -np.diff(np.linalg.norm(goal, axis=-1), axis=0)
        return np.float32(self.metre) * (driven - gained)


def require_straight_ways(price: float, worlds: Worlds) -> None:
    """Refuse a price of detours where the goal that is observed is not the end of the way.

    Args:
        price: of a metre.
        worlds: that are trained in.

    Raises:
        TrainingError: there is a price, and one of them has a map.
    """
    for name, scenarios in worlds.items() if price else ():
        if scenarios[0].arena.kind == "map":
            raise TrainingError(
                f"training.detour_price: {price:g}; allowed: 0 where {name!r} is trained in, since "
                "on a map the way to the goal is not straight"
            )


FREE = Detour(metre=0.0, period=0.0)
