"""The leaderboards: every stored agent in every stored scenario, each metric with its interval."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Any

import pandas as pd

from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.results import Cell
from crowdbench.evaluation.rows import not_computed
from crowdbench.evaluation.statistics import estimate_all, per_episode, samples_of
from crowdbench.scenario import Scenario, scenario_names

_SHOWN_ERRORS = 20


def metric_documents() -> list[dict[str, Any]]:
    """What the page has to know of each metric; ``scale`` leads to the printed unit."""
    return [
        {
            "name": name,
            "label": metric.title(name),
            "unit": metric.printed_unit,
            "scale": metric.scale,
            "digits": metric.digits,
            "better": metric.better,
            "definition": metric.definition,
            "main": metric.main,
        }
        for name, metric in METRICS.items()
    ]


def cell_documents(
    rows: pd.DataFrame, planned: Mapping[tuple[str, str], int] | None = None
) -> list[tuple[Cell, dict[str, Any]]]:
    """One document per scenario and agent, scenarios in their own order.

    Args:
        rows: as ``load_results`` returns them.
        planned: by scenario and agent how many episodes there should be, on seeds 0, 1, ...
    """
    planned = planned or {}
    order = {name: number for number, name in enumerate(scenario_names())}
    groups = rows.groupby(["scenario", "agent"], sort=False).indices
    documents, samples = [], []
    for key in sorted(groups, key=lambda key: (order.get(key[0], len(order)), *key)):
        stored = rows.iloc[groups[key]]
        last = stored.iloc[-1]
        cell = Cell(**{name: str(last[name]) for name in Cell.__dataclass_fields__})
        documents.append((cell, _cell_document(cell, stored, planned.get(key, 0))))
        samples += samples_of(METRICS, per_episode(stored, METRICS))
    found = map(list, estimate_all(samples))
    for _, document in documents:
        document["estimates"] = list(islice(found, len(METRICS)))
    return documents


def scenario_document(label: str, scenario: Scenario | None) -> dict[str, Any]:
    """What the page has to know of a scenario; None: it is not known any more."""
    if scenario is None:
        return {"label": label, "family": "unknown", "description": "", "arena": None}
    angle, lidar = scenario.lidar.field_of_view, scenario.lidar
    arena = scenario.arena
    return {
        "label": label,
        "family": family(scenario),
        "description": scenario.description,
        "arena": [arena.length, arena.width],
        "centre": arena.centre,
        "solids": arena.polygons,
        "lidar": {
            "beams": lidar.beams,
            "degrees": angle,
            "range": lidar.range,
            "mount": list(lidar.mount),
        },
    }


def family(scenario: Scenario) -> str:
    """What it has in common with others: corridor, map, or open and whether people react."""
    if scenario.arena.kind != "open":
        return scenario.arena.kind
    share = scenario.pedestrians.reactive
    return f"open, {'reactive' if share == 1 else 'nonreactive' if share == 0 else 'mixed'}"


def _cell_document(cell: Cell, rows: pd.DataFrame, planned: int) -> dict[str, Any]:
    outcomes = rows["outcome"].value_counts()
    failed = rows[rows["error"] != ""].head(_SHOWN_ERRORS)
    return {
        "agent": cell.agent,
        "version": str(rows["version"].iloc[-1]),
        "weights": cell.weights_sha256,
        "code": cell.code,
        "machines": sorted(set(rows["machine"])),
        "episodes": int(rows["seed"].nunique()),
        "missing": _missing(rows["seed"], planned),
        "outcomes": [[str(name), int(count)] for name, count in outcomes.items()],
        "errors": [
            [int(seed), str(error)]
            for seed, error in zip(failed["seed"], failed["error"], strict=True)
        ],
        "not_computed": [name for name, count in not_computed(rows).items() if count == len(rows)],
    }


def _missing(seeds: pd.Series, planned: int) -> int:
    """How many seeds are missing of those planned, and between the first and the last."""
    first, last = int(seeds.min()), int(seeds.max())
    return len({*range(planned), *range(first, last + 1)} - set(seeds))
