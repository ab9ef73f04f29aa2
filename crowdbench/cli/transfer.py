"""``crowdbench export`` and ``import``: stored episodes out of the database and into it."""

from __future__ import annotations

import importlib.util
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from crowdbench.cli.common import RESULTS, ResultsOption, UserError, out
from crowdbench.replacing import replacing


class Format(StrEnum):
    """What rows are written as."""

    csv = "csv"
    parquet = "parquet"


def export(
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="File to write; CSV is printed without it."),
    ] = None,
    kind: Annotated[Format, typer.Option("--format", help="What to write.")] = Format.csv,
    results: ResultsOption = RESULTS,
) -> None:
    """Write the rows of stored episodes as CSV or Parquet; superseded ones are left out."""
    if kind is Format.parquet and output is None:
        raise UserError("Parquet is written to a file: name one with --output")
    if kind is Format.parquet and importlib.util.find_spec("pyarrow") is None:
        raise UserError("Parquet needs pyarrow, which is not installed: pip install pyarrow")

    from crowdbench.evaluation.results import load_results, require_episodes

    require_episodes(results)
    rows = load_results(results)
    if output is None:
        typer.echo(rows.to_csv(index=False), nl=False)
        return
    if output.exists() and not output.is_file():
        raise UserError(
            f"{output}: not a file, so nothing is put in its place; without --output CSV is printed"
        )
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        with replacing(output) as part:
            if kind is Format.csv:
                rows.to_csv(part, index=False)
            else:
                rows.to_parquet(part, index=False)
    except OSError as error:
        raise UserError(f"{output}: cannot be written ({error.strerror or error})") from error
    out().print(f"{output}: {len(rows):,} rows", markup=False, soft_wrap=True)


def import_results(
    folder: Annotated[Path, typer.Argument(help="Results folder of crowdbench 0.1.0.")],
    results: ResultsOption = RESULTS,
) -> None:
    """Take over results of crowdbench 0.1.0 (CSV files); what is stored already stays.

    Whole episodes beside them give commands, so that they can be seen again and recomputed.
    """
    from crowdbench.evaluation.csv_results import read_csv_cells
    from crowdbench.evaluation.database import require_writable
    from crowdbench.evaluation.results import ResultsStore

    require_writable(results)
    store = ResultsStore(results)
    found, new, whole = 0, 0, 0
    for part in read_csv_cells(folder):
        found += len(part.results)
        whole += sum(result.commands is not None for result in part.results)
        new += store.append(part.cell, part.results, part.scenario)
    out().print(
        f"{store.path}: {new:,} rows imported, {found - new:,} were there; {whole:,} of them with "
        "commands",
        markup=False,
        soft_wrap=True,
    )
