"""Where our numbers differ from the paper's: its claims, its orderings and its values, tested."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from crowdbench.evaluation.statistics import holm
from crowdbench.study.measurements import Difference, Measurements
from crowdbench.study.plan import (
    NONREACTIVE,
    OPEN_LOOP,
    OURS,
    REACTIVE,
    VERY_DENSE,
    Table,
)
from crowdbench.study.tables import SIGNIFICANCE, Entry, Filled, sign

Verdict = Literal["holds", "fails", "undecided", "not yet run"]

_CORRIDOR = VERY_DENSE[0].scenarios
NO_LOSS = 0.05
"""What success may drop for "costs no success" still to hold."""


@dataclass(frozen=True)
class Claim:
    """That one agent is better than another, in a metric, over some scenarios.

    With x and y their means, the claim is x > factor y + margin where more is better, and
    x < factor y + margin where less is.

    Attributes:
        text: the claim in words.
        source: the paper's table.
        better, worse: agents.
        scenarios: pooled with equal weights.
        metric: name in ``METRICS``.
        factor, margin: see above; 1 and 0 for a plain order.
    """

    text: str
    source: str
    better: str
    worse: str
    scenarios: tuple[str, ...]
    metric: str
    factor: float = 1.0
    margin: float = 0.0


@dataclass(frozen=True)
class Finding:
    """A claim with what the episodes say about it.

    Attributes:
        difference: of the means, x - (factor y + margin), over the seeds that both ran.
        p: after Holm over the claims of the same table.
    """

    claim: Claim
    difference: Difference
    p: float

    @property
    def verdict(self) -> Verdict:
        """Holds or fails where the difference is significant, in or against its direction."""
        return _verdict(self.difference, self.p, sign(self.claim.metric))


@dataclass(frozen=True)
class Order:
    """Two entries of one column that the paper puts in an order: ``better`` before ``worse``."""

    table: Table
    better: Entry
    worse: Entry
    difference: Difference
    p: float

    @property
    def verdict(self) -> Verdict:
        """As of a claim."""
        return _verdict(self.difference, self.p, sign(self.better.quantity.metric))


def _first(table: str, scenarios: tuple[str, ...], people: str) -> list[Claim]:
    baselines = {"neupan": "NeuPAN", "sac": "SAC", "tdmpc": "TD-MPC-style"}
    return [
        Claim(f"Ours (E=1) above {name} in {word}, {people}", table, OURS, agent, scenarios, metric)
        for metric, word in (("success", "success"), ("spl", "SPL"))
        for agent, name in baselines.items()
    ]


def _both(text: str, table: str, better: str, worse: str) -> list[Claim]:
    return [
        Claim(f"{text} in {word}", table, better, worse, _CORRIDOR, metric)
        for metric, word in (("success", "success"), ("spl", "SPL"))
    ]


_SHORT, _LONG = "latent_planner:horizon=3", "latent_planner:horizon=10"
_NOT_SMOOTH = "latent_planner:smoothness_weight=0"
_NOT_SOCIAL = "latent_planner:execute=6,weights=no_social"
CLAIMS = (
    *_first("I", REACTIVE, "people who see the robot"),
    *_first("II", NONREACTIVE, "people who do not"),
    Claim("E=1 above E=6 in success, people who see the robot", "I", OURS, OPEN_LOOP, REACTIVE,
          "success"),
    Claim("E=1 above E=6 in success, people who do not", "II", OURS, OPEN_LOOP, NONREACTIVE,
          "success"),
    *_both("E=1 above E=3 at H=3", "III", _SHORT, "latent_planner:execute=3,horizon=3"),
    *_both("E=1 above E=6 at H=6", "III", OURS, OPEN_LOOP),
    *_both("E=1 above E=10 at H=10", "III", _LONG, "latent_planner:execute=10,horizon=10"),
    *_both("H=6 above H=3 at E=1", "III", OURS, _SHORT),
    *_both("H=6 above H=10 at E=1", "III", OURS, _LONG),
    *_both("Policy prior + MPPI above the policy alone", "IV", OURS,
           "latent_planner:use_mppi=false"),
    *_both("Policy prior + MPPI above MPPI without prior", "IV", OURS,
           "latent_planner:policy_prior=false"),
    Claim("The smoothness penalty lowers Smooth at E=1", "V", OURS, _NOT_SMOOTH, _CORRIDOR,
          "smoothness"),
    Claim("The smoothness penalty lowers Smooth at E=6", "V", OPEN_LOOP,
          "latent_planner:execute=6,smoothness_weight=0", _CORRIDOR, "smoothness"),
    Claim(f"The smoothness penalty costs no success at E=1 (less than {NO_LOSS:g})", "V", OURS,
          _NOT_SMOOTH, _CORRIDOR, "success", margin=-NO_LOSS),
    *_both("Reward + Q above SAC (Q only)", "VI", OURS, "sac"),
    *_both("Reward + Q above the reward alone", "VI", OURS, "latent_planner:score=reward"),
    Claim("The social reward halves CutOff", "VII", OPEN_LOOP, _NOT_SOCIAL, REACTIVE, "cutoff",
          factor=0.5),
    Claim("The social reward lowers CutOff", "VII", OPEN_LOOP, _NOT_SOCIAL, REACTIVE, "cutoff"),
    Claim("The social reward raises MinDist", "VII", OPEN_LOOP, _NOT_SOCIAL, REACTIVE, "min_dist"),
    Claim("The social reward lowers TTC < 1 s", "VII", OPEN_LOOP, _NOT_SOCIAL, REACTIVE,
          "ttc_below_1s"),
    Claim("The social reward raises success", "VII", OPEN_LOOP, _NOT_SOCIAL, REACTIVE, "success"),
    Claim("The social reward raises SPL", "VII", OPEN_LOOP, _NOT_SOCIAL, REACTIVE, "spl"),
)  # fmt: skip
"""What the paper's text and tables say about its method."""


def check_claims(measured: Measurements, claims: Sequence[Claim] = CLAIMS) -> list[Finding]:
    """Test every claim by a paired permutation test, corrected after Holm over each table."""
    differences = [
        measured.difference(
            (claim.better, claim.scenarios),
            (claim.worse, claim.scenarios),
            claim.metric,
            claim.factor,
            claim.margin,
        )
        for claim in claims
    ]
    adjusted = np.full(len(claims), np.nan)
    for source in {claim.source for claim in claims}:
        here = [number for number, claim in enumerate(claims) if claim.source == source]
        adjusted[here] = holm([differences[number].p for number in here])
    return [
        Finding(claim, difference, float(p))
        for claim, difference, p in zip(claims, differences, adjusted, strict=True)
    ]


def check_orders(tables: Sequence[Filled], measured: Measurements) -> list[Order]:
    """Test every order of two methods in one column of the paper, after Holm over each table.

    Equal values of the paper are no order.
    """
    found = []
    for filled in tables:
        pairs = []
        for one in filled.entries:
            for other in filled.entries:
                if (one.block, one.quantity) != (other.block, other.quantity):
                    continue
                if one.paper is None or other.paper is None:
                    continue
                if sign(one.quantity.metric) * (one.paper - other.paper) > 0:
                    pairs.append((one, other))
        differences = [
            measured.difference(
                (one.method.agent, one.block.scenarios),
                (other.method.agent, other.block.scenarios),
                one.quantity.metric,
            )
            for one, other in pairs
        ]
        adjusted = holm([difference.p for difference in differences])
        found += [
            Order(filled.table, one, other, difference, float(p))
            for (one, other), difference, p in zip(pairs, differences, adjusted, strict=True)
        ]
    return found


def _verdict(difference: Difference, p: float, better: int) -> Verdict:
    if np.isnan(p):
        return "not yet run"
    if p >= SIGNIFICANCE:
        return "undecided"
    return "holds" if better * difference.mean > 0 else "fails"
