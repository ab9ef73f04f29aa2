"""``crowdbench run`` and ``crowdbench compare``: measure, and tell agents apart."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.agent import AgentSpec
from crowdbench.cli_common import (
    DEFAULT_AGENT,
    DEFAULT_SCENARIO,
    TABLE_METRICS,
    ResultsOption,
    SetOption,
    UserError,
    out,
)
from crowdbench.scenario import load_scenario, nearest, parse_overrides

if TYPE_CHECKING:
    import pandas as pd

RESULTS = Path("results")


def run(
    scenario: Annotated[
        list[str] | None,
        typer.Option("--scenario", "-s", help="Name or .yaml file; may be repeated."),
    ] = None,
    agent: Annotated[
        list[str] | None,
        typer.Option(
            "--agent", "-a", help="NAME[:OPTION=VALUE,...] or FILE.py:CLASS; may be repeated."
        ),
    ] = None,
    episodes: Annotated[int, typer.Option("--episodes", "-n", min=1, help="Per cell.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Of the first episode; the rest follow.")] = 0,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, help="Processes, by default one per core.")
    ] = None,
    overrides: SetOption = None,
    results: ResultsOption = RESULTS,
    step_limit: Annotated[
        float, typer.Option(min=0.01, help="Seconds an agent may take for one step.")
    ] = 10.0,
    save_trajectories: Annotated[
        bool, typer.Option("--save-trajectories", help="Keep whole episodes, for replays.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document and nothing else.")
    ] = False,
) -> None:
    """Run agents in scenarios.

    One row per episode is stored; the same command goes on where it was stopped.
    """
    from crowdbench.cli_progress import ProgressBar
    from crowdbench.evaluation.pool import Limits
    from crowdbench.evaluation.results import ResultsStore
    from crowdbench.evaluation.runner import Task
    from crowdbench.evaluation.runner import run as run_tasks

    changes = parse_overrides(overrides or [])
    names = dict.fromkeys(scenario or [DEFAULT_SCENARIO])
    worlds = [load_scenario(name, **changes) for name in names]
    specs = {str(spec): spec for spec in map(AgentSpec.parse, agent or [DEFAULT_AGENT])}
    seeds = range(seed, seed + episodes)
    tasks = [Task(world, spec, seeds) for world in worlds for spec in specs.values()]
    with ProgressBar(sum(len(task.seeds) for task in tasks), quiet=as_json) as bar:
        try:
            cells = run_tasks(
                tasks,
                results,
                jobs=jobs,
                limits=Limits(step=step_limit),
                save_trajectories=save_trajectories,
                on_progress=bar.update,
            )
        except KeyboardInterrupt:
            bar.say_interrupted(results)
            raise typer.Exit(130) from None

    from crowdbench.cli_report import as_document, print_tables

    store = ResultsStore(results)
    rows = {cell: store.rows(cell) for cell in cells}
    rows = {cell: table[table["seed"].isin(seeds)] for cell, table in rows.items()}
    if as_json:
        typer.echo(json.dumps(as_document(store, rows), allow_nan=False))
    else:
        print_tables(out(), store, rows)
        bar.say_stored(results)


def compare(
    first: Annotated[str, typer.Argument(metavar="A", help="An agent, as it was run.")],
    second: Annotated[str, typer.Argument(metavar="B", help="Another.")],
    scenario: Annotated[
        list[str] | None,
        typer.Option("--scenario", "-s", help="By default all that both ran; may be repeated."),
    ] = None,
    metric: Annotated[
        list[str] | None,
        typer.Option("--metric", "-m", help="By default the paper's; may be repeated."),
    ] = None,
    results: ResultsOption = RESULTS,
) -> None:
    """Compare two agents on shared episodes."""
    from crowdbench.cli_report import print_comparison
    from crowdbench.evaluation.metrics import METRICS
    from crowdbench.evaluation.statistics import PairingError
    from crowdbench.evaluation.statistics import compare as compare_tables

    chosen = list(dict.fromkeys(metric or TABLE_METRICS))
    for name in chosen:
        if name not in METRICS:
            raise UserError(f"unknown metric {name!r}{nearest(name, list(METRICS))}")
    a, b = (_stored(results, text, scenario) for text in (first, second))
    same = ["scenario", "scenario_digest"]
    a, b = a.merge(b[same].drop_duplicates()), b.merge(a[same].drop_duplicates())
    try:
        table = compare_tables(_per_seed(a, chosen), _per_seed(b, chosen), chosen)
    except PairingError as error:
        raise UserError(f"{first} and {second} cannot be compared: {error}") from error
    print_comparison(out(), table, first, second)


def _stored(folder: Path, text: str, scenarios: Sequence[str] | None) -> pd.DataFrame:
    """The stored episodes of an agent, in some scenarios or in all."""
    from crowdbench.evaluation.results import load_results

    name = str(AgentSpec.parse(text))
    everything = load_results(folder)
    rows = everything[everything["agent"] == name]
    if rows.empty:
        known = sorted(set(everything["agent"]))
        hint = nearest(name, known) if known else "; nothing is stored there"
        raise UserError(f"{folder}: no episodes of agent {name!r}{hint}")
    for scenario in scenarios or []:
        if scenario not in set(rows["scenario"]):
            hint = nearest(scenario, sorted(set(rows["scenario"])))
            raise UserError(f"{folder}: no episodes of {name!r} in scenario {scenario!r}{hint}")
    return rows[rows["scenario"].isin(scenarios)] if scenarios else rows


def _per_seed(rows: pd.DataFrame, metrics: list[str]) -> pd.DataFrame:
    """One row per episode: the robots of one episode are no independent observations."""
    return rows.groupby(["scenario", "seed"], as_index=False, sort=False)[metrics].mean()
