"""What episodes say about a study: its claims, and the reference's orders and values, tested."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from crowdbench.evaluation.statistics import Difference, holm
from crowdbench.study.measurements import Measurements, Pair
from crowdbench.study.model import Claim, Table
from crowdbench.study.tables import SIGNIFICANCE, Entry, Filled, pair_of, sign

Verdict = Literal["holds", "fails", "undecided", "not yet run"]


@dataclass(frozen=True)
class Finding:
    """A claim with what the episodes say about it.

    Attributes:
        difference: of the means, x - (factor y + margin), over the seeds that both ran.
        p: after Holm over the claims of the same table.
        ran: whether there is an episode that both ran.
    """

    claim: Claim
    difference: Difference
    p: float
    ran: bool

    @property
    def undefined(self) -> bool:
        """Whether the metric is undefined in all episodes that both ran, for one of them."""
        return self.ran and not self.difference.n

    @property
    def verdict(self) -> Verdict:
        """Holds or fails where the difference is significant, in or against its direction."""
        return _verdict(self.difference, self.p, sign(self.claim.metric), self.ran)


@dataclass(frozen=True)
class Order:
    """Two entries of a column that the reference puts in an order: ``better`` before ``worse``."""

    table: Table
    better: Entry
    worse: Entry
    difference: Difference
    p: float
    ran: bool

    @property
    def verdict(self) -> Verdict:
        """As of a claim."""
        return _verdict(self.difference, self.p, sign(self.better.quantity.metric), self.ran)


def check_claims(measured: Measurements, claims: Sequence[Claim]) -> list[Finding]:
    """Test every claim by a paired permutation test, corrected after Holm over each table."""
    sides = [((c.better, c.scenarios), (c.worse, c.scenarios)) for c in claims]
    differences = measured.differences(
        Pair(*pair, claim.metric, claim.factor, claim.margin)
        for claim, pair in zip(claims, sides, strict=True)
    )
    adjusted = np.full(len(claims), np.nan)
    for table in {claim.table for claim in claims}:
        here = [number for number, claim in enumerate(claims) if claim.table == table]
        adjusted[here] = holm([differences[number].p for number in here])
    return [
        Finding(claim, difference, float(p), bool(difference.n) or measured.paired(*pair))
        for claim, difference, p, pair in zip(claims, differences, adjusted, sides, strict=True)
    ]


def check_orders(tables: Sequence[Filled], measured: Measurements) -> list[Order]:
    """Test every order of two methods in one column of the reference, after Holm over each table.

    Equal values are no order, and quantities that are not judged have none.
    """
    pairs: list[tuple[Table, Entry, Entry]] = []
    for filled in tables:
        for one in filled.entries:
            for other in filled.entries:
                if (one.block, one.quantity) != (other.block, other.quantity):
                    continue
                if one.reference is None or other.reference is None or not one.quantity.judged:
                    continue
                if sign(one.quantity.metric) * (one.reference - other.reference) > 0:
                    pairs.append((filled.table, one, other))
    wanted = [pair_of(one, other) for _, one, other in pairs]
    orders = [
        Order(*pair, difference, difference.p, bool(difference.n) or measured.paired(*asked[:2]))
        for pair, asked, difference in zip(pairs, wanted, measured.differences(wanted), strict=True)
    ]
    found = []
    for filled in tables:
        here = [order for order in orders if order.table is filled.table]
        adjusted = holm([order.difference.p for order in here])
        found += [replace(order, p=float(p)) for order, p in zip(here, adjusted, strict=True)]
    return found


def _verdict(difference: Difference, p: float, better: int, ran: bool) -> Verdict:
    if not ran:
        return "not yet run"
    if np.isnan(p) or p >= SIGNIFICANCE:  # NaN where the metric is undefined in all of them
        return "undecided"
    return "holds" if better * difference.mean > 0 else "fails"
