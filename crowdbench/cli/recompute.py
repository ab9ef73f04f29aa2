"""``crowdbench recompute``: metrics of stored episodes from what the robots did."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from crowdbench.cli.common import (
    RESULTS,
    ChosenResultsOption,
    UserError,
    err,
    out,
    require_writable_record,
)

_SHOWN = 20
"""Lines of one kind that are printed."""


def recompute(
    results: ChosenResultsOption = None,
    record: Annotated[
        Path | None,
        typer.Option(
            "--record",
            metavar="FOLDER",
            help="A published record instead, in a checkout results/record.",
        ),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, help="Processes, by default one per core.")
    ] = None,
) -> None:
    """Simulate stored episodes again: fill in new metrics and check the others.

    No agent runs. Episodes that come out otherwise stay as they are and are named; of the record,
    the whole cell.
    """
    from rich.progress import Progress

    from crowdbench.evaluation.machine import core_count
    from crowdbench.evaluation.recompute import recompute as recompute_results
    from crowdbench.evaluation.recompute_record import recompute_record

    if record is not None:
        if results is not None:
            raise UserError("--results and --record: expected one of them")
        require_writable_record(record, "recompute")
    console = err()
    with Progress(console=console, disable=not console.is_terminal) as bar:
        line = bar.add_task("simulating", total=None)

        def show(done: int, total: int) -> None:
            bar.update(line, completed=done, total=total)

        if record is None:
            found = recompute_results(results or RESULTS, jobs or core_count(), show)
        else:
            found = recompute_record(record, jobs or core_count(), show)
    filled = ", ".join(f"{name} in {rows:,} rows" for name, rows in found.filled.items())
    _print_lines(found.without_commands, "")
    _print_lines(found.disagreements, "red")
    told = f"{found.episodes:,} episodes simulated again; filled in: {filled or 'nothing'}"
    if found.disagreements:
        told += f"; {len(found.disagreements):,} came out otherwise and stay as they were"
    elif found.episodes:
        told += "; everything else came out the same"
    else:
        told = "no episode could be simulated again, so nothing was checked"
    out().print(told, markup=False, soft_wrap=True)
    if found.disagreements:
        raise typer.Exit(1)


def _print_lines(lines: list[str], style: str) -> None:
    console = err()
    for line in lines[:_SHOWN]:
        console.print(line, style=style, markup=False, soft_wrap=True)
    if len(lines) > _SHOWN:
        console.print(f"... and {len(lines) - _SHOWN:,} more", style=style)
