"""``crowdbench recompute``: metrics of stored episodes from what the robots did."""

from __future__ import annotations

from typing import Annotated

import typer

from crowdbench.cli.common import RESULTS, ResultsOption, err, out

_SHOWN = 20
"""Lines of one kind that are printed."""


def recompute(
    results: ResultsOption = RESULTS,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, help="Processes, by default one per core.")
    ] = None,
) -> None:
    """Simulate stored episodes again: fill in new metrics and check the others.

    No agent runs. Episodes that come out otherwise stay as they are and are named.
    """
    from rich.progress import Progress

    from crowdbench.evaluation.recompute import recompute as recompute_all
    from crowdbench.evaluation.runner import core_count

    console = err()
    with Progress(console=console, disable=not console.is_terminal) as bar:
        line = bar.add_task("simulating", total=None)
        found = recompute_all(
            results,
            jobs or core_count(),
            lambda done, total: bar.update(line, completed=done, total=total),
        )
    filled = ", ".join(f"{name} in {rows:,} rows" for name, rows in found.filled.items())
    _print_lines(found.without_commands, "")
    _print_lines(found.disagreements, "red")
    told = f"{found.episodes:,} episodes simulated again; filled in: {filled or 'nothing'}"
    if found.disagreements:
        told += f"; {len(found.disagreements):,} came out otherwise and stay as they were"
    else:
        told += "; everything else came out the same"
    out().print(told, markup=False, soft_wrap=True)
    if found.disagreements:
        raise typer.Exit(1)


def _print_lines(lines: list[str], style: str) -> None:
    console = err()
    for line in lines[:_SHOWN]:
        console.print(line, style=style, markup=False, soft_wrap=True)
    if len(lines) > _SHOWN:
        console.print(f"... and {len(lines) - _SHOWN:,} more", style=style)
