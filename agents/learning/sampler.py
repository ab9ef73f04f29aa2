"""Which scenarios are trained in, and which episode comes next."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator

import numpy as np
from crowdbench_agents.learning.seeds import training_seeds

import crowdbench

TRAINING_SCENARIOS = {
    "unimodal_slow": 1, "unimodal_fast": 2, "multimodal_slow": 1, "multimodal_fast": 2,
    "unimodal_slow_nonreactive": 2, "unimodal_fast_nonreactive": 4,
    "multimodal_slow_nonreactive": 2, "multimodal_fast_nonreactive": 4,
    "corridor_sparse": 1, "corridor_moderate": 1, "corridor_dense": 2, "corridor_very_dense": 3,
}  # fmt: skip
"""Scenarios that are trained and validated in, with their share of the demonstrations: more where
people are fast, non-reactive or many."""
EASY_WEIGHT = 0.1
"""Weight of a scenario that always succeeds; one that never does has 1 more."""
SUCCESS_RATE = 0.02  # of the running success while training, per episode


def scenario_digests(names: Iterable[str]) -> dict[str, str]:
    """The digest of each of some scenarios, by name."""
    return {name: crowdbench.load_scenario(name).digest for name in names}


def joint_digest(digests: dict[str, str]) -> str:
    """12 hex digits that change whenever one of the scenarios does."""
    return hashlib.sha256("".join(digests.values()).encode()).hexdigest()[:12]


class ScenarioSampler:
    """Draws the scenario and seed of each training episode, the harder scenarios more often.

    Args:
        seed: of the run.
        scenarios: names of those that are drawn, by default those that are trained in.
        episodes: number of the episode before the first one that is drawn.
        stride: from one number to the next: several samplers of a run share no episode.

    Attributes:
        success: running success in each scenario.
        episodes: number of the last episode.
    """

    def __init__(
        self,
        seed: int,
        scenarios: Iterable[str] | None = None,
        episodes: int = 0,
        stride: int = 1,
    ) -> None:
        names = TRAINING_SCENARIOS if scenarios is None else scenarios
        self.success = dict.fromkeys(names, 0.5)
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
