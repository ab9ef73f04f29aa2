"""The report page: a folder that a browser opens from the disk, without a server or a network."""

from __future__ import annotations

import contextlib
import shutil
import urllib.parse
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from crowdbench.evaluation.recordings import Recording, find_recordings, scenario_of
from crowdbench.evaluation.results import ResultsError
from crowdbench.evaluation.stored import defined_scenario
from crowdbench.site.cards import agent_card, html_from_markdown
from crowdbench.site.leaderboard import (
    cell_documents,
    metric_documents,
    scenario_document,
)
from crowdbench.site.replay import script_json, write_replays

REPLAYS = 5
"""Episodes of each agent in each scenario that the page shows; ``crowdbench replay`` shows any."""
MARK = "crowdbench-report"
"""A file that says that a folder is one of these pages, and may be written over."""

if TYPE_CHECKING:
    import pandas as pd


class Site(NamedTuple):
    """What was written.

    Attributes:
        page: the file to open.
        cells: agents in scenarios.
        episodes: stored rows behind them.
        replays: episodes that can be watched.
    """

    page: Path
    cells: int
    episodes: int
    replays: int


class SiteTable(NamedTuple):
    """A table to show.

    Attributes:
        title: its heading.
        text: the table in Markdown.
    """

    title: str
    text: str


class SiteFigure(NamedTuple):
    """A figure to show.

    Attributes:
        title: its heading.
        caption: what it shows.
        png, pdf: its files, which are copied.
    """

    title: str
    caption: str
    png: Path
    pdf: Path


def write_report_page(
    rows: pd.DataFrame,
    output: Path,
    tables: Sequence[SiteTable] = (),
    figures: Sequence[SiteFigure] = (),
    planned: Mapping[tuple[str, str], int] | None = None,
) -> Site:
    """Write the whole page: leaderboards, tables, figures, agents and replays.

    Args:
        rows: the episodes, as ``published_and_local`` gives them.
        output: folder of the page; an older page there is replaced.
        tables, figures: to show beside the leaderboards.
        planned: as ``cell_documents`` takes it.

    Raises:
        ResultsError: something cannot be read, or the output is in the way.
    """
    recordings = {found.cell.identity: found for found in find_recordings(rows, REPLAYS)}
    groups = rows.groupby(["scenario", "agent"], sort=False).indices
    with _writing(output) as part:
        cells, scenarios = [], {}
        for cell, document in cell_documents(rows, planned):
            scenario = scenario_of(cell, rows.iloc[groups[cell.scenario, cell.agent]])
            # Rows of a scenario that is defined otherwise by now are not set beside new ones.
            now = defined_scenario(cell.scenario, cell.scenario_digest, definition="")
            old = now is None and "@" not in cell.scenario
            label = f"{cell.scenario}@{cell.scenario_digest}" if old else cell.scenario
            scenarios[label] = scenario_document(label, scenario)
            recording = recordings.get(cell.identity)
            files, replays = ([], []) if recording is None else write_replays(recording, part)
            cells.append({**document, "scenario": label, "files": files, "replays": replays})
        _write_index(
            part,
            {
                "start": "",
                "metrics": metric_documents(),
                "scenarios": list(scenarios.values()),
                "agents": _agents(cell["agent"] for cell in cells),
                "cells": cells,
                "tables": [
                    {"title": table.title, "html": html_from_markdown(table.text)}
                    for table in tables
                ],
                "figures": _figures(figures, part),
            },
        )
    return Site(
        output / "index.html",
        len(cells),
        sum(cell["episodes"] for cell in cells),
        sum(replay["file"] is not None for cell in cells for replay in cell["replays"]),
    )


def write_replay_page(recordings: Iterable[Recording], output: Path) -> Site:
    """Write a page that holds replays alone and begins with the first of them.

    Args:
        recordings: what to show.
        output: folder of the page; an older page there is replaced.

    Raises:
        ResultsError: something cannot be read, or the output is in the way.
    """
    recordings = list(recordings)
    with _writing(output) as part:
        cells, scenarios = [], {}
        for recording in recordings:
            cell = recording.cell
            scenarios[cell.scenario] = scenario_document(cell.scenario, recording.scenario)
            files, replays = write_replays(recording, part)
            cells.append(
                {
                    "scenario": cell.scenario,
                    "agent": cell.agent,
                    "files": files,
                    "replays": replays,
                }
            )
        first = recordings[0]
        _write_index(
            part,
            {
                "start": replay_link(first.cell.scenario, first.cell.agent, first.seeds[0]),
                "metrics": [],
                "scenarios": list(scenarios.values()),
                "agents": [],
                "cells": cells,
                "tables": [],
                "figures": [],
            },
        )
    shown = sum(len(cell["replays"]) for cell in cells)
    return Site(output / "index.html", len(cells), shown, shown)


def replay_link(scenario: str, agent: str, seed: int, robot: str = "robot_0") -> str:
    """The part of an address, from ``#`` on, that opens an episode."""
    place = {"scenario": scenario, "seed": seed, "agent": agent, "robot": robot}
    return "#/replay?" + urllib.parse.urlencode(place)


@contextlib.contextmanager
def _writing(output: Path) -> Iterator[Path]:
    """A folder within ``output`` to write a page to, which takes an older one's place at the end.

    After an error what was there before is there still.

    Raises:
        ResultsError: other files are in the way, or it cannot be written.
    """
    part = output / ".part"
    try:
        new = not (output / MARK).exists()
        if new and output.is_dir() and any(output.iterdir()):
            raise ResultsError(
                f"{output}: holds other files than a report page; choose another --output"
            )
        output.mkdir(parents=True, exist_ok=True)
        try:
            (output / MARK).write_text("Made by crowdbench; written over by the next page.\n")
            shutil.rmtree(part, ignore_errors=True)
            (part / "data").mkdir(parents=True)
            for source in (resources.files("crowdbench.site") / "static").iterdir():
                (part / source.name).write_bytes(source.read_bytes())
            yield part
            for folder in ("data", "figures"):
                shutil.rmtree(output / folder, ignore_errors=True)
            for path in list(part.iterdir()):
                path.replace(output / path.name)
            part.rmdir()
        except BaseException:
            shutil.rmtree(part, ignore_errors=True)
            if new:
                (output / MARK).unlink(missing_ok=True)
            raise
    except OSError as error:
        reason = error.strerror or str(error)
        raise ResultsError(f"{output}: the page cannot be written ({reason})") from error


def _write_index(output: Path, index: Mapping[str, Any]) -> None:
    document = {"version": version("crowdbench-nav"), **index}
    text = f"crowdbench.index = {script_json(document)};\n"
    (output / "data" / "index.js").write_text(text, encoding="ascii")


def _agents(names: Iterable[str]) -> list[dict[str, str]]:
    return [{"name": name, **agent_card(name)} for name in sorted(set(names))]


def _figures(figures: Sequence[SiteFigure], output: Path) -> list[dict[str, str]]:
    """Copy the files; addresses are relative to the page."""
    documents = []
    for figure in figures:
        (output / "figures").mkdir(exist_ok=True)
        for path in (figure.png, figure.pdf):
            shutil.copyfile(path, output / "figures" / path.name)
        documents.append(
            {
                "title": figure.title,
                "caption": figure.caption,
                "png": f"figures/{figure.png.name}",
                "pdf": f"figures/{figure.pdf.name}",
            }
        )
    return documents
