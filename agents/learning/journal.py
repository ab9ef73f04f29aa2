"""What a training run tells while it goes on: progress bar, TensorBoard, learning curve."""

from __future__ import annotations

import csv
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType, TracebackType

from crowdbench_agents.learning.errors import to_disk
from crowdbench_agents.learning.validation import Validation
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn


@contextmanager
def stop_on_signals() -> Iterator[Callable[[], bool]]:
    """Notice SIGTERM and SIGINT, also in a job started in the background.

    An exception instead could be lost in a callback of a C library, or tear a step of the replay
    apart; who cannot wait raises it with a second signal.

    Yields:
        Whether to stop.
    """
    asked = False

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    before = {n: signal.signal(n, handle) for n in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def describe_spent(seconds: Mapping[str, float], total: float) -> str:
    """Where the time goes, in a line: shares of it, the largest first.

    Args:
        seconds: by what they were spent on.
        total: wall time in which they were [s].
    """
    largest = sorted(seconds.items(), key=lambda item: -item[1])
    shares = ", ".join(f"{name} {value / total:.0%}" for name, value in largest)
    return f"time: {shares or 'not measured'}"


class Journal:
    """Writes the progress of one run.

    Args:
        name: of the run.
        folder: for TensorBoard's files.
        curve: the CSV file of the learning curve, appended to.
        total: minutes or steps the run shall take, for the bar.
    """

    def __init__(self, name: str, folder: Path, curve: Path, total: float) -> None:
        from torch.utils.tensorboard import SummaryWriter

        curve.parent.mkdir(parents=True, exist_ok=True)
        self._curve = curve
        self._board = SummaryWriter(str(folder))
        self._progress = Progress(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:.0f}%"),
            TimeElapsedColumn(), TextColumn("{task.fields[note]}"), refresh_per_second=1,
        )  # fmt: skip
        self._recording = False
        self._task = self._progress.add_task(name, total=total, note="")

    def __enter__(self) -> Journal:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()
        self._board.close()

    def advance(self, done: float, note: str) -> None:
        """Move the bar to ``done`` of the total."""
        self._progress.update(self._task, completed=done, note=note)

    def say(self, text: str) -> None:
        """Print a line above the bar."""
        self._progress.console.print(text, highlight=False)

    def recorded(self, there: int, wanted: int) -> None:
        """Tell how many expert demonstrations there are; the first time also in a line."""
        if not self._recording:
            self.say(f"recording {wanted} expert demonstrations, once for all runs")
            self._recording = True
        self.advance(0, f"{there}/{wanted} expert demonstrations")

    def scalars(self, values: Mapping[str, float], step: int) -> None:
        """Log numbers to TensorBoard at an environment step."""
        for name, value in values.items():
            self._board.add_scalar(name, value, step)

    def validated(
        self, result: Validation, counts: Mapping[str, float], training: Mapping[str, float]
    ) -> dict[str, float]:
        """Tell a validation in every way there is.

        Args:
            result: of the policy alone.
            counts: ``steps``, ``decisions``, ``updates`` and ``seconds`` so far.
            training: running success while training, by scenario.

        Returns:
            The point of the learning curve.
        """
        row = {
            **counts, "success": result.mean, "spl": result.mean_spl,
            "smoothness": result.smoothness, "time_to_goal": result.seconds, **result.success,
        }  # fmt: skip
        row |= {f"training_{name}": value for name, value in training.items()}
        row = {name: round(value, 4) for name, value in row.items()}
        self._point(row)
        scalars = {f"validation/{name}": value for name, value in result.success.items()}
        scalars |= {"validation_mean": result.mean, "validation_smoothness": result.smoothness}
        self.scalars(scalars, int(counts["steps"]))
        each = " ".join(f"{value:.2f}" for value in result.success.values())
        self.say(
            f"{row['seconds'] / 60:.1f} min, {row['steps']} steps, {row['updates']} updates: "
            f"policy success {result.mean:.3f} ({each}), SPL {result.mean_spl:.3f}, "
            f"smoothness {result.smoothness:.3f}"
        )
        return row

    def _point(self, row: Mapping[str, float]) -> None:
        """Append a point of the learning curve; its columns are those of the first point.

        Raises:
            TrainingError: no room on the disk.
        """
        with to_disk(self._curve, "resume from the last checkpoint"):
            self._append(row)

    def _append(self, row: Mapping[str, float]) -> None:
        with self._curve.open("a+", newline="", encoding="utf-8") as file:
            file.seek(0)
            columns = next(csv.reader(file), None)
            writer = csv.DictWriter(
                file, columns or list(row), extrasaction="ignore", lineterminator="\n"
            )
            if columns is None:
                writer.writeheader()
            writer.writerow(row)
