"""Validation while training: the policy's success on seeds that nothing else uses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import torch
from crowdbench_agents.latent_planner.config import Config
from crowdbench_agents.latent_planner.crowds import Crowds, Sensed
from crowdbench_agents.latent_planner.mppi import plan
from crowdbench_agents.latent_planner.world_model import ActionBounds, Inputs, WorldModel
from crowdbench_agents.perception import MapGeometry
from numpy.typing import NDArray

import crowdbench

FIRST_SEED = 900_000
ENVIRONMENTS = 64

Act = Callable[[Sensed, NDArray[np.float32]], NDArray[np.float32]]
"""Observations and current (v, w) in [-1, 1] of N environments -> actions (N, 2) in [-1, 1]."""


class Validation(NamedTuple):
    """How often an agent arrives.

    Attributes:
        success: share of successes by scenario.
        smoothness: mean squared change of (v [m/s], w [rad/s]) over all steps.
        seconds: mean time of the successful episodes [s].
    """

    success: dict[str, float]
    smoothness: float
    seconds: float

    @property
    def mean(self) -> float:
        """Mean success over scenarios."""
        return float(np.mean(list(self.success.values())))


def validate(
    act: Act, geometry: MapGeometry, episodes: int, scenarios: list[str] | None = None
) -> Validation:
    """Run the first validation seeds of each scenario.

    Args:
        act: the agent, for many environments at once.
        geometry: of the obstacle maps.
        episodes: per scenario.
        scenarios: all by default.
    """
    names = scenarios or crowdbench.scenario_names()
    crowds = Crowds(min(ENVIRONMENTS, len(names) * episodes), _all(names, episodes), geometry)
    bounds: ActionBounds = crowds.bounds
    running = crowds.begin(np.arange(crowds.count))
    success = {name: [] for name in names}
    changes, seconds = [], []
    steps = np.zeros(crowds.count, np.int64)
    while len(running):
        sensed = Sensed(*(x[running] for x in crowds.sensed))
        before = bounds.normalised(sensed.velocity).astype(np.float32)
        action = bounds.physical(act(sensed, before))
        moving = steps[running] > 0
        changes.append(np.square(action - sensed.velocity).sum(axis=-1)[moving])
        result = crowds.step(running, action)
        steps[running] += 1
        over = running[result.over]
        for index, outcome in zip(over, result.outcome[result.over], strict=True):
            success[crowds.scenario[index]].append(outcome == "success")
            if outcome == "success":
                seconds.append(steps[index] * crowds.robot.control_period)
            steps[index] = 0
        begun = crowds.begin(over)
        running = np.sort(np.concatenate([running[~result.over], begun]))
    return Validation(
        {name: float(np.mean(values)) for name, values in success.items()},
        float(np.concatenate(changes).mean()),
        float(np.mean(seconds)) if seconds else float("nan"),
    )


def policy_act(model: WorldModel) -> Act:
    """Act by the policy alone, without noise."""

    @torch.no_grad()
    def act(sensed: Sensed, before: NDArray[np.float32]) -> NDArray[np.float32]:
        return model.act(model.encode(Inputs(*map(torch.from_numpy, sensed)))).numpy()

    return act


def planner_act(model: WorldModel, config: Config, bounds: ActionBounds) -> Act:
    """Act by MPPI, planning anew at each step, without warm start."""
    generator = torch.Generator().manual_seed(0)
    half = torch.from_numpy(bounds.half)

    @torch.no_grad()
    def act(sensed: Sensed, before: NDArray[np.float32]) -> NDArray[np.float32]:
        z = model.encode(Inputs(*map(torch.from_numpy, sensed)))
        result = plan(
            model, z, torch.from_numpy(before), config.planner, config.loss.discount, half,
            generator,
        )  # fmt: skip
        return result.actions[:, 0].numpy()

    return act


def _all(names: list[str], episodes: int) -> Iterator[tuple[str, int]]:
    for number in range(episodes):
        for name in names:
            yield name, FIRST_SEED + number
