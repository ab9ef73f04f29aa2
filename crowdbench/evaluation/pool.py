"""Worker processes that may hang or die without taking the run with them.

Each worker is started as a fresh interpreter (no fork of a process with threads, no import of the
caller's script), in a session of its own, so that Ctrl-C reaches the parent alone.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import wait
from types import TracebackType

from crowdbench.evaluation.pulse import MAKING, WARM_UP, Pulse, call_name
from crowdbench.evaluation.worker import Answer, Message

_ONE_THREAD = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
        "NUMBA_NUM_THREADS",
    ),
    "1",
)
_START = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); " + (
    "from crowdbench.evaluation.worker import main; main()"
)
_PATIENCE = 0.1
"""How often limits are looked at [s]."""


@dataclass(frozen=True)
class Limits:
    """How long an agent's code may take [s].

    Attributes:
        step: ``reset`` and each ``act``.
        first: both together the first time in a process, when things are compiled and loaded;
            at least ``step``, and ``step`` once the agent has shown that it hangs.
        making: the agent's ``__init__`` and the import of its module.
    """

    step: float = 10.0
    first: float = 60.0
    making: float = 180.0


@dataclass(frozen=True)
class Lost:
    """What became of a message whose process hung or died."""

    reason: str


class Pool:
    """Hands messages to worker processes and yields their answers."""

    def __init__(self, jobs: int, limits: Limits) -> None:
        """Start nothing yet.

        Args:
            jobs: processes at most; with more than one, each computes in a single thread.
            limits: for agent code.
        """
        self._jobs = jobs
        self._limits = limits
        self._impatient: set[str] = set()
        self._processes: list[_Process] = []

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        place: TracebackType | None,
    ) -> None:
        for process in self._processes:
            process.kill()
        self._processes.clear()

    def prepare(self, count: int) -> None:
        """Start processes ahead of their work, as many as can be of use."""
        while len(self._processes) < min(count, self._jobs):
            self._processes.append(_Process(_ONE_THREAD if self._jobs > 1 else {}))

    def run(self, queue: deque[Message]) -> Iterator[tuple[Message, Answer | Lost]]:
        """Yield every message with its answer as they come; the queue may grow meanwhile."""
        while queue or any(process.message for process in self._processes):
            self._processes = [p for p in self._processes if p.message or p.alive]
            self.prepare(sum(p.message is not None for p in self._processes) + len(queue))
            for process in self._processes:
                if queue and process.message is None:
                    process.send(queue.popleft())
            busy = [process for process in self._processes if process.message]
            ready = wait([process.connection for process in busy], timeout=_PATIENCE)
            for process in busy:
                message = process.message
                answer = self._listen(process, heard=process.connection in ready)
                if message is not None and answer is not None:
                    yield message, answer

    def _listen(self, process: _Process, heard: bool) -> Answer | Lost | None:
        """The answer if there is one, or what happened to the process that owed it."""
        if not heard and process.alive:
            phase, running = process.pulse.read()
            limit = self._limit(phase, process.agent)
            if running is None or running <= limit:
                return None
            if phase == WARM_UP:
                self._impatient.add(process.agent)
            self._processes.remove(process)
            place = process.stop()
            return Lost(f"{call_name(phase)} did not return within the limit of {limit:g} s{place}")
        with contextlib.suppress(EOFError, OSError):
            return process.receive()
        self._processes.remove(process)
        phase, running = process.pulse.read()
        where = "" if running is None else f" in {call_name(phase)}"
        return Lost(f"its process ended with {process.bury()}{where}")

    def _limit(self, phase: int, agent: str) -> float:
        if phase == MAKING:
            return self._limits.making
        if phase == WARM_UP and agent not in self._impatient:
            return max(self._limits.step, self._limits.first)
        return self._limits.step


class _Process:
    """One worker process and what it shares with its parent."""

    def __init__(self, environment: dict[str, str]) -> None:
        self.message: Message | None = None
        self.connection, theirs = Pipe()
        self._crash = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        with tempfile.TemporaryFile() as shared:
            self.pulse = Pulse(shared.fileno())
            descriptors = (theirs.fileno(), shared.fileno(), self._crash.fileno())
            arguments = [json.dumps(sys.path), *map(str, descriptors), str(os.getpid())]
            self._popen = subprocess.Popen(
                [sys.executable, "-c", _START, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=2,  # what agents print must not mix with what the program prints
                pass_fds=descriptors,
                env={**os.environ, **environment},
                start_new_session=True,
            )
        theirs.close()

    @property
    def alive(self) -> bool:
        return self._popen.poll() is None

    @property
    def agent(self) -> str:
        """The agent whose code may be running."""
        return str(self.message.agent) if self.message else ""

    def send(self, message: Message) -> None:
        self.message = message
        with contextlib.suppress(BrokenPipeError):  # a dead process is noticed when it is due
            self.connection.send(message)

    def receive(self) -> Answer:
        """Take the answer that has arrived; EOFError when the process is gone instead."""
        if not self.connection.poll():
            raise EOFError
        answer: Answer = self.connection.recv()
        self.message = None
        return answer

    def stop(self) -> str:
        """End a process that hangs; returns the place where it was, as far as that is known."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._popen.send_signal(signal.SIGABRT)  # makes it note its stack
            self._popen.wait(timeout=2)
        self.kill()
        return self._place()

    def bury(self) -> str:
        """Say how a process ended, and where as far as that is known."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._popen.wait(timeout=2)
        code = self._popen.poll()
        self.kill()
        if code is None:
            return "its connection closed"
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return name + self._place()

    def kill(self) -> None:
        """End the process and whatever it has started."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._popen.pid, signal.SIGKILL)
        self._popen.wait()
        self.connection.close()

    def _place(self) -> str:
        self._crash.seek(0)
        frame = re.search(rb'File "(.*)", line (\d+)', self._crash.read(1 << 16))
        return f" ({frame[1].decode(errors='replace')}:{int(frame[2])})" if frame else ""
