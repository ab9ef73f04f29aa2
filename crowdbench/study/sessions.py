"""When the stored episodes were run, for how long and on what: one small file per run."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from crowdbench.evaluation.database import ResultsError
from crowdbench.replacing import replacing

LIBRARIES = ("numpy", "scipy", "numba", "pymunk", "torch", "daqp")
"""Whose versions may change what an episode gives."""
_BETWEEN_WRITES = 30.0
"""[s]; a killed run loses at most this much of its account."""


@dataclass(frozen=True)
class Session:
    """One run of missing episodes.

    Attributes:
        study: name of the study that they were missing from.
        started: UTC, ISO 8601.
        seconds: wall time so far.
        episodes: run so far.
        jobs: processes, at most at the same time.
        machine: processor and cores; of several machines each.
        versions: of Python, crowdbench and the libraries it computes with.
    """

    study: str
    started: str
    seconds: float
    episodes: int
    jobs: int
    machine: str
    versions: dict[str, str] = field(default_factory=dict)


class Account:
    """Keeps the file of the session that is going on."""

    def __init__(
        self, folder: Path, study: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        now = datetime.now(UTC)
        self._path = folder / "sessions" / f"{now:%Y-%m-%dT%H-%M-%S.%f}.json"
        self._clock, self._begun, self._written = clock, clock(), clock()
        self._started = now.isoformat(timespec="seconds")
        self._study, self._versions = study, _versions()
        self._episodes, self._jobs = 0, 0
        self._machines: dict[str, None] = {}

    @property
    def seconds(self) -> float:
        """Wall time so far."""
        return self._clock() - self._begun

    def count(self, machine: str, jobs: int) -> None:
        """Another episode is done, on the machine that its row names, one of ``jobs`` at a time."""
        self._episodes += 1
        self._jobs = max(self._jobs, jobs)
        self._machines[machine] = None
        if self._clock() - self._written > _BETWEEN_WRITES:
            self.write()

    def write(self) -> None:
        """Replace the file; a session without an episode leaves none.

        Raises:
            ResultsError: it cannot be written.
        """
        if not self._episodes:
            return
        session = Session(
            self._study,
            self._started,
            round(self.seconds, 1),
            self._episodes,
            self._jobs,
            "; ".join(self._machines),
            self._versions,
        )
        try:
            self._path.parent.mkdir(exist_ok=True)  # in the results folder, unless that is gone
            with replacing(self._path) as part:
                part.write_text(json.dumps(asdict(session), indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise ResultsError(f"{self._path}: cannot be written ({error.strerror})") from error
        self._written = self._clock()


def load_sessions(folder: Path, study: str) -> list[Session]:
    """All sessions of a study in a results folder, oldest first.

    Raises:
        ResultsError: a file that is none; the message names it.
    """
    found = []
    for path in sorted((folder / "sessions").glob("[!.]*.json")):  # and none half written
        try:
            found.append(Session(**json.loads(path.read_text(encoding="utf-8"))))
        except (ValueError, TypeError) as error:
            raise ResultsError(f"{path}: not the account of a run ({error})") from error
    return [session for session in found if session.study == study]


def _versions() -> dict[str, str]:
    ours = {"python": platform.python_version(), "crowdbench-nav": version("crowdbench-nav")}
    return ours | {name: version(name) for name in LIBRARIES}
