"""Which episode of training comes next."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from crowdbench_agents.learning.seeds import training_seeds

EASY_WEIGHT = 0.1
"""Weight of a scenario that always succeeds; one that never does has 1 more."""
SUCCESS_RATE = 0.02  # of the running success while training, per episode


class ScenarioSampler:
    """Draws the scenario and seed of each training episode, the harder scenarios more often.

    Args:
        seed: of the run.
        scenarios: names of those that are drawn.
        episodes: number of the episode before the first one that is drawn.
        stride: from one number to the next: several samplers of a run share no episode.

    Attributes:
        success: running success in each scenario.
        episodes: number of the last episode.
    """

    def __init__(
        self,
        seed: int,
        scenarios: Iterable[str],
        episodes: int = 0,
        stride: int = 1,
    ) -> None:
        self.success = dict.fromkeys(scenarios, 0.5)
        self.episodes = episodes
        self._stride, self._seeds = stride, training_seeds(seed)
        alone = (episodes, stride) == (0, 1)
        self._rng = np.random.default_rng([seed, 1] if alone else [seed, 1, episodes + stride])

    def __iter__(self) -> Iterator[tuple[str, int]]:
        return self

    def __next__(self) -> tuple[str, int]:
        weights = EASY_WEIGHT + 1 - np.array(list(self.success.values()))
        name = self._rng.choice(list(self.success), p=weights / weights.sum())
        self.episodes += self._stride
        return str(name), self._seeds[self.episodes]

    def record(self, name: str, success: bool) -> None:
        """Follow the success in a scenario."""
        self.success[name] += SUCCESS_RATE * (success - self.success[name])
