"""``crowdbench report``: a page with leaderboards, tables, figures and replays."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from crowdbench.cli.common import RESULTS, ResultsOption, out


def report(
    results: ResultsOption = RESULTS,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the page, by default RESULTS/report."),
    ] = None,
) -> None:
    """Write a page with leaderboards, tables, figures and replays; it needs no server."""
    from crowdbench.site.website import write_report_page

    site = write_report_page(results, output or results / "report")
    out().print(
        f"{site.page}: {site.cells} leaderboard lines from {site.episodes:,} episodes, "
        f"{site.replays:,} replays",
        markup=False,
        soft_wrap=True,
    )
