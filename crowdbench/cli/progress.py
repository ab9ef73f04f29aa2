"""How far ``crowdbench run`` has come, on the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from crowdbench.cli.common import err, note
from crowdbench.evaluation.results import one_line
from crowdbench.evaluation.runner import Missing, Progress

_SHOWN = 10
"""Episodes of one kind that are named."""


class ProgressBar:
    """A bar with the outcomes so far; on anything but a terminal it says nothing."""

    def __init__(self, total: int, quiet: bool) -> None:
        self._console, self._quiet = err(), quiet
        self._bar = Bar(
            TextColumn("{task.description}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[outcomes]}"),
            console=self._console,
            disable=quiet or not self._console.is_terminal,
        )
        self._line = self._bar.add_task("loading", total=total, outcomes="")
        self._outcomes: Counter[str] = Counter()
        self._latest = Progress(total, stored=0, done=0, jobs=0)

    def __enter__(self) -> ProgressBar:
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        place: TracebackType | None,
    ) -> None:
        self._bar.stop()

    def update(self, progress: Progress) -> None:
        """Show what has been reached."""
        self._latest = progress
        self._outcomes.update(row["outcome"] for row in progress.rows)
        told = "  ".join(f"{count} {name}" for name, count in self._outcomes.most_common())
        finished = progress.stored + progress.done
        self._bar.update(self._line, completed=finished, description="running", outcomes=told)

    def note(self, text: str) -> None:
        """Say something above the bar."""
        if not self._quiet:
            note(self._console, text)

    def say_interrupted(self, folder: Path) -> None:
        """Say what is kept and how to go on."""
        self._bar.stop()
        kept = self._latest.stored + self._latest.done
        self._console.print(
            f"Interrupted: {kept} of {self._latest.total} episodes are stored in {folder}. "
            "Run the same command again to go on from there.",
            style="yellow",
            markup=False,
            soft_wrap=True,
        )

    def say_missing(self, episodes: Sequence[Missing]) -> None:
        """Say which episodes have no row, and why."""
        for episode in episodes[:_SHOWN]:
            told = f"not stored: {one_line(str(episode))}"
            self._console.print(told, style="red", markup=False, soft_wrap=True)
        rest = len(episodes) - _SHOWN
        more = f", {rest} of them not shown" if rest > 0 else ""
        self._console.print(
            f"{len(episodes)} episodes are missing{more}. Run the same command again to try them "
            "again.",
            style="red",
            markup=False,
            soft_wrap=True,
        )

    def say_stored(self, folder: Path) -> None:
        """Say which episodes were not run because they were there, if any."""
        if self._latest.stored:
            self._console.print(
                f"{self._latest.stored} of {self._latest.total} episodes were in {folder} before "
                "and were not run again; with another --results they are.",
                markup=False,
                soft_wrap=True,
            )
