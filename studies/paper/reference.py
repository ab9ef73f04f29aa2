"""The numbers of the paper's Tables I to VII, to show beside ours and never in their place."""

from __future__ import annotations

import csv
from dataclasses import replace
from importlib import resources
from typing import NamedTuple

from crowdbench.study import Block, Method, Quantity, Table

_METHODS = {
    "NeuPAN": "neupan",
    "SAC": "sac",
    "TD-MPC-style": "tdmpc",
    "Ours, H=3, E=3": "latent_planner H=3 E=3",
    "Ours, H=3, E=1": "latent_planner H=3 E=1",
    "Ours, H=6, E=6": "latent_planner H=6 E=6",
    "Ours, H=6, E=1": "latent_planner H=6 E=1",
    "Ours, H=10, E=10": "latent_planner H=10 E=10",
    "Ours, H=10, E=1": "latent_planner H=10 E=1",
    "Policy only": "policy only",
    "MPPI without policy prior": "MPPI without policy prior",
    "Policy prior + MPPI": "policy prior + MPPI",
    "E=6, without smoothness": "H=6 E=6 without smoothness",
    "E=1, without smoothness": "H=6 E=1 without smoothness",
    "E=6, with smoothness": "H=6 E=6 with smoothness",
    "E=1, with smoothness": "H=6 E=1 with smoothness",
    "SAC (Q only)": "SAC (Q only)",
    "Reward only": "reward only",
    "Reward + Q": "reward + Q",
    "Without social reward": "H=6 E=6 without social reward",
    "With social reward": "H=6 E=6 with social reward",
}
"""Labels of our tables, and the same methods in the words of ``paper_tables.csv``."""

_QUANTITIES = {
    "success": ("success", 1.0),
    "spl": ("spl", 1.0),
    "smoothness": ("smoothness", 1.0),
    "inference_s": ("inference_s", 1.0),
    "cutoff": ("cutoff_per_episode", 1.0),
    "min_dist": ("min_dist_m", 1.0),
    "ttc_below_1s": ("ttc_below_1s_percent", 0.01),
}
"""Metrics in those words, and the factor from the paper's unit to ours."""


class PaperKey(NamedTuple):
    """Where a number stands in the paper, in the words of ``paper_tables.csv``."""

    table: str
    scenario: str
    pedestrians: str
    method: str
    metric: str


def load_paper() -> dict[PaperKey, float]:
    """Every number of the paper's tables."""
    file = resources.files("crowdbench_studies.paper") / "paper_tables.csv"
    rows = csv.DictReader(file.read_text(encoding="utf-8").splitlines())
    return {
        PaperKey(*(row[name] for name in PaperKey._fields)): float(row["value"]) for row in rows
    }


def paper_key(table: Table, block: Block, method: Method, quantity: Quantity) -> PaperKey | None:
    """Where the paper has a cell's number; None for a method it does not have."""
    name = _METHODS.get(method.label)
    if name is None:
        return None
    return PaperKey(table.number, *_place(block), name, _QUANTITIES[quantity.metric][0])


def with_reference(table: Table) -> Table:
    """The table with the paper's numbers, in our units."""
    paper = load_paper()
    values = {
        (block.heading, method.label, quantity.metric): paper[key] * _QUANTITIES[quantity.metric][1]
        for block in table.blocks
        for method in table.methods
        for quantity in table.quantities
        if (key := paper_key(table, block, method, quantity)) is not None
    }
    return replace(table, reference=values)


def _place(block: Block) -> tuple[str, str]:
    """Scenario and pedestrians of a block in the paper's words."""
    if len(block.scenarios) > 1:
        return "open", "unspecified"
    (name,) = block.scenarios
    if name.startswith("corridor"):
        return name, "unspecified"
    motion = name.removesuffix("_nonreactive")
    return motion, "reactive" if motion == name else "nonreactive"
