"""``crowdbench report``: a page with leaderboards, tables, figures and replays."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.common import (
    DEFAULT_STUDY,
    PUBLISHED,
    RESULTS,
    AloneOption,
    out,
    rows_for,
)

if TYPE_CHECKING:
    import pandas as pd

    from crowdbench.site.website import SiteFigure, SiteTable


def report(
    results: AloneOption = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help=f"Folder of the page, by default {RESULTS}/report."),
    ] = None,
) -> None:
    """Write a page with leaderboards, tables, figures and replays; it needs no server."""
    from crowdbench.evaluation.results import require_episodes
    from crowdbench.site.website import write_report_page

    if results is not None:
        require_episodes(results)
    rows = rows_for(results)
    if rows.empty:
        require_episodes(RESULTS)  # nothing is published either
    with tempfile.TemporaryDirectory(prefix="crowdbench-figures-") as folder:
        tables, figures = _of_study(rows, results or PUBLISHED, Path(folder))
        # In a folder of one's own are as many episodes as one has wished for.
        planned = _planned() if results is None else {}
        place = output or (results or RESULTS) / "report"
        site = write_report_page(rows, place, tables, figures, planned)
    out().print(
        f"{site.page}: {site.cells} leaderboard lines from {site.episodes:,} episodes, "
        f"{site.replays:,} replays",
        markup=False,
        soft_wrap=True,
    )


def _planned() -> dict[tuple[str, str], int]:
    """The default study's episodes, by scenario and agent."""
    from crowdbench.study.library import load_study

    return {
        (cell.scenario, cell.agent): cell.episodes for cell in load_study(DEFAULT_STUDY).cells()
    }


def _of_study(
    rows: pd.DataFrame, home: Path, folder: Path
) -> tuple[list[SiteTable], list[SiteFigure]]:
    """The default study's tables of which something has been run, and its figures in a folder."""
    from crowdbench.site.website import SiteFigure, SiteTable
    from crowdbench.study.figures import save_figures
    from crowdbench.study.formats import markdown
    from crowdbench.study.library import load_study
    from crowdbench.study.measurements import Measurements
    from crowdbench.study.tables import fill_all

    study = load_study(DEFAULT_STUDY)
    measured = Measurements(rows, study.cells())
    if measured.episodes.empty:
        return [], []
    tables = [
        SiteTable(f"Table {filled.table.number}: {filled.table.title}", markdown(filled))
        for filled in fill_all(study, measured)
        if filled.states() != {"missing"}
    ]
    there = save_figures(study.figures, measured, home, folder)
    figures = [
        SiteFigure(d.title, d.caption, folder / f"{d.name}.png", folder / f"{d.name}.pdf")
        for d in study.figures
        if there[d.name]
    ]
    return tables, figures
