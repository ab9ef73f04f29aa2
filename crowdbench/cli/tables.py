"""``crowdbench tables``: a study's tables, verdicts and figures from the stored episodes."""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.common import (
    DEFAULT_STUDY,
    PUBLISHED,
    RESULTS,
    AddressOption,
    AloneOption,
    ExecutorOption,
    UserError,
    err,
    note,
    out,
    rows_for,
)
from crowdbench.messages import short

if TYPE_CHECKING:
    from crowdbench.study import Study
    from crowdbench.study.execution import Forecast

_BETWEEN_LINES = 60.0
"""Seconds between two lines of progress where there is no terminal."""


def tables(
    study: Annotated[
        str, typer.Argument(metavar="STUDY", help="Name of a study, or FILE.py with one.")
    ] = DEFAULT_STUDY,
    run: Annotated[
        bool, typer.Option("--run", help="Run the episodes that are missing first.")
    ] = False,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, help="Processes, by default one per core.")
    ] = None,
    executor: ExecutorOption = "local",
    address: AddressOption = None,
    results: AloneOption = None,
) -> None:
    """Write a study's tables, verdicts, figures and page from the stored episodes.

    They are made from published rows and one's own. The default study goes to results/ (or the
    folder of --results), others that come with crowdbench to studies/NAME in there, and one's own
    to studies/NAME in the folder of one's own results.
    """
    from crowdbench.evaluation.results import require_episodes
    from crowdbench.study import StudyError
    from crowdbench.study.formats import terminal
    from crowdbench.study.library import is_shipped, load_study
    from crowdbench.study.output import write_study

    try:
        wanted = load_study(study)
    except StudyError as error:
        raise UserError(str(error)) from error
    if not run:
        _refuse_options_of_runs(jobs, executor, address)
        if results is not None:
            require_episodes(results)
    folder, home = results or RESULTS, results or PUBLISHED
    place = home if is_shipped(study) else folder
    target = place if study == DEFAULT_STUDY else place / "studies" / wanted.name
    complete = not run or _run(wanted, folder, jobs, results is not None, executor, address)
    begun = time.perf_counter()
    written = write_study(wanted, home, target, rows_for(results), accounts=[home, folder])
    console = out()
    for filled in written.tables:
        console.print(terminal(filled))
        console.print()
    planned = sum(cell.episodes for cell in written.measured.plan)
    console.print(
        f"{len(written.measured.episodes):,} of {planned:,} planned episodes; tables, figures and "
        f"README.md are in {target} ({time.perf_counter() - begun:.1f} s)",
        markup=False,
        soft_wrap=True,
    )
    if not complete:
        raise typer.Exit(1)


def _refuse_options_of_runs(jobs: int | None, executor: str, address: str | None) -> None:
    elsewhere = executor if executor != "local" else None
    for name, value in (("jobs", jobs), ("executor", elsewhere), ("address", address)):
        if value is not None:
            raise UserError(f"--{name} {short(value)}: nothing is run; allowed: with --run")


def _run(
    study: Study,
    folder: Path,
    jobs: int | None,
    alone: bool,
    executor: str,
    address: str | None,
) -> bool:
    """Run what is missing, published or not if alone.

    Returns:
        False if some agent could not be made, or episodes not run.
    """
    from crowdbench.evaluation.database import require_writable
    from crowdbench.evaluation.record import load_record
    from crowdbench.evaluation.runner import IncompleteError
    from crowdbench.study.execution import look, run_missing
    from crowdbench.study.page import duration

    require_writable(folder)
    console = err()
    plan = study.cells()
    outlook = look(plan)
    reasons: dict[str, list[str]] = {}
    for agent, text in outlook.broken.items():
        reasons.setdefault(text.partition(": ")[2], []).append(agent)
    for reason, agents in reasons.items():
        told = f"not run: {'; '.join(agents)}: {reason}"
        console.print(told, style="yellow", markup=False, soft_wrap=True)
    # What executors' libraries have to say does not belong between the tables.
    with _Display() as display, contextlib.redirect_stdout(sys.stderr):
        try:
            published = None if alone else load_record()
            forecast = run_missing(
                folder,
                study,
                outlook,
                jobs,
                display.update,
                published,
                executor=executor,
                address=address,
                on_note=display.note,
            )
        except KeyboardInterrupt:
            display.close()
            console.print(
                "Interrupted; finished episodes are stored. Run the same command again to go on.",
                style="yellow",
            )
            raise typer.Exit(130) from None
        except IncompleteError as error:
            display.close()
            told = f"{error}. Run the same command again to try them again."
            console.print(" ".join(told.split()), style="red", markup=False, soft_wrap=True)
            return False
    whole = forecast.seconds_for(cell for cell in plan if cell.agent in outlook.weights)
    console.print(f"A full run with {forecast.jobs} processes takes about {duration(whole)}.")
    return not outlook.broken


class _Display:
    """A bar with the time left; without a terminal, a line every minute."""

    def __init__(self) -> None:
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
        )

        self._console = err()
        self._bar = Progress(
            TextColumn("running"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._line = self._bar.add_task("", total=None, left="")
        self._told = time.monotonic()

    def __enter__(self) -> _Display:
        self._bar.start()
        return self

    def __exit__(self, *details: object) -> None:
        self.close()

    def close(self) -> None:
        self._bar.stop()

    def note(self, text: str) -> None:
        """Say something above the bar."""
        note(self._console, text)

    def update(self, done: int, total: int, forecast: Forecast) -> None:
        """Show how far the run has come."""
        from crowdbench.study.page import duration

        left = f"about {duration(forecast.seconds_left())} left"
        if forecast.unknown:
            left += f", and {len(forecast.unknown)} agents not timed yet"
        self._bar.update(self._line, completed=done, total=total, left=left)
        if not self._console.is_terminal and time.monotonic() - self._told > _BETWEEN_LINES:
            self._console.print(f"{done:,} of {total:,} episodes, {left}")
            self._told = time.monotonic()
