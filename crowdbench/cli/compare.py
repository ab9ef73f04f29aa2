"""``crowdbench compare``: tell two agents apart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.agent import AgentSpec
from crowdbench.cli.common import RESULTS, ChosenResultsOption, UserError, out
from crowdbench.messages import nearest

if TYPE_CHECKING:
    import pandas as pd


def compare(
    first: Annotated[str, typer.Argument(metavar="A", help="An agent, as it was run.")],
    second: Annotated[str, typer.Argument(metavar="B", help="Another.")],
    scenario: Annotated[
        list[str] | None,
        typer.Option("--scenario", "-s", help="By default all that both ran; may be repeated."),
    ] = None,
    metric: Annotated[
        list[str] | None,
        typer.Option("--metric", "-m", help="By default the main ones; may be repeated."),
    ] = None,
    results: ChosenResultsOption = None,
) -> None:
    """Compare two agents on shared episodes, your own and published ones."""
    from crowdbench.cli.printing import (
        print_comparison,
        print_not_computed,
        print_published,
    )
    from crowdbench.evaluation.metrics import METRICS
    from crowdbench.evaluation.results import require_episodes
    from crowdbench.evaluation.rows import not_computed
    from crowdbench.evaluation.statistics import PairingError, per_episode
    from crowdbench.evaluation.statistics import compare as compare_tables

    main = [name for name, entry in METRICS.items() if entry.main]
    chosen = {name: METRICS[name] for name in metric or main}
    if results is not None:
        require_episodes(results)
    folder = results or RESULTS
    a, b = (_stored(folder, text, scenario) for text in (first, second))
    for text, rows in ((first, a), (second, b)):
        for name in metric or []:
            if not_computed(rows).get(name) == len(rows):
                raise UserError(f"{folder}: the episodes of {text} are older than metric {name!r}")
    same = ["scenario", "scenario_digest"]
    a, b = a.merge(b[same].drop_duplicates()), b.merge(a[same].drop_duplicates())
    try:
        table = compare_tables(per_episode(a, chosen), per_episode(b, chosen), list(chosen))
    except PairingError as error:
        raise UserError(f"{first} and {second} cannot be compared: {error}") from error
    console = out()
    print_comparison(console, table, first, second)
    print_not_computed(console, {first: a, second: b}, list(chosen))
    print_published(console, {first: a, second: b})


def _stored(folder: Path, text: str, scenarios: Sequence[str] | None) -> pd.DataFrame:
    """The episodes of an agent, in some scenarios or in all; published where not run here."""
    from crowdbench.evaluation.joined import published_and_local
    from crowdbench.evaluation.record import read_record

    name = str(AgentSpec.parse(text))
    rows = published_and_local(folder, agent=name, first="local")
    if rows.empty:
        outdated = read_record(agent=name).outdated
        known = sorted(set(published_and_local(folder)["agent"]))
        hint = nearest(name, known) if known else "; nothing is stored there"
        if outdated:
            hint = f"; the record of {name!r} is {next(iter(outdated.values()))}"
        raise UserError(f"{folder}: no episodes of agent {name!r}{hint}")
    for scenario in scenarios or []:
        if scenario not in set(rows["scenario"]):
            hint = nearest(scenario, sorted(set(rows["scenario"])))
            for reason in read_record(scenario, name).outdated.values():
                hint = f"; the record of {scenario!r} is {reason}"
            raise UserError(f"{folder}: no episodes of {name!r} in scenario {scenario!r}{hint}")
    return rows[rows["scenario"].isin(scenarios)] if scenarios else rows
