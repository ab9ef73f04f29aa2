"""``crowdbench publish``: from local results into the record of a checkout."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.common import (
    DEFAULT_STUDY,
    PUBLISHED,
    RESULTS,
    ResultsOption,
    UserError,
    out,
    require_writable_record,
)
from crowdbench.messages import short

if TYPE_CHECKING:
    from crowdbench.evaluation.publish import Change

_SHOWN = 1e-9
"""Relative differences below this are not worth a line."""


def publish(
    study: Annotated[
        str, typer.Argument(metavar="[STUDY]", help="Name of a study, or FILE.py with one.")
    ] = DEFAULT_STUDY,
    results: ResultsOption = RESULTS,
    record: Annotated[
        Path, typer.Option("--record", metavar="FOLDER", help="The record to write to.")
    ] = PUBLISHED / "record",
) -> None:
    """Write local episodes of a study into the published record of a checkout.

    Only those that the study asks for; an episode that is published already is replaced.
    """
    from crowdbench.evaluation.publish import publish as publish_plan
    from crowdbench.evaluation.results import require_episodes
    from crowdbench.study import StudyError
    from crowdbench.study.library import load_study

    try:
        plan = load_study(study).cells()
    except StudyError as error:
        raise UserError(str(error)) from error
    require_writable_record(record, "publish")
    require_episodes(results)
    outcome = publish_plan(plan, results, record)
    if not outcome.changes and not outcome.refused:
        raise UserError(
            f"{results}: no episode is stored here that study {short(study)} asks for, of its "
            "scenarios as they are now"
        )
    console = out()
    for change in outcome.changes:
        console.print(_told(change), markup=False, soft_wrap=True)
    for reason in outcome.refused:
        console.print(f"not published: {reason}", style="yellow", markup=False, soft_wrap=True)
    added, replaced = (
        sum(getattr(change, name) for change in outcome.changes) for name in ("added", "replaced")
    )
    console.print(f"{record}: {added:,} episodes added, {replaced:,} replaced", markup=False)
    if outcome.refused:
        raise typer.Exit(1)


def _told(change: Change) -> str:
    cell = change.cell
    parts = [f"{change.added} added"] if change.added else []
    if change.replaced:
        changed = f"{change.outcomes} outcomes changed" if change.outcomes else "same outcomes"
        parts.append(f"{change.replaced} replaced ({changed})")
    different = [
        f"{name} {size:.2g}"
        for name, size in sorted(change.differences.items(), key=lambda item: -item[1])
        if size > _SHOWN
    ]
    if different:
        parts.append(f"largest relative differences: {', '.join(different)}")
    return f"{cell.agent} in {cell.scenario}: {'; '.join(parts) or 'commands added'}"
