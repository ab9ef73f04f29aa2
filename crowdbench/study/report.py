"""Everything under results/ that follows from the stored episodes, written in one go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from crowdbench.evaluation.database import ResultsError
from crowdbench.study.figures import save_figures
from crowdbench.study.formats import csv_text, latex, markdown
from crowdbench.study.measurements import Measurements
from crowdbench.study.plan import TABLES
from crowdbench.study.readme import write_readme
from crowdbench.study.sessions import load_sessions
from crowdbench.study.tables import Filled, fill


class Report(NamedTuple):
    """What was written.

    Attributes:
        tables: all tables, filled.
        measured: the episodes behind them.
        figures: for each figure's name whether there is one.
    """

    tables: Sequence[Filled]
    measured: Measurements
    figures: Mapping[str, bool]


def write_report(source: Path, target: Path | None = None) -> Report:
    """Write tables, figures and README.md; the same episodes give the same bytes.

    Args:
        source: results folder with the episodes.
        target: folder to write to, by default the same.

    Raises:
        ResultsError: episodes that cannot be read or a folder that cannot be written to.
    """
    target = target or source
    measured = Measurements.load(source)
    tables = [fill(table, measured) for table in TABLES]
    try:
        (target / "tables").mkdir(parents=True, exist_ok=True)
        for filled in tables:
            path = target / "tables" / f"table_{filled.table.number}"
            for ending, text in (("csv", csv_text), ("md", markdown), ("tex", latex)):
                path.with_suffix(f".{ending}").write_text(text(filled), encoding="utf-8")
        figures = save_figures(measured, source, target / "figures")
        page = write_readme(tables, measured, figures, load_sessions(source))
        (target / "README.md").write_text(page, encoding="utf-8")
    except OSError as error:
        reason = error.strerror or str(error)
        raise ResultsError(f"{target}: the report cannot be written ({reason})") from error
    return Report(tables, measured, figures)
