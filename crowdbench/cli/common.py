"""What the commands share: their consoles, their common options, and the user's mistakes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

DEFAULT_AGENT = "latent_planner"
DEFAULT_SCENARIO = "multimodal_fast"
DEFAULT_STUDY = "paper"
RESULTS = Path("crowdbench-results")
PUBLISHED = Path("results")
"""Where the published record and what follows from it are in a checkout."""

SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a field, e.g. pedestrians.count=12."),
]
ResultsOption = Annotated[Path, typer.Option("--results", help="Results folder.")]
ChosenResultsOption = Annotated[
    Path | None, typer.Option("--results", help=f"Results folder, by default {RESULTS}.")
]
"""Tells a folder that was asked for, and has to be there, from the default one."""
AloneOption = Annotated[
    Path | None,
    typer.Option(
        "--results",
        help="Results folder, of which the rows are taken alone; by default the published rows, "
        f"and those in {RESULTS} where nothing is published.",
    ),
]
ExecutorOption = Annotated[
    str, typer.Option("--executor", metavar="NAME", help="Where agents run: local or ray.")
]
AddressOption = Annotated[
    str | None,
    typer.Option(
        "--address",
        metavar="HOST:PORT",
        help="Of the Ray cluster's head, by default RAY_ADDRESS; without both, this machine alone.",
    ),
]
AgentOption = Annotated[
    str, typer.Option("--agent", "-a", help="NAME[:OPTION=VALUE,...] or FILE.py:CLASS.")
]


class UserError(Exception):
    """A mistake that the user can mend; the message says how."""


def out() -> Console:
    """Where results go."""
    from rich.console import Console

    return Console(highlight=False)


def err() -> Console:
    """Where progress and complaints go."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def note(console: Console, text: str) -> None:
    """Say in passing what takes long and happens once."""
    console.print(text, style="dim", markup=False, soft_wrap=True)


def rows_for(results: Path | None) -> pd.DataFrame:
    """What tables and leaderboards are made from, see ``AloneOption``."""
    from crowdbench.evaluation.joined import local_rows, published_and_local

    return published_and_local(RESULTS) if results is None else local_rows(results)


def require_writable_record(record: Path, what: str) -> None:
    """Refuse what would be lost with the next installation, or lead nowhere.

    Args:
        record: the folder that the user has named.
        what: the command, as an imperative.
    """
    from crowdbench.evaluation.record import record_folder

    installed = record_folder().resolve()
    checkout = installed.parent.parent / "pyproject.toml"
    if record.resolve() == installed and not checkout.is_file():
        raise UserError(
            f"{record}: the record that is installed with crowdbench is read-only; {what} in a "
            "checkout, or in a folder of your own with --record"
        )
    if record == PUBLISHED / "record" and not record.parent.is_dir():
        raise UserError(
            f"{record}: there is no such folder; {what} in a checkout of crowdbench, or name a "
            "folder with --record"
        )
