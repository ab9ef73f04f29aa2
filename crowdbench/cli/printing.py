"""What ``crowdbench run`` and ``crowdbench compare`` have found, as tables or as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import pandas as pd
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from crowdbench.evaluation.metric import Metric
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.results import Cell, ResultsStore, one_line
from crowdbench.evaluation.rows import not_computed
from crowdbench.evaluation.runner import Missing
from crowdbench.evaluation.scoring import TRUSTED_SHARE, waited
from crowdbench.evaluation.statistics import Estimate, estimates, per_episode

Rows = Mapping[Cell, pd.DataFrame]
Lacking = Mapping[Cell, Sequence[Missing]]
SIGNIFICANT = 0.05
_LONGEST_UNIT = 6


def print_tables(
    console: Console, store: ResultsStore, rows: Rows, published: Rows, lacking: Lacking
) -> None:
    """One table per scenario with a column per agent, then where the rows are.

    Args:
        console: where to print.
        store: where the rows are.
        rows: what was run.
        published: what the record has of the same agents in the same scenarios.
        lacking: the episodes of each cell that could not be run.
    """
    main = {name: metric for name, metric in METRICS.items() if metric.main}
    for scenario in dict.fromkeys(cell.scenario for cell in rows):
        cells = [cell for cell in rows if cell.scenario == scenario]
        table = _table(scenario)
        table.add_column("mean [95 % interval]")
        for cell in cells:
            table.add_column(escape(cell.agent), overflow="fold")
            if cell in published:
                table.add_column("published", style="dim")
        columns = [
            part for cell in cells for part in (rows[cell], published.get(cell)) if part is not None
        ]
        gaps = [
            gap
            for cell in cells
            for gap in (len(lacking.get(cell, ())), *([0] if cell in published else []))
        ]
        found = [estimates(main, per_episode(part, main)) for part in columns]
        older = [not_computed(part) for part in columns]
        for name, metric in main.items():
            shown = [
                "not computed" if old.get(name) == len(part) else _interval(metric, item[name])
                for item, part, old in zip(found, columns, older, strict=True)
            ]
            table.add_row(_heading(name), *shown)
        counts = map(_count, columns, gaps)
        table.add_row("episodes", *counts)
        table.add_row("ended by", *(_endings(part) for part in columns))
        console.print(table)
        console.print()
    print_published(console, {cell.agent: part for cell, part in published.items()})
    named = {f"{cell.agent} in {cell.scenario}": part for cell, part in rows.items()}
    print_not_computed(console, named, list(main))
    for cell, table in rows.items():
        _print_errors(console, cell, table)
    _print_waits(console, named)
    console.print(f"rows: {store.path}", markup=False, soft_wrap=True)


def as_document(store: ResultsStore, rows: Rows, lacking: Lacking) -> dict[str, Any]:
    """What the tables say and more, for machines; undefined numbers are null."""
    return {
        "crowdbench": version("crowdbench-nav"),
        "results": str(store.folder),
        "cells": [
            _cell_document(store, cell, table, lacking.get(cell, ()))
            for cell, table in rows.items()
        ],
    }


def print_comparison(console: Console, table: pd.DataFrame, first: str, second: str) -> None:
    """One line per scenario and metric; a star where the corrected difference holds."""
    for scenario, lines in table.groupby("scenario", sort=False):
        shown = _table(str(scenario))
        for heading in ("", "A", "B"):
            shown.add_column(heading, no_wrap=True)
        # On a narrow terminal this one folds, and no number is cut off.
        shown.add_column("A - B [95 % interval]")
        for heading in ("p", "Holm", "pairs"):
            shown.add_column(heading, justify="right", no_wrap=True)
        for line in lines.itertuples():
            metric = METRICS[line.metric]
            difference = Estimate(line.difference, line.low, line.high, line.n)
            star = " *" if line.p_holm < SIGNIFICANT else ""
            shown.add_row(
                _heading(line.metric),
                _number(metric, line.mean_a),
                _number(metric, line.mean_b),
                _interval(metric, difference, beside=max(abs(line.low), abs(line.high))) + star,
                _p_value(line.p),
                _p_value(line.p_holm),
                str(line.n),
            )
        console.print(shown)
        console.print()
    console.print(
        f"A: {first}\nB: {second}\nMeans over the episodes that both ran; * p < {SIGNIFICANT:g} by "
        "the paired permutation test, corrected over the whole table (Holm).",
        markup=False,
    )


def print_published(console: Console, rows: Mapping[str, pd.DataFrame]) -> None:
    """Say of each agent how many of its rows are published, and where those were run."""
    for agent, part in rows.items():
        found = part[part["source"] == "published"]
        if len(found):
            all_of = "all" if len(found) == len(part) else f"{len(found):,} of {len(part):,}"
            machines = "; ".join(sorted(set(found["machine"])))
            console.print(
                f"published: {all_of} rows of {agent}, run on {machines}",
                markup=False,
                soft_wrap=True,
            )


def print_not_computed(
    console: Console, rows: Mapping[str, pd.DataFrame], metrics: Sequence[str]
) -> None:
    """Say of each name which metrics some of its rows are too old for."""
    for name, part in rows.items():
        older = not_computed(part)
        for metric in metrics:
            if metric in older:
                console.print(
                    f"{name}: {metric} is not computed in {older[metric]:,} of {len(part):,} rows, "
                    "which are older; crowdbench recompute fills it in",
                    markup=False,
                    soft_wrap=True,
                )


def _table(title: str) -> Table:
    return Table(
        title=escape(title),
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )


def _cell_document(
    store: ResultsStore, cell: Cell, rows: pd.DataFrame, missing: Sequence[Missing]
) -> dict[str, Any]:
    failed = rows[rows["outcome"] == "agent_error"]
    values = per_episode(rows, METRICS)
    return {
        "scenario": cell.scenario,
        "scenario_digest": cell.scenario_digest,
        "agent": cell.agent,
        "weights_sha256": cell.weights_sha256 or None,
        "code": cell.code,
        "file": str(store.path),
        "episodes": len(rows),
        "complete": not missing,
        "missing": [{"seed": one.seed, "reason": one_line(one.reason)} for one in missing],
        "overloaded": int(waited(rows).sum()),
        "not_computed": not_computed(rows),
        "outcomes": {str(name): int(n) for name, n in rows["outcome"].value_counts().items()},
        "metrics": {
            name: _estimate_document(found) for name, found in estimates(METRICS, values).items()
        },
        "errors": [
            {"seed": int(seed), "error": error}
            for seed, error in zip(failed["seed"], failed["error"], strict=True)
        ],
    }


def _estimate_document(value: Estimate) -> dict[str, float | int | None]:
    numbers = {"mean": value.mean, "low": value.low, "high": value.high}
    plain = {key: float(x) if math.isfinite(x) else None for key, x in numbers.items()}
    return {**plain, "n": int(value.n)}


def _print_errors(console: Console, cell: Cell, rows: pd.DataFrame) -> None:
    failed = rows[rows["outcome"] == "agent_error"]
    if not failed.empty:
        first = failed.iloc[0]
        console.print(
            f"{cell.agent} in {cell.scenario}: {len(failed)} of {len(rows)} episodes ended by an "
            f"agent error, first with seed {first['seed']}: {first['error']}\n",
            style="red",
            markup=False,
            soft_wrap=True,
        )


_MOST_WAITS = 6
"""Names to be told each."""


def _print_waits(console: Console, rows: Mapping[str, pd.DataFrame]) -> None:
    """One line for all names, since what overloads a machine is seldom one agent's."""
    counts = {name: int(waited(part).sum()) for name, part in rows.items()}
    left_out = [f"{name} {n} of {len(rows[name])}" for name, n in counts.items() if n]
    if len(left_out) > _MOST_WAITS:
        left_out = [
            f"{sum(counts.values())} of {sum(map(len, rows.values()))}, in {len(left_out)} of "
            f"{len(rows)} cells"
        ]
    if left_out:
        console.print(
            "inference_s leaves episodes out, in which the process computed for less than "
            f"{TRUSTED_SHARE:.0%} of its time in act, as the machine was overloaded or the agent "
            f"waits for something: {', '.join(left_out)}\n",
            style="yellow",
            markup=False,
            soft_wrap=True,
        )


def _count(rows: pd.DataFrame, missing: int) -> str:
    """The number of rows, and whether episodes are missing."""
    return f"{len(rows)}, incomplete: {missing} missing" if missing else str(len(rows))


def _endings(rows: pd.DataFrame) -> str:
    counts = rows["outcome"].value_counts()
    return ", ".join(f"{count} {name}" for name, count in counts.items())


def _heading(name: str) -> str:
    metric = METRICS[name]
    unit = f" [{metric.printed_unit}]" if 0 < len(metric.printed_unit) <= _LONGEST_UNIT else ""
    return f"{name} {metric.arrow}" + escape(unit)


def _interval(metric: Metric, value: Estimate, beside: float | None = None) -> str:
    """Mean and limits, with the decimals of the mean or of ``beside``."""
    if math.isnan(value.low):
        return _number(metric, value.mean)
    decimals_of = value.mean if beside is None else beside
    mean, low, high = (metric.number(number, beside=decimals_of) for number in value[:3])
    return escape(f"{mean} [{low}, {high}]")


def _number(metric: Metric, value: float) -> str:
    return "-" if math.isnan(value) else metric.number(value)


def _p_value(p: float) -> str:
    return "-" if math.isnan(p) else "< 0.001" if p < 0.001 else f"{p:.3f}"
