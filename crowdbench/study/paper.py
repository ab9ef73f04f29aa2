"""The numbers of the paper's Tables I to VII, to show beside ours and never in their place."""

from __future__ import annotations

import csv
from importlib import resources
from typing import NamedTuple


class PaperKey(NamedTuple):
    """Where a number stands in the paper, in the words of ``paper_tables.csv``."""

    table: str
    scenario: str
    pedestrians: str
    method: str
    metric: str


def load_paper() -> dict[PaperKey, float]:
    """Every number of the paper's tables."""
    file = resources.files("crowdbench.study") / "paper_tables.csv"
    rows = csv.DictReader(file.read_text(encoding="utf-8").splitlines())
    return {
        PaperKey(*(row[name] for name in PaperKey._fields)): float(row["value"]) for row in rows
    }
