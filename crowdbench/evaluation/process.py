"""One worker process: its start, the messages to it, and how it ends with all it has started.

It is a fresh interpreter (no fork of a process with threads, no import of the caller's script) in
a session of its own, so that Ctrl-C reaches the parent alone. On Linux it has a keeper, which is
the process known here (see ``keeper``). Agents compute in a single thread:
what an agent decides must not depend on the number of threads, which numerical libraries split
their sums by.
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
import uuid
from multiprocessing import Pipe
from pathlib import Path
from typing import NamedTuple

import psutil

from crowdbench.evaluation.answers import AnswerReader, UnreadableAnswerError
from crowdbench.evaluation.heartbeat import Heartbeat
from crowdbench.evaluation.keeper import KEPT, PATIENCE
from crowdbench.evaluation.protocol import Answer, Broken, Described, Done, Message, Refused

ONE_THREAD = dict.fromkeys(
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
_MARK = "CROWDBENCH_WORKER"
"""Environment variable by which the children of a worker are known, whatever their session."""
_FROM_OUTSIDE = (signal.SIGKILL, signal.SIGTERM)
"""Signals that end a process at somebody's wish, unless it has sent them itself."""
_LAST_WORDS = PATIENCE + 1
"""How long a process may take to end once it should [s]."""
_ROUNDS = 10
"""How often what a worker has started is looked for: what is being killed may start another."""


class Ending(NamedTuple):
    """How a process ended.

    Attributes:
        reason: exit reason, and where the process was as far as that is known.
        outside: it was killed from outside.
    """

    reason: str
    outside: bool


class WorkerProcess:
    """One worker process, which runs the code of one agent only."""

    def __init__(self) -> None:
        self.agent = ""
        """The agent whose process it is, empty until its first message."""
        self.message: Message | None = None
        self._number = 0
        self._place = ""
        self._mark = uuid.uuid4().hex
        self.connection, theirs = Pipe()
        self._crash = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        with tempfile.TemporaryFile() as shared:
            self.heartbeat = Heartbeat(shared.fileno())
            descriptors = (theirs.fileno(), shared.fileno(), self._crash.fileno())
            arguments = [json.dumps(sys.path), *map(str, descriptors), str(os.getpid())]
            self._popen = subprocess.Popen(
                [sys.executable, "-c", _START, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=2,  # what agents print must not mix with what the program prints
                pass_fds=descriptors,
                env={**os.environ, **ONE_THREAD, _MARK: self._mark},
                start_new_session=True,
            )
        theirs.close()
        self._answers = AnswerReader(self.connection)

    @property
    def alive(self) -> bool:
        """Whether it is still running."""
        return self._popen.poll() is None

    def send(self, message: Message) -> None:
        """Hand over a message; whatever is answered to earlier ones is refused from now on."""
        self.agent, self.message = str(message.agent), message
        self._number += 1
        with contextlib.suppress(OSError):  # a dead process is noticed when it is due
            self.connection.send((self._number, message))

    def receive(self) -> Answer | None:
        """The answer to the message, if it has arrived.

        Raises:
            EOFError: the process is gone.
            UnreadableAnswerError: something else has arrived.
        """
        alive = self.alive
        for message in self._answers.read():
            match message:
                case (int(number), Described() | Done() | Refused() | Broken() as answer):
                    if number == self._number:
                        self.message = None
                        return answer
                case _:
                    raise UnreadableAnswerError
        if self._answers.ended or not alive:
            raise EOFError
        return None

    def processor_time(self) -> float:
        """Processor time of the process and its children so far [s]."""
        total = 0.0
        with contextlib.suppress(psutil.Error):
            process = psutil.Process(self._popen.pid)
            for one in (process, *process.children(recursive=True)):
                with contextlib.suppress(psutil.Error):
                    times = one.cpu_times()
                    total += times.user + times.system
        return total

    def stop(self) -> str:
        """End a process that hangs; returns the place where it was, as far as that is known."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._popen.send_signal(signal.SIGABRT)  # makes it note its stack
            self._popen.wait(timeout=_LAST_WORDS)
        self.kill()
        return self._place

    def exit_reason(self) -> Ending:
        """Say how the process ended; what it has started ends too."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._popen.wait(timeout=_LAST_WORDS)
        code = self._popen.poll()
        self.kill()
        if code is None:
            return Ending("its connection closed", outside=False)
        if code >= 0:
            return Ending(f"exit code {code}{self._place}", outside=False)
        outside = -code in _FROM_OUTSIDE and self.heartbeat.signal != -code
        return Ending(_signal_name(-code) + self._place, outside)

    def kill(self) -> None:
        """End the process and whatever it has started, in whatever session."""
        started = _descendants(self._popen.pid) if self.alive else []
        if KEPT:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._popen.terminate()
                self._popen.wait(timeout=_LAST_WORDS)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._popen.pid, signal.SIGKILL)
        for process in started:  # some have neither its group nor its environment
            with contextlib.suppress(psutil.Error):
                process.kill()
        self._popen.wait()
        self.connection.close()
        self._answers.close()
        for _ in range(_ROUNDS):
            found = _marked(self._mark)
            if not found:
                break
            for process in found:
                with contextlib.suppress(psutil.Error):
                    process.kill()
            psutil.wait_procs(found, timeout=1)
        self._place = self._last_place()
        self._crash.close()

    def _last_place(self) -> str:
        """Where it was when it crashed or was stopped, as far as that is known."""
        if self._crash.closed:
            return self._place
        self._crash.seek(0)
        frames = re.findall(rb'File "(.*)", line (\d+)', self._crash.read(1 << 16))
        # A signal that an agent raises passes through the worker's own code.
        own = os.fsencode(Path(__file__).with_name("worker.py"))
        frames = [frame for frame in frames if frame[0] != own] or frames
        return f" ({frames[0][0].decode(errors='replace')}:{int(frames[0][1])})" if frames else ""


def _descendants(number: int) -> list[psutil.Process]:
    """What a running process has started, and so on."""
    with contextlib.suppress(psutil.Error):
        return psutil.Process(number).children(recursive=True)
    return []


def _marked(mark: str) -> list[psutil.Process]:
    """Running processes that have a worker's mark in their environment."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.environ().get(_MARK) == mark and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # real-time signals have no names
        return f"signal {number}"
