"""What holds and what does not, line by line, as CSV files beside the tables."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any, Literal

import pandas as pd

from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.statistics import Difference
from crowdbench.study.claims import Finding, Order
from crowdbench.study.formats import digits
from crowdbench.study.tables import Entry, Filled

Side = Literal["better", "worse", "not told apart"]

_DIFFERENCE = ("difference", "low", "high", "pairs", "p", "verdict")


def claims_csv(findings: Sequence[Finding]) -> str:
    """One line per claim; ``difference`` is better less (factor x worse + margin)."""
    heads = ("table", "claim", "metric", "better", "worse", "scenarios", "factor", "margin")
    return _text(
        (*heads, *_DIFFERENCE),
        (
            [
                claim.table,
                claim.text,
                claim.metric,
                claim.better,
                claim.worse,
                " ".join(claim.scenarios),
                digits(claim.factor),
                digits(claim.margin),
                *_difference(finding.difference, finding.p),
                finding.verdict,
            ]
            for finding in findings
            for claim in [finding.claim]
        ),
    )


def orders_csv(orders: Sequence[Order]) -> str:
    """One line per pair that the reference puts in an order: ``better`` before ``worse``."""
    heads = ("table", "block", "metric", "better", "worse", "reference_better", "reference_worse")
    return _text(
        (*heads, *_DIFFERENCE),
        (
            [
                order.table.number,
                order.better.block.heading,
                order.better.quantity.metric,
                order.better.method.label,
                order.worse.method.label,
                digits(order.better.reference),
                digits(order.worse.reference),
                *_difference(order.difference, order.p),
                order.verdict,
            ]
            for order in orders
        ),
    )


def differences_csv(tables: Sequence[Filled]) -> str:
    """One line per cell that can be judged against its reference value."""
    heads = ("table", "block", "method", "metric", "value", "low", "high", "reference", "here")
    return _text(
        heads,
        (
            [
                filled.table.number,
                entry.block.heading,
                entry.method.label,
                entry.quantity.metric,
                *map(digits, entry.estimate[:3]),
                digits(entry.reference),
                side(entry),
            ]
            for filled in tables
            for entry in judged(filled)
        ),
    )


def weights_csv(episodes: pd.DataFrame) -> str:
    """One line per agent and set of weights, with the number of episodes."""
    rows = episodes[episodes["weights_sha256"] != ""]
    counts = rows.groupby(["agent", "weights_sha256"], sort=True).size()
    lines = ([agent, weights, count] for (agent, weights), count in counts.items())
    return _text(("agent", "weights_sha256", "episodes"), lines)


def judged(filled: Filled) -> list[Entry]:
    """The cells of a table with an interval and a reference value to hold against it."""
    return [
        entry
        for entry in filled.entries
        if entry.quantity.judged and entry.reference is not None and entry.estimate.n > 1
    ]


def side(entry: Entry) -> Side:
    """Whether a measured value is better or worse than its reference, if its interval tells."""
    if entry.reference is None or not entry.excludes_reference:
        return "not told apart"
    higher = entry.estimate.mean > entry.reference
    return "better" if higher == (METRICS[entry.quantity.metric].better == "higher") else "worse"


def _difference(difference: Difference, p: float) -> list[Any]:
    return [*map(digits, difference[:3]), difference.n, digits(p)]


def _text(heads: Sequence[str], lines: Iterable[Sequence[Any]]) -> str:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows(lines)
    return buffer.getvalue()
