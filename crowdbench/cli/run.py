"""``crowdbench run``: measure agents in scenarios."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from crowdbench.agent import AgentSpec
from crowdbench.cli.common import (
    DEFAULT_AGENT,
    DEFAULT_SCENARIO,
    RESULTS,
    AddressOption,
    ExecutorOption,
    ResultsOption,
    SetOption,
    out,
)
from crowdbench.cli.shard import Shard
from crowdbench.scenario import load_scenario, parse_overrides

MOST_EPISODES = 1_000_000
"""Of a cell in one run: the plan of a run is held in memory."""
LAST_SEED = 2**62
"""Seeds of a run stay within what the results can hold."""


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
    episodes: Annotated[
        int, typer.Option("--episodes", "-n", min=1, max=MOST_EPISODES, help="Per cell.")
    ] = 20,
    seed: Annotated[
        int, typer.Option(min=0, max=LAST_SEED, help="Of the first episode; the rest follow.")
    ] = 0,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, help="Processes, by default one per core.")
    ] = None,
    executor: ExecutorOption = "local",
    address: AddressOption = None,
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="I/N",
            help="Run the I-th of N parts alone, to shard-I-of-N in the results folder; "
            "crowdbench merge puts them together.",
        ),
    ] = None,
    overrides: SetOption = None,
    results: ResultsOption = RESULTS,
    step_limit: Annotated[
        float, typer.Option(min=0.01, help="Seconds an agent may take for one step.")
    ] = 10.0,
    retry_errors: Annotated[
        bool,
        typer.Option("--retry-errors", help="Run stored episodes with an agent_error again."),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document and nothing else.")
    ] = False,
) -> None:
    """Run agents in scenarios.

    Every episode is stored with what the robot did; the same command goes on where it was stopped.
    Where the same agent has published episodes in the same scenario, their figures stand beside.
    The exit status is 1 if episodes are missing, or all of an agent in a scenario are agent errors.
    """
    from crowdbench.cli.progress import ProgressBar
    from crowdbench.evaluation.metrics import METRICS
    from crowdbench.evaluation.pool import Limits
    from crowdbench.evaluation.results import ResultsStore
    from crowdbench.evaluation.runner import IncompleteError, Missing, Task
    from crowdbench.evaluation.runner import run as run_tasks

    list(METRICS.values())  # a broken one of another package is named before anything is run
    changes = parse_overrides(overrides or [])
    names = dict.fromkeys(scenario or [DEFAULT_SCENARIO])
    worlds = [load_scenario(name, **changes) for name in names]
    specs = {str(spec): spec for spec in map(AgentSpec.parse, agent or [DEFAULT_AGENT])}
    seeds = range(seed, seed + episodes)
    if shard is not None:
        part = Shard.parse(shard)
        seeds, results = part.seeds(seeds), part.folder(results)
    tasks = [Task(world, spec, seeds) for world in worlds for spec in specs.values()]
    missing: Sequence[Missing] = ()
    with (
        ProgressBar(sum(len(task.seeds) for task in tasks), quiet=as_json) as bar,
        contextlib.redirect_stdout(sys.stderr),  # what executors' libraries have to say
    ):
        try:
            cells = run_tasks(
                tasks,
                results,
                jobs=jobs,
                limits=Limits(step=step_limit),
                executor=executor,
                address=address,
                retry_errors=retry_errors,
                on_progress=bar.update,
                on_note=bar.note,
            )
        except KeyboardInterrupt:
            bar.say_interrupted(results)
            raise typer.Exit(130) from None
        except IncompleteError as error:
            cells, missing = error.cells, error.missing

    from crowdbench.cli.printing import as_document, print_tables
    from crowdbench.evaluation.record import load_record

    store = ResultsStore(results)
    rows = {cell: store.rows(cell) for cell in cells}
    rows = {cell: table[table["seed"].isin(seeds)] for cell, table in rows.items()}
    lacking = {cell: [one for one in missing if one.cell == cell] for cell in cells}
    # What is incomplete stands last: it is not to be compared with the rest.
    rows = dict(sorted(rows.items(), key=lambda item: bool(lacking[item[0]])))
    if as_json:
        typer.echo(json.dumps(as_document(store, rows, lacking), allow_nan=False))
    else:
        published = {cell: load_record(cell.scenario, cell.agent) for cell in cells}
        print_tables(
            out(),
            store,
            rows,
            {cell: part for cell, part in published.items() if len(part)},
            lacking,
        )
        bar.say_stored(results)
    if missing:
        bar.say_missing(missing)
    # Some errors are a result, nothing but errors is none.
    if missing or any((table["outcome"] == "agent_error").all() for table in rows.values()):
        raise typer.Exit(1)
