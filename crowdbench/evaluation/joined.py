"""Published and local rows of one agent in one scenario, side by side and never mixed up."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from crowdbench.evaluation.record import load_record
from crowdbench.evaluation.results import Cell, load_results
from crowdbench.scenario import ScenarioError, load_scenario

if TYPE_CHECKING:
    import pandas as pd

PUBLISHED = "published"
"""Where rows are from that the record has; else their results folder."""
Key = tuple[str, str]
"""Scenario and agent."""


def published_and_local(
    folder: Path,
    scenario: str | None = None,
    agent: str | None = None,
    *,
    first: Literal["published", "local"] = "published",
    record: Path | None = None,
) -> pd.DataFrame:
    """The rows of the record and of a results folder, each episode once.

    For one agent in one scenario, the rows of ``first`` are taken, and from the other those of
    seeds that it lacks, provided that they are the same measurement (``Cell.identity``). Local
    rows of a scenario that is defined otherwise by now never stand before published ones.

    Args:
        folder: results folder; it need not exist.
        scenario: only this label.
        agent: only this one, with its options.
        first: whose rows count where both have a seed.
        record: folder of the record, by default the installed one.

    Returns:
        As ``load_results``, and where each row is from in the column ``source``: "published", or
        the results folder.

    Raises:
        ResultsError: rows that cannot be read.
    """
    import pandas as pd

    published = load_record(scenario, agent, record)
    local = local_rows(folder, scenario, agent)
    local = local[~_keys(local).isin({key for key in cells_of(published) if _outdated(local, key)})]
    leading, filling = (published, local) if first == "published" else (local, published)
    known, offered = cells_of(leading), cells_of(filling)
    fits = {key for key, cell in offered.items() if _same(cell, known.get(key, cell))}
    seeds = ["scenario", "agent", "seed"]
    there = pd.MultiIndex.from_frame(leading[seeds])
    wanted = _keys(filling).isin(fits) & ~pd.MultiIndex.from_frame(filling[seeds]).isin(there)
    parts = [part for part in (leading, filling[wanted]) if len(part)]
    if not parts:
        return leading
    rows = pd.concat(parts, ignore_index=True)
    return rows.sort_values(["scenario", "agent", "seed", "robot"], ignore_index=True)


def local_rows(folder: Path, scenario: str | None = None, agent: str | None = None) -> pd.DataFrame:
    """The rows of a results folder alone, as ``published_and_local`` gives them."""
    return load_results(folder, scenario, agent).assign(source=str(folder))


def cells_of(rows: pd.DataFrame) -> dict[Key, Cell]:
    """The cell of every scenario and agent, as its last row has it."""
    names = list(Cell.__dataclass_fields__)
    last = rows.drop_duplicates(["scenario", "agent"], keep="last")[names]
    cells = [Cell(*map(str, values)) for values in last.itertuples(index=False)]
    return {(cell.scenario, cell.agent): cell for cell in cells}


def _same(one: Cell, other: Cell) -> bool:
    return one.identity == other.identity


def _keys(rows: pd.DataFrame) -> pd.MultiIndex:
    import pandas as pd

    return pd.MultiIndex.from_frame(rows[["scenario", "agent"]])


def _outdated(rows: pd.DataFrame, key: Key) -> bool:
    """Whether rows are of a scenario that is defined otherwise by now."""
    cell = cells_of(rows).get(key)
    if cell is None:
        return False
    try:
        return load_scenario(cell.scenario).digest != cell.scenario_digest
    except ScenarioError:
        return True
