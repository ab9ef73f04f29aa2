"""Stored episodes, as tables and figures ask for them: means, differences and their intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

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
    Sample,
    defined_pairs,
    estimate_all,
    paired_differences,
)
from crowdbench.scenario import load_scenario
from crowdbench.study.model import Cell


class Mean(NamedTuple):
    """A metric's mean to ask for: over the episodes of an agent in all of some scenarios."""

    agent: str
    scenarios: tuple[str, ...]
    metric: str


class Pair(NamedTuple):
    """A difference to ask for: first less (factor x second + margin), seed by seed.

    Attributes:
        first, second: agent and scenarios; the scenarios are paired in their order.
        metric: name in ``METRICS``.
        factor, margin: see above; 1 and 0 give the plain difference.
    """

    first: tuple[str, tuple[str, ...]]
    second: tuple[str, tuple[str, ...]]
    metric: str
    factor: float = 1.0
    margin: float = 0.0


_Parts = dict[str, list[NDArray[np.float64]]]
_NO_ROWS = pd.DataFrame(index=pd.Index([], dtype=np.int64, name="seed"))


class Measurements:
    """What the stored episodes of a plan say.

    Everything is computed once. What is asked for together shares most of the work.
    """

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
        self.episodes = kept.drop(columns=["episodes", "named"])
        cells = kept.groupby(["agent", "named"], sort=False).indices
        self._not_computed = {key: not_computed(kept.iloc[rows]) for key, rows in cells.items()}
        # Metrics that no row has are NaN in the cells alone: columns take memory.
        self._cells = {
            key: kept.iloc[rows].set_index("seed").reindex(columns=list(METRICS)).sort_index()
            for key, rows in cells.items()
        }
        self._means: dict[Mean, Estimate] = {}
        self._differences: dict[Pair, Difference] = {}

    @classmethod
    def load(cls, folder: Path, plan: Sequence[Cell]) -> Measurements:
        """Read a results folder, and nothing of what is published."""
        return cls(local_rows(folder), plan)

    def count(self, agent: str, scenarios: tuple[str, ...]) -> int:
        """How many episodes are stored."""
        return sum(len(self._rows(agent, scenario)) for scenario in scenarios)

    def paired(
        self, first: tuple[str, tuple[str, ...]], second: tuple[str, tuple[str, ...]]
    ) -> bool:
        """Whether there is an episode that both ran; arguments as those of ``difference``."""
        return any(
            len(self._rows(first[0], one).index.intersection(self._rows(second[0], other).index))
            for one, other in zip(first[1], second[1], strict=True)
        )

    def not_computed(self, agent: str, scenarios: tuple[str, ...], metric: str) -> int:
        """How many of the stored episodes are older than a metric and were not recomputed."""
        cells = [self._not_computed.get((agent, scenario), {}) for scenario in scenarios]
        return sum(cell.get(metric, 0) for cell in cells)

    def mean(self, agent: str, scenarios: tuple[str, ...], metric: str) -> Estimate:
        """Mean over the episodes of all scenarios."""
        return self.means([Mean(agent, scenarios, metric)])[0]

    def means(self, wanted: Iterable[Mean]) -> list[Estimate]:
        """``mean`` of several."""
        wanted = list(wanted)
        new = [mean for mean in dict.fromkeys(wanted) if mean not in self._means]
        found = estimate_all(map(self._sample, new))
        self._means.update(zip(new, found, strict=True))
        return [self._means[mean] for mean in wanted]

    def difference(
        self,
        first: tuple[str, tuple[str, ...]],
        second: tuple[str, tuple[str, ...]],
        metric: str,
        factor: float = 1.0,
        margin: float = 0.0,
    ) -> Difference:
        """First less (factor x second + margin), over the seeds that both ran; see ``Pair``."""
        return self.differences([Pair(first, second, metric, factor, margin)])[0]

    def differences(self, wanted: Iterable[Pair]) -> list[Difference]:
        """``difference`` of several."""
        wanted = list(wanted)
        new = [pair for pair in dict.fromkeys(wanted) if pair not in self._differences]
        found = paired_differences(map(self._paired, new))
        self._differences.update(zip(new, found, strict=True))
        return [self._differences[pair] for pair in wanted]

    def _sample(self, mean: Mean) -> Sample:
        """The values of all scenarios, and what weighs them."""
        agent, scenarios, name = mean
        weight = METRICS[name].weight
        weights = self._values(agent, scenarios, weight) if weight else None
        return METRICS[name], self._values(agent, scenarios, name), weights

    def _paired(self, pair: Pair) -> NDArray[np.float64]:
        """(n,) the differences of all scenarios."""
        columns = [pair.metric, *filter(None, [METRICS[pair.metric].weight])]
        sides: tuple[_Parts, _Parts] = (
            {name: [] for name in columns},
            {name: [] for name in columns},
        )
        for one, other in zip(pair.first[1], pair.second[1], strict=True):
            tables = self._rows(pair.first[0], one), self._rows(pair.second[0], other)
            one_seeds, other_seeds = (table.index.to_numpy() for table in tables)
            # Seeds that both have, in order; looked up by pandas they take most of a table's time.
            _, *shared = np.intersect1d(
                one_seeds, other_seeds, assume_unique=True, return_indices=True
            )
            if not len(shared[0]):
                continue
            for side, table, rows in zip(sides, tables, shared, strict=True):
                for name in columns:
                    side[name].append(table[name].to_numpy()[rows])
        if not sides[0][pair.metric]:
            return np.empty(0)
        x, y = defined_pairs(
            pair.metric,
            *({name: np.concatenate(parts) for name, parts in side.items()} for side in sides),
        )
        return x - pair.factor * y - pair.margin

    def _rows(self, agent: str, scenario: str) -> pd.DataFrame:
        return self._cells.get((agent, scenario), _NO_ROWS)

    def _values(self, agent: str, scenarios: tuple[str, ...], metric: str) -> NDArray[np.float64]:
        rows = [self._rows(agent, scenario) for scenario in scenarios]
        there = [part[metric].to_numpy(dtype=float) for part in rows if len(part)]
        return np.concatenate([np.empty(0), *there])
