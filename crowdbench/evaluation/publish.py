"""From a results folder into the published record: what a plan asks for, and nothing else."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.evaluation.joined import cells_of
from crowdbench.evaluation.record import Commands, Key, load_commands, load_record, write_cell
from crowdbench.evaluation.results import Cell, load_driven, load_results, scenario_label
from crowdbench.evaluation.rows import metric_columns, not_computed
from crowdbench.scenario import load_scenario

if TYPE_CHECKING:
    import pandas as pd


class Change(NamedTuple):
    """What publishing has changed in one cell.

    Attributes:
        cell: whose rows were published.
        added: episodes that the record did not have.
        replaced: episodes that it had, from another run.
        outcomes: those of the replaced that ended otherwise than before.
        differences: for each metric that differs in a replaced row the largest relative
            difference, |new - old| / max(|new|, |old|); 1 where only one of them is defined.
    """

    cell: Cell
    added: int
    replaced: int
    outcomes: int
    differences: dict[str, float]


class Outcome(NamedTuple):
    """What publishing came to.

    Attributes:
        changes: one for each cell that was written.
        refused: why a cell was left as it is, a sentence each.
    """

    changes: list[Change]
    refused: list[str]


def publish(plan: Iterable[tuple[str, str, int]], results: Path, record: Path) -> Outcome:
    """Write local rows and their commands into the record.

    A local episode takes the place of the published one with the same seed. The local ones stay
    where they are. Episodes that are another measurement than the published ones (other weights,
    code or version) replace all of a cell or nothing.

    Args:
        plan: scenario, agent and number of episodes, on seeds 0, 1, ..., for each cell.
        results: results folder.
        record: folder of the record.

    Raises:
        ResultsError: something cannot be read or written; cells before it are published.
    """
    outcome = Outcome([], [])
    for scenario, agent, episodes in plan:
        world = load_scenario(scenario)
        label = scenario_label(world)
        local = load_results(results, label, agent)
        local = local[(local["scenario_digest"] == world.digest) & (local["seed"] < episodes)]
        if local.empty:
            continue
        if "@" in label:
            outcome.refused.append(f"{agent} in {label}: the record has installed scenarios only")
            continue
        cell = cells_of(local)[label, agent]
        old = load_record(label, agent, record)  # of all seeds, which stay whatever the plan
        lacking = set(old["seed"]) - set(local["seed"])
        if lacking and not _same_measurement(old, cell):
            outcome.refused.append(
                f"{agent} in {label}: other weights, code or version than published, and "
                f"{len(lacking)} of the {old['seed'].nunique()} published seeds were not run"
            )
            continue
        change = _publish_cell(cell, local, old, results, record)
        if isinstance(change, str):
            outcome.refused.append(f"{agent} in {label}: {change}")
        elif change is not None:
            outcome.changes.append(change)
    return outcome


def _publish_cell(
    cell: Cell, local: pd.DataFrame, old: pd.DataFrame, results: Path, record: Path
) -> Change | str | None:
    """Write one cell; None if all of it is published already, or why it was not written."""
    import pandas as pd

    same = len(old) > 0 and _same_measurement(old, cell)
    kept = load_commands(cell, record) if same else Commands()
    stamps = ["seed", "robot", "outcome", "steps", "timestamp"]
    known = old[stamps] if same else old[stamps].iloc[:0]
    published = set(known.itertuples(index=False, name=None))
    new = [
        int(seed)
        for seed, rows in local.groupby("seed")
        if not published.issuperset(rows[stamps].itertuples(index=False, name=None))
    ]
    commands: dict[Key, NDArray[np.float64]] = {}
    times: dict[Key, NDArray[np.floating]] = {}
    for seed in sorted(set(local["seed"]) - (kept.seeds - set(new))):
        for one in load_driven(results, cell, seed) or []:
            commands[seed, one.robot] = one.commands
            times[seed, one.robot] = one.inference_s
    if not new and not commands:
        return None
    there = set(old["seed"])
    for seed in kept.seeds & (there - set(new)):
        commands |= {(seed, robot): told for robot, told in kept.of(seed).items()}
        times |= {(seed, robot): took for robot, took in kept.times(seed).items()}
    fresh = local[local["seed"].isin(new)]
    rows = pd.concat([part for part in (old[~old["seed"].isin(new)], fresh) if len(part)])
    # A file says by its columns what all of its rows were measured with.
    partly = [name for name, count in not_computed(rows).items() if count < len(rows)]
    if partly:
        return (
            f"some rows, published or local, are older than {', '.join(partly)}; crowdbench "
            "recompute fills it in"
        )
    write_cell(record, cell, rows, commands, times)
    replaced = [seed for seed in new if seed in there]
    outcomes, differences = _differences(old, fresh)
    return Change(cell, len(new) - len(replaced), len(replaced), outcomes, differences)


def _same_measurement(rows: pd.DataFrame, cell: Cell) -> bool:
    return all(one.identity == cell.identity for one in cells_of(rows).values())


def _differences(old: pd.DataFrame, new: pd.DataFrame) -> tuple[int, dict[str, float]]:
    """How many episodes ended otherwise, and how far each metric differs at most."""
    names = [name for name in metric_columns(new.columns) if name in old and name != "source"]
    pairs = old.merge(new, on=["seed", "robot"], suffixes=("_old", "_new"))
    differences = {}
    for name in names:
        a, b = (pairs[f"{name}_{which}"].to_numpy(dtype=float) for which in ("old", "new"))
        size = np.fmax(np.abs(a), np.abs(b))
        with np.errstate(invalid="ignore", divide="ignore"):
            relative = np.where(a == b, 0.0, np.abs(a - b) / size)
        relative = np.where(
            np.isnan(a) & np.isnan(b), 0.0, np.where(np.isnan(relative), 1.0, relative)
        )
        if len(relative) and relative.max() > 0:
            differences[name] = float(relative.max())
    changed = pairs["outcome_old"] != pairs["outcome_new"]
    return int(pairs.loc[changed, "seed"].nunique()), differences
