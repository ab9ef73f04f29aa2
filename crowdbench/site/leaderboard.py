"""The leaderboards: every stored agent in every stored scenario, each metric with its interval."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import pandas as pd

from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.resampling import bootstrap_mean
from crowdbench.evaluation.results import Cell
from crowdbench.evaluation.statistics import Estimate, wilson_interval
from crowdbench.scenario import Scenario, scenario_names

_SHOWN_ERRORS = 20
_PRINTED = {"inference_s": (1000.0, "ms")}


def metric_documents(main: Collection[str]) -> list[dict[str, Any]]:
    """What the page has to know of each metric; ``scale`` leads to the printed unit.

    Args:
        main: names of those that are shown unless all are asked for.
    """
    documents = []
    for name, metric in METRICS.items():
        scale, unit = _PRINTED.get(name, (1.0, metric.unit))
        documents.append(
            {
                "name": name,
                "label": name.removesuffix("_s").replace("_", " "),
                "unit": unit,
                "scale": scale,
                "better": metric.better,
                "definition": metric.definition,
                "main": name in main,
            }
        )
    return documents


def cell_documents(rows: pd.DataFrame) -> list[tuple[Cell, dict[str, Any]]]:
    """One document per scenario and agent, scenarios in their own order.

    Args:
        rows: as ``load_results`` returns them.
    """
    order = {name: number for number, name in enumerate(scenario_names())}
    groups = sorted(
        rows.groupby(["scenario", "agent"], sort=False),
        key=lambda group: (order.get(group[0][0], len(order)), *group[0]),
    )
    documents = []
    for _, stored in groups:
        last = stored.iloc[-1]
        cell = Cell(**{name: str(last[name]) for name in Cell.__dataclass_fields__})
        documents.append((cell, _cell_document(cell, stored)))
    return documents


def scenario_document(label: str, scenario: Scenario | None) -> dict[str, Any]:
    """What the page has to know of a scenario; None: it is not known any more."""
    if scenario is None:
        return {"label": label, "family": "unknown", "description": "", "arena": None}
    angle, lidar = scenario.lidar.field_of_view, scenario.lidar
    return {
        "label": label,
        "family": family(scenario),
        "description": scenario.description,
        "arena": [scenario.arena.length, scenario.arena.width],
        "lidar": {"beams": lidar.beams, "degrees": angle, "range": lidar.range},
    }


def family(scenario: Scenario) -> str:
    """What a scenario has in common with others: corridor, or open and whether people react."""
    if scenario.arena.kind == "corridor":
        return "corridor"
    share = scenario.pedestrians.reactive
    return f"open, {'reactive' if share == 1 else 'nonreactive' if share == 0 else 'mixed'}"


def _cell_document(cell: Cell, rows: pd.DataFrame) -> dict[str, Any]:
    outcomes = rows["outcome"].value_counts()
    failed = rows[rows["error"] != ""].head(_SHOWN_ERRORS)
    # The robots of one episode are no independent observations.
    several = rows["robot"].nunique() > 1
    names = [name for name in METRICS if name in rows]
    episodes = rows.groupby("seed", sort=True)[names].mean() if several else rows
    return {
        "agent": cell.agent,
        "version": cell.version,
        "weights": cell.weights_sha256,
        "code": cell.code,
        "machines": sorted(set(rows["machine"])),
        "episodes": int(rows["seed"].nunique()),
        "outcomes": [[str(name), int(count)] for name, count in outcomes.items()],
        "errors": [
            [int(seed), str(error)]
            for seed, error in zip(failed["seed"], failed["error"], strict=True)
        ],
        "estimates": [_estimate(episodes, name, exact=not several) for name in METRICS],
    }


def _estimate(episodes: pd.DataFrame | Mapping[str, Any], name: str, exact: bool) -> list[Any]:
    """Mean, low, high and number of episodes; Wilson where every value is a yes or a no."""
    if name not in episodes:
        return list(Estimate(np.nan, np.nan, np.nan, 0))
    values = np.asarray(episodes[name], dtype=float)
    found = wilson_interval(values) if name == "success" and exact else bootstrap_mean(values)
    return [*map(float, found[:3]), int(found.n)]
