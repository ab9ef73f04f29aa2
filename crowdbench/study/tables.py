"""Tables filled with measured values: value, interval, reference value, what is best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.statistics import Estimate, holm
from crowdbench.study.measurements import Mean, Measurements, Pair
from crowdbench.study.model import Block, Method, Quantity, Study, Table

SIGNIFICANCE = 0.05

State = Literal["measured", "partial", "undefined", "not computed", "missing"]


@dataclass(frozen=True)
class Entry:
    """One cell of a table; numbers in the stored unit.

    Attributes:
        estimate: mean and interval over the episodes in which the metric is defined.
        episodes: stored.
        not_computed: of them those that are older than the metric.
        planned: episodes that the plan asks for.
        reference: the value from elsewhere, if there is one.
        bold: among the best of its column, see ``fill``.
        p: of the difference from the best of its column, after Holm; NaN for the best itself and
            where nothing is compared.
    """

    block: Block
    method: Method
    quantity: Quantity
    estimate: Estimate
    episodes: int
    planned: int
    reference: float | None
    not_computed: int = 0
    bold: bool = False
    p: float = np.nan

    @property
    def state(self) -> State:
        """Whether there is a number, and whether all episodes are behind it."""
        if self.episodes == 0:
            return "missing"
        if self.not_computed == self.episodes:
            return "not computed"
        if self.estimate.n == 0:
            return "undefined"
        return "measured" if self.episodes - self.not_computed == self.planned else "partial"

    @property
    def excludes_reference(self) -> bool:
        """Whether the interval lies apart from all values that round to the reference."""
        if self.reference is None or np.isnan(self.estimate.low):
            return False
        slack = self.quantity.rounding + 1e-12
        return not self.estimate.low - slack <= self.reference <= self.estimate.high + slack


@dataclass(frozen=True)
class Filled:
    """A table with all its entries, by block, then method, then quantity.

    Attributes:
        source: whose the reference values are; empty without any.
    """

    table: Table
    entries: tuple[Entry, ...]
    source: str = ""

    def row(self, block: Block, method: Method) -> list[Entry]:
        """The entries of one line, in the order of the quantities."""
        return [entry for entry in self.entries if (entry.block, entry.method) == (block, method)]

    def states(self) -> set[State]:
        """Which states occur."""
        return {entry.state for entry in self.entries}


def fill_all(study: Study, measured: Measurements) -> list[Filled]:
    """Fill every table of a study."""
    # Asked for together first, so that all tables share what is drawn for intervals and tests.
    measured.means(mean for table in study.tables for mean in _means(table))
    filled = [_entries(table, measured) for table in study.tables]
    measured.differences(
        pair_of(entries[best], entries[other])
        for entries in filled
        for best, other in _rivals(entries)
    )
    return [fill(table, measured, study.source) for table in study.tables]


def fill(table: Table, measured: Measurements, source: str = "the reference") -> Filled:
    """Fill a table and mark what is best.

    In each column the method with the best mean is tested against every other one, on the seeds
    that both ran (paired permutation test), and the p-values are corrected after Holm over the
    whole table. Bold are the best and those that cannot be told from it, provided that at least
    one method is told from it; digits alone make nothing bold. Bounds take no part. A method of
    whose planned episodes some are missing is neither bold nor the best while another has all.
    """
    entries = _entries(table, measured)
    comparisons = _compare_with_best(entries, measured)
    adjusted = holm([p for _, _, p in comparisons])
    for (_, number, _), p in zip(comparisons, adjusted, strict=True):
        entries[number] = replace(entries[number], p=float(p))
    for best in dict.fromkeys(best for best, _, _ in comparisons):
        others = [number for leader, number, _ in comparisons if leader == best]
        worse = {number for number in others if entries[number].p < SIGNIFICANCE}
        if worse:
            for number in {best, *others} - worse:
                complete = entries[number].state == "measured"
                entries[number] = replace(entries[number], bold=complete)
    return Filled(table, tuple(entries), source if table.reference else "")


def sign(metric: str) -> int:
    """1 if more of a metric is better, -1 if less is."""
    return 1 if METRICS[metric].better == "higher" else -1


def pair_of(first: Entry, second: Entry) -> Pair:
    """The difference between two entries of a column."""
    return Pair(
        (first.method.agent, first.block.scenarios),
        (second.method.agent, second.block.scenarios),
        first.quantity.metric,
    )


def _means(table: Table) -> list[Mean]:
    """What the entries of a table show, in their order."""
    return [
        Mean(method.agent, block.scenarios, quantity.metric)
        for block in table.blocks
        for method in table.methods
        for quantity in table.quantities
    ]


def _entries(table: Table, measured: Measurements) -> list[Entry]:
    """The entries of a table, with nothing compared yet."""
    places = product(table.blocks, table.methods, table.quantities)
    return [
        Entry(
            block,
            method,
            quantity,
            estimate,
            episodes=measured.count(method.agent, block.scenarios),
            planned=method.episodes * len(block.scenarios),
            reference=table.reference.get((block.heading, method.label, quantity.metric)),
            not_computed=measured.not_computed(method.agent, block.scenarios, quantity.metric),
        )
        for (block, method, quantity), estimate in zip(
            places, measured.means(_means(table)), strict=True
        )
    ]


def _rivals(entries: Sequence[Entry]) -> list[tuple[int, int]]:
    """Numbers of the entries to compare, column by column: the best and each other one."""
    columns: dict[tuple[Block, Quantity], list[int]] = {}
    for number, entry in enumerate(entries):
        if not entry.method.bound and entry.estimate.n:
            columns.setdefault((entry.block, entry.quantity), []).append(number)
    pairs = []
    for (_, quantity), column in columns.items():
        complete = [number for number in column if entries[number].state == "measured"]
        better = sign(quantity.metric)
        means = {number: better * entries[number].estimate.mean for number in complete or column}
        best = max(means, key=means.__getitem__)
        pairs += [(best, number) for number in column if number != best]
    return pairs


def _compare_with_best(
    entries: Sequence[Entry], measured: Measurements
) -> list[tuple[int, int, float]]:
    """Test the best of each column against each other entry: (best, other, p)."""
    rivals = _rivals(entries)
    differences = measured.differences(
        pair_of(entries[best], entries[other]) for best, other in rivals
    )
    found = []
    for (best, other), difference in zip(rivals, differences, strict=True):
        if difference.n:
            # On the seeds that both ran, the order of the two may be the other way round.
            ahead = sign(entries[best].quantity.metric) * difference.mean > 0
            found.append((best, other, difference.p if ahead else 1.0))
    return found
