"""From what the robots did to what is stored; no agent's code runs in this process."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from crowdbench.evaluation.driven import Driven, simulate
from crowdbench.evaluation.resimulate import ResimulationError
from crowdbench.evaluation.results import Origin, Result
from crowdbench.scenario import Scenario, ScenarioError

if TYPE_CHECKING:
    from crowdbench.simulation.env import CrowdEnv


class Scorer:
    """Keeps the last environment, which the next episode mostly needs again."""

    def __init__(self) -> None:
        self._env: CrowdEnv | None = None

    def score(
        self, scenario: Scenario, label: str, seed: int, driven: Sequence[Driven], machine: str
    ) -> list[Result]:
        """Simulate an episode and measure it, one result per robot.

        Raises:
            ResimulationError: this is not what happens with these commands.
        """
        from crowdbench.evaluation.metrics import metrics
        from crowdbench.simulation.env import CrowdEnv

        if self._env is None or self._env.scenario != scenario:
            self._env = CrowdEnv(scenario)
        origin = Origin.here(machine)
        episodes = simulate(self._env, seed, driven, label=label)
        return [Result.of(episode, metrics(episode), origin) for episode in episodes]

    def compile(self, scenario: Scenario, seed: int) -> None:
        """Let everything run once that is compiled when it is first needed."""
        robots = range(scenario.robots.count)
        driven = [
            Driven(f"robot_{r}", np.zeros((2, 2)), np.zeros(2), "agent_error", "") for r in robots
        ]
        # A scenario without room, or one that ends at once, is told of when it is its turn.
        with contextlib.suppress(ScenarioError, ResimulationError):
            self.score(scenario, "", seed, driven, "")
