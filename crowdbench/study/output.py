"""A study's folder: tables, verdicts, figures and README.md, all from the stored episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from crowdbench.evaluation.database import ResultsError
from crowdbench.replacing import replacing
from crowdbench.study.claims import check_claims, check_orders
from crowdbench.study.figures import save_figures
from crowdbench.study.formats import csv_text, latex, markdown
from crowdbench.study.measurements import Measurements
from crowdbench.study.model import Study
from crowdbench.study.page import write_page
from crowdbench.study.sessions import Session, load_sessions
from crowdbench.study.tables import Filled, fill_all
from crowdbench.study.verdicts import claims_csv, differences_csv, orders_csv, weights_csv

if TYPE_CHECKING:
    import pandas as pd


class Written(NamedTuple):
    """What was written.

    Attributes:
        tables: all tables, filled.
        measured: the episodes behind them.
        figures: for each figure's name whether there is one.
    """

    tables: Sequence[Filled]
    measured: Measurements
    figures: Mapping[str, bool]


def write_study(
    study: Study,
    source: Path,
    target: Path,
    rows: pd.DataFrame | None = None,
    accounts: Sequence[Path] | None = None,
) -> Written:
    """Write tables, verdicts, figures and README.md; the same episodes give the same bytes.

    Args:
        study: what to write.
        source: folder with the curves of trainings.
        target: folder to write to.
        rows: the episodes, as ``published_and_local`` gives them; by default those of ``source``.
        accounts: folders with the accounts of the runs they are from; by default ``source``.

    Raises:
        ResultsError: episodes that cannot be read or a folder that cannot be written to.
    """
    plan = study.cells()
    measured = Measurements.load(source, plan) if rows is None else Measurements(rows, plan)
    del rows  # more than the plan asks for
    tables = fill_all(study, measured)
    findings = check_claims(measured, study.claims)
    orders = check_orders(tables, measured)
    compared = any(filled.source for filled in tables)
    weighted = bool((measured.episodes["weights_sha256"] != "").any())
    files = {
        "claims.csv": claims_csv(findings) if findings else None,
        "orders.csv": orders_csv(orders) if compared else None,
        "differences.csv": differences_csv(tables) if compared else None,
        "weights.csv": weights_csv(measured.episodes) if weighted else None,
    }
    for filled in tables:
        for ending, text in (("csv", csv_text), ("md", markdown), ("tex", latex)):
            files[f"table_{filled.table.number}.{ending}"] = text(filled)
    try:
        (target / "tables").mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            path = target / "tables" / name
            if content is None:
                path.unlink(missing_ok=True)
            else:
                _write(path, content)
        figures = save_figures(study.figures, measured, source, target / "figures")
        sessions: list[Session] = []
        for folder in [source] if accounts is None else accounts:
            # An account that was published with its rows may still lie beside one's own.
            sessions += [x for x in load_sessions(folder, study.name) if x not in sessions]
        page = write_page(study, tables, findings, orders, measured, figures, sessions)
        _write(target / "README.md", page)
    except OSError as error:
        reason = error.strerror or str(error)
        raise ResultsError(f"{target}: the study cannot be written ({reason})") from error
    return Written(tables, measured, figures)


def _write(path: Path, text: str) -> None:
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")
