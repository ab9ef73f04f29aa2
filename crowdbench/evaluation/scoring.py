"""From what the robots did to what is stored; no agent's code runs in this process."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from crowdbench.evaluation.driven import Driven, ResimulationError, simulate
from crowdbench.evaluation.results import Origin, Result
from crowdbench.scenario import Scenario, ScenarioError

if TYPE_CHECKING:
    import pandas as pd

    from crowdbench.evaluation.episode import Episode
    from crowdbench.simulation.env import CrowdEnv

TRUSTED_SHARE = 0.9
"""Of the time inside ``act`` the process computed at least this share, or its times do not count:
the machine was overloaded, or the agent waited for something else."""
_WAITED = "crowdbench.processor_share"


def waited(rows: pd.DataFrame) -> pd.Series:
    """Which stored rows have no ``inference_s`` because the process waited inside ``act``."""
    return rows["diagnostics"].str.contains(f'"{_WAITED}"', regex=False)


class Scorer:
    """Keeps the last environment, which the next episode mostly needs again."""

    def __init__(self) -> None:
        self._env: CrowdEnv | None = None

    def score(
        self, scenario: Scenario, label: str, seed: int, driven: Sequence[Driven], origin: Origin
    ) -> list[Result]:
        """Simulate an episode that was run somewhere and measure it, one result per robot.

        Raises:
            ResimulationError: this is not what happens with these commands.
        """
        from crowdbench.evaluation.metrics import metrics
        from crowdbench.simulation.env import CrowdEnv

        if self._env is None or self._env.scenario != scenario:
            self._env = CrowdEnv(scenario)
        episodes = simulate(self._env, seed, driven, label=label)
        return [Result.of(*_trusted(episode, metrics(episode)), origin) for episode in episodes]

    def compile(self, scenario: Scenario, seed: int) -> None:
        """Let everything run once that is compiled when it is first needed."""
        robots = range(scenario.robots.count)
        driven = [
            Driven(f"robot_{r}", np.zeros((2, 2)), np.zeros(2), "agent_error", "") for r in robots
        ]
        # A scenario without room, or one that ends at once, is told of when it is its turn.
        with contextlib.suppress(ScenarioError, ResimulationError):
            self.score(scenario, "", seed, driven, Origin())


def _trusted(episode: Episode, values: Mapping[str, float]) -> tuple[Episode, Mapping[str, float]]:
    """Leave a time out that says little about the agent, and keep the reason."""
    share = episode.processor_share
    if share >= TRUSTED_SHARE:
        return episode, values
    counters = {**episode.diagnostics, _WAITED: round(share, 3)}
    return replace(episode, diagnostics=counters), {**values, "inference_s": math.nan}
