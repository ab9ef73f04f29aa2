"""Stored episodes, as tables and figures ask for them: means, differences and their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from crowdbench.evaluation.joined import local_rows
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.results import scenario_label
from crowdbench.evaluation.rows import not_computed
from crowdbench.evaluation.statistics import (
    Difference,
    Estimate,
    defined_pairs,
    estimate,
    paired_difference,
)
from crowdbench.scenario import load_scenario
from crowdbench.study.model import Cell


class Measurements:
    """What the stored episodes of a plan say. Everything is computed once."""

    def __init__(self, episodes: pd.DataFrame, plan: Sequence[Cell]) -> None:
        """Keep the episodes that the plan asks for, of the scenarios as they are now.

        Args:
            episodes: as ``published_and_local`` returns them.
            plan: what a study needs, see ``Study.cells``.
        """
        self.plan = list(plan)
        worlds = {name: load_scenario(name) for name in {cell.scenario for cell in self.plan}}
        wanted = pd.DataFrame(self.plan, columns=["named", *Cell._fields[1:]])
        named = wanted["named"]
        wanted["scenario"] = named.map({name: scenario_label(w) for name, w in worlds.items()})
        wanted["scenario_digest"] = named.map({name: w.digest for name, w in worlds.items()})
        # Rows that no cell can want are left out first: merging copies all there are.
        near = (episodes["robot"] == "robot_0") & (episodes["seed"] < wanted["episodes"].max())
        kept = episodes[near].merge(wanted, on=["scenario", "agent", "scenario_digest"])
        kept = kept[kept["seed"].between(0, kept["episodes"] - 1)]
        kept = kept.assign(**{name: np.nan for name in METRICS if name not in kept})
        self.episodes = kept.drop(columns=["episodes", "named"])
        self._cells = {
            key: rows.set_index("seed").sort_index()
            for key, rows in kept.groupby(["agent", "named"], sort=False)
        }
        # Tables share many cells; asking again costs nothing.
        self.mean = cache(self._mean)
        self.difference = cache(self._difference)

    @classmethod
    def load(cls, folder: Path, plan: Sequence[Cell]) -> Measurements:
        """Read a results folder, and nothing of what is published."""
        return cls(local_rows(folder), plan)

    def count(self, agent: str, scenarios: tuple[str, ...]) -> int:
        """How many episodes are stored."""
        return sum(len(self._rows(agent, scenario)) for scenario in scenarios)

    def not_computed(self, agent: str, scenarios: tuple[str, ...], metric: str) -> int:
        """How many of the stored episodes are older than a metric and were not recomputed."""
        rows = [self._rows(agent, scenario) for scenario in scenarios]
        return sum(not_computed(part).get(metric, 0) for part in rows if len(part))

    def paired(
        self, first: tuple[str, tuple[str, ...]], second: tuple[str, tuple[str, ...]]
    ) -> bool:
        """Whether there is an episode that both ran; arguments as those of ``difference``."""
        return any(
            len(self._rows(first[0], one).index.intersection(self._rows(second[0], other).index))
            for one, other in zip(first[1], second[1], strict=True)
        )

    def _mean(self, agent: str, scenarios: tuple[str, ...], metric: str) -> Estimate:
        """Mean over the episodes of all scenarios."""
        entry = METRICS[metric]
        weights = self._values(agent, scenarios, entry.weight) if entry.weight else None
        return estimate(entry, self._values(agent, scenarios, metric), weights)

    def _difference(
        self,
        first: tuple[str, tuple[str, ...]],
        second: tuple[str, tuple[str, ...]],
        metric: str,
        factor: float = 1.0,
        margin: float = 0.0,
    ) -> Difference:
        """First less (factor x second + margin), over the seeds that both ran.

        Args:
            first, second: agent and scenarios; the scenarios are paired in their order.
            metric: name in ``METRICS``.
            factor, margin: see above; 1 and 0 give the plain difference.
        """
        columns = [metric, *filter(None, [METRICS[metric].weight])]
        pairs = []
        for one, other in zip(first[1], second[1], strict=True):
            a, b = self._rows(first[0], one), self._rows(second[0], other)
            shared = a.index.intersection(b.index)
            if len(shared):
                pairs.append((a.loc[shared, columns], b.loc[shared, columns]))
        if not pairs:
            return paired_difference([])
        x, y = defined_pairs(metric, *(pd.concat(side) for side in zip(*pairs, strict=True)))
        return paired_difference(x - factor * y - margin)

    def _rows(self, agent: str, scenario: str) -> pd.DataFrame:
        return self._cells.get((agent, scenario), pd.DataFrame(index=pd.Index([], name="seed")))

    def _values(self, agent: str, scenarios: tuple[str, ...], metric: str) -> NDArray[np.float64]:
        rows = [self._rows(agent, scenario) for scenario in scenarios]
        there = [part[metric].to_numpy(dtype=float) for part in rows if len(part)]
        return np.concatenate([np.empty(0), *there])
