"""The figures that plot numbers: corridors, training and what non-reactive pedestrians cost."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from crowdbench_studies.paper.plan import (
    COMPARED,
    CORRIDORS,
    MOTIONS,
    NONREACTIVE,
    REACTIVE,
    TABLES,
)
from crowdbench_studies.paper.style import STYLES
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crowdbench.evaluation.database import ResultsError
from crowdbench.evaluation.statistics import Difference
from crowdbench.scenario import load_scenario
from crowdbench.study.measurements import Mean, Measurements, Pair
from crowdbench.study.model import Method
from crowdbench.study.style import WIDTH, styles

TRAINED = {"sac": "SAC", "tdmpc": "TD-MPC-style", "latent_planner": "Ours"}
"""Agents with a curve in ``results/training/<agent>.csv``."""

_LOOKS = styles([*(method.agent for method in COMPARED), *TRAINED], STYLES)


def corridors(measured: Measurements) -> Figure | None:
    """Figure 4: success and SPL over the corridor's density, with 95 % intervals."""
    methods = [m for m in COMPARED if any(measured.count(m.agent, (c,)) for c in CORRIDORS)]
    if not methods:
        return None
    shown = [("success", "Success"), ("spl", "SPL")]
    measured.means(Mean(m.agent, (c,), q) for m in methods for c in CORRIDORS for q, _ in shown)
    figure, axes = _figure(height=4.3, rows=2, sharex=True)
    marked = [method for method in methods if _LOOKS[method.agent].marker]
    for axis, (metric, label) in zip(axes, shown, strict=True):
        for method in methods:
            style = _LOOKS[method.agent]
            rank = marked.index(method) - (len(marked) - 1) / 2 if method in marked else 0.0
            estimates = measured.means(Mean(method.agent, (c,), metric) for c in CORRIDORS)
            mean, low, high = np.array([e[:3] for e in estimates]).T
            axis.errorbar(
                np.arange(len(CORRIDORS)) + 0.09 * rank,  # side by side, so that intervals show
                mean,
                yerr=None if method.bound else [mean - low, high - mean],
                color=style.color,
                marker=style.marker,
                linestyle=style.line,
                elinewidth=0.8,
                label=method.label,
                zorder=1 if method.bound else 2,
            )
        axis.set_ylabel(label)
        axis.set_ylim(None, 1.02)
        axis.margins(x=0.02)
    axes[-1].set_xticks(range(len(CORRIDORS)), [_density(name) for name in CORRIDORS])
    axes[-1].set_xlabel("Corridor: static obstacles + people")
    _legend_above(figure, axes[0])
    return figure


def training(folder: Path) -> Figure | None:
    """Figure 5: success on validation episodes over environment steps and over wall time.

    Args:
        folder: with one CSV file per agent, columns ``steps``, ``seconds`` and ``success``.

    Raises:
        ResultsError: a file without these columns or with other things than numbers.
    """
    curves = {agent: read_curve(folder / f"{agent}.csv") for agent in TRAINED}
    curves = {agent: curve for agent, curve in curves.items() if len(curve)}
    if not curves:
        return None
    figure, axes = _figure(height=2.2, columns=2, sharey=True)
    for axis, column, scale in ((axes[0], 0, 1e6), (axes[1], 1, 3600.0)):
        for agent, curve in curves.items():
            style = _LOOKS[agent]
            axis.plot(
                curve[:, column] / scale,
                curve[:, 2],
                color=style.color,
                marker=style.marker,
                markersize=3,
                markevery=max(1, len(curve) // 8),
                linestyle=style.line,
                label=TRAINED[agent],
            )
        axis.set_xlim(0, None)
        axis.set_ylim(0, 1)
    axes[0].set_ylabel("Validation success")
    axes[0].set_xlabel("Environment steps [10$^6$]")
    axes[1].set_xlabel("Wall time [h]")
    _legend_above(figure, axes[0], columns=len(curves))
    return figure


def reactivity(measured: Measurements) -> Figure | None:
    """Success lost when pedestrians stop reacting to the robot, per method, on paired episodes."""
    methods = [
        method
        for method in COMPARED
        if all(measured.count(method.agent, names) for names in (REACTIVE, NONREACTIVE))
    ]
    if not methods:
        return None
    figure, (axis,) = _figure(height=0.9 + 0.42 * len(methods))
    axis.axvline(0, color="0.4", linewidth=0.8)
    pooled: Any = {"color": "#D55E00", "marker": "o", "markersize": 5, "elinewidth": 1.6}
    single: Any = {"color": "0.5", "markerfacecolor": "white", "markersize": 3, "elinewidth": 0.6}
    single_motions = [(names[:1], names[1:]) for names in zip(REACTIVE, NONREACTIVE, strict=True)]
    losses = iter(
        measured.differences(
            Pair((method.agent, seen), (method.agent, unseen), "success")
            for method in methods
            for seen, unseen in [(REACTIVE, NONREACTIVE), *single_motions]
        )
    )
    for row, method in enumerate(methods):
        first = row == 0  # one entry of the legend for all rows
        _whisker(axis, next(losses), row - 0.15, "All four" if first else "", pooled)
        paper = _paper_loss(method)
        if paper is not None:
            label = "The paper's tables" if first else ""
            axis.errorbar(paper, row - 0.15, color="black", marker="x", linestyle="", label=label)
        for number, name in enumerate(REACTIVE):
            label = MOTIONS[name] if first else ""
            motion = {"marker": "s^Dv"[number], **single}
            _whisker(axis, next(losses), row + 0.08 + 0.13 * number, label, motion)
    axis.set_yticks(range(len(methods)), [method.label for method in methods])
    axis.set_ylim(len(methods) - 0.3, -0.5)
    axis.grid(axis="y", visible=False)
    axis.set_xlabel("Success lost when not seen")
    _legend_above(figure, axis, columns=2)
    return figure


def read_curve(path: Path) -> np.ndarray:
    """(n, 3) environment steps, seconds and success of a training; empty without a file.

    Raises:
        ResultsError: a column is missing or holds something else than numbers.
    """
    names = ("steps", "seconds", "success")
    if not path.is_file():
        return np.empty((0, 3))
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    try:
        points = [[float(row[name]) for name in names] for row in rows]
    except (KeyError, TypeError, ValueError) as error:
        raise ResultsError(f"{path}: expected numbers in columns {', '.join(names)}") from error
    return np.array(points).reshape(-1, 3)


def _whisker(axis: Axes, loss: Difference, height: float, label: str, look: Any) -> None:
    """A mean with its interval along x."""
    reach = [[loss.mean - loss.low], [loss.high - loss.mean]]
    axis.errorbar(loss.mean, height, xerr=reach, linestyle="", label=label, **look)


def _paper_loss(method: Method) -> float | None:
    """Mean success of the paper's Table I less that of its Table II."""
    means = []
    for table in TABLES[:2]:
        cells = [(block.heading, method.label, "success") for block in table.blocks]
        if not all(cell in table.reference for cell in cells):
            return None
        means.append(np.mean([table.reference[cell] for cell in cells]))
    return float(means[0] - means[1])


def _density(name: str) -> str:
    scenario = load_scenario(name)
    word = name.removeprefix("corridor_").replace("_", " ")
    return f"{word}\n{scenario.obstacles.count} + {scenario.pedestrians.count}"


def _figure(
    height: float, rows: int = 1, columns: int = 1, **options: Any
) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, list(figure.subplots(rows, columns, squeeze=False, **options).flat)


def _legend_above(figure: Figure, axis: Axes, columns: int = 3) -> None:
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, columnspacing=0.8)
