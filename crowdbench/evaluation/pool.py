"""Worker processes that may hang or die without taking the run with them.

Every agent has processes of its own: whatever it does to one, no other agent is in it.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import wait
from types import TracebackType

from crowdbench.evaluation.answers import UnreadableAnswerError
from crowdbench.evaluation.heartbeat import MAKING, WARM_UP, Call, call_name
from crowdbench.evaluation.process import WorkerProcess
from crowdbench.evaluation.protocol import Answer, Broken, Lost, Message

_PATIENCE = 0.1
"""How often limits are looked at [s]."""
_KEPT = 4
"""Processes that are kept though nothing is left for them at the moment: starting costs more."""
_STARVED = 10
"""A limit on processor time, times this, limits wall time, on however busy a machine."""
_STALLED = 0.02
"""Share of a processor below which a process does nothing."""


@dataclass(frozen=True)
class Limits:
    """How long an agent's code may take [s].

    Calls are limited in processor time, so that a busy machine is not the agent's fault. They are
    over as well when the process has done nothing for as long, or after ten times as long.

    Attributes:
        step: ``reset`` and each ``act``.
        first: both together the first time in a process, when things are compiled and loaded;
            at least ``step``, and ``step`` once the agent has shown that it hangs.
        making: the agent's ``__init__`` and the import of its module; also all that happens
            between its calls.
    """

    step: float = 10.0
    first: float = 60.0
    making: float = 180.0


class Pool:
    """Hands messages to worker processes and yields their answers.

    Of an agent that has not acted on this machine before one process goes first, so that what
    it needs is compiled once.
    """

    def __init__(self, jobs: int, limits: Limits, keep: int = _KEPT) -> None:
        """Start nothing yet.

        Args:
            jobs: processes that work at the same time, at most.
            limits: for agent code.
            keep: processes in all, if more than ``jobs``: those of other agents wait.
        """
        self._jobs, self._keep = jobs, keep
        self._limits = limits
        self._hung: set[str] = set()
        self._warm: set[str] = set()
        self._processes: list[WorkerProcess] = []
        self._progress: dict[WorkerProcess, tuple[float, float]] = {}
        self._heard: dict[WorkerProcess, tuple[float, float]] = {}
        """The latest beat of a process that runs no agent, and when it was first seen."""

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
            self._processes.append(WorkerProcess())

    def run(self, queue: deque[Message]) -> Iterator[tuple[Message, Answer | Lost]]:
        """Yield every message with its answer as they come; the queue may grow meanwhile.

        A message whose process was killed from outside is handed out once more.
        """
        again: list[Message] = []
        while queue or any(process.message for process in self._processes):
            self._hand_out(queue)
            busy = [process for process in self._processes if process.message]
            ready = wait([process.connection for process in busy], timeout=_PATIENCE)
            for process in busy:
                message = process.message
                answer = self._listen(process, heard=process.connection in ready)
                if message is None or answer is None:
                    continue
                if isinstance(answer, Lost) and answer.outside and message not in again:
                    again.append(message)
                    queue.appendleft(message)
                    continue
                yield message, answer

    def _hand_out(self, queue: deque[Message]) -> None:
        """Give work to as many processes as there are jobs."""
        for process in [p for p in self._processes if not p.message and not p.alive]:
            self._end(process)
        while queue and sum(p.message is not None for p in self._processes) < self._jobs:
            message = self._take(queue)
            if message is None:
                return
            self._process_for(str(message.agent)).send(message)

    def _take(self, queue: deque[Message]) -> Message | None:
        """The first message whose agent is not waiting for its first process to warm up."""
        busy = [process for process in self._processes if process.message]
        self._warm |= {process.agent for process in busy if process.heartbeat.warm}
        cold = {process.agent for process in busy} - self._warm
        for number, message in enumerate(queue):
            if str(message.agent) not in cold:
                del queue[number]
                return message
        return None

    def _process_for(self, agent: str) -> WorkerProcess:
        """A process of the agent's that is free; others make room for a new one."""
        free = [process for process in self._processes if process.message is None]
        for process in sorted(free, key=lambda process: process.agent != agent):
            if process.agent in (agent, ""):
                return process
        if len(self._processes) >= max(self._jobs, self._keep):
            self._end(free[0])
        self._processes.append(WorkerProcess())
        return self._processes[-1]

    def _listen(self, process: WorkerProcess, heard: bool) -> Answer | Lost | None:
        """The answer if there is one, or what happened to the process that owed it."""
        if not heard and process.alive:
            return self._overdue(process)
        try:
            answer = process.receive()
        except (EOFError, OSError):
            call, ending = process.heartbeat.read(), process.exit_reason()
            self._forget(process)
            where = "" if call.running is None else f" in {call_name(call.step)}"
            if ending.outside:
                return Lost(
                    f"its process was killed from outside ({ending.reason}){where}", outside=True
                )
            self._warm.add(process.agent)
            return Lost(f"its process ended with {ending.reason}{where}")
        except UnreadableAnswerError:
            self._end(process)
            return Lost("its process sent something that is not an answer")
        if isinstance(answer, Broken):
            self._end(process)
        return answer

    def _overdue(self, process: WorkerProcess) -> Lost | None:
        """What to say of a call that takes too long, whose process is then ended."""
        call = process.heartbeat.read()
        if call.running is None:
            return self._silent(process, call)
        self._heard.pop(process, None)
        limit = self._limits.step
        if call.step == MAKING:
            limit = self._limits.making
        elif call.step == WARM_UP and process.agent not in self._hung:
            limit = max(limit, self._limits.first)
        if call.running <= limit:
            self._progress.pop(process, None)
            return None
        kind = self._patience_lost(process, call.running, call.processor, limit)
        if not kind:
            return None
        if call.step == WARM_UP:
            self._hung.add(process.agent)
            self._warm.add(process.agent)
        place = process.stop()
        self._forget(process)
        return Lost(
            f"{call_name(call.step)} did not return within the limit of {limit:g} s{kind}{place}"
        )

    def _silent(self, process: WorkerProcess, call: Call) -> Lost | None:
        """What to say of a process that neither runs the agent nor answers.

        Simulating takes a moment and compiling a minute. One that waits for ever has been kept
        from its heartbeat, or has sent half an answer.
        """
        now, limit = time.monotonic(), self._limits.making
        beat, since = self._heard.get(process, (math.nan, now))
        if beat != call.processor:  # each beat has a time of its own
            self._heard[process], since = (call.processor, now), now
            self._progress.pop(process, None)
        if now - since <= limit:
            return None
        kind = self._patience_lost(process, now - since, call.processor, limit)
        if not kind:
            return None
        self._warm.add(process.agent)
        place = process.stop()
        self._forget(process)
        return Lost(f"its process did not answer within {limit:g} s{kind}{place}")

    def _patience_lost(
        self, process: WorkerProcess, running: float, before: float, limit: float
    ) -> str:
        """Why a call is given up, as words to be added; empty while it is not."""
        now, used = time.monotonic(), process.processor_time()
        if used - before > limit:
            return " of processor time"
        # The first look counts from when the call began.
        since, then = self._progress.setdefault(process, (now - running, before))
        if used - then > _STALLED * limit:
            self._progress[process] = (now, used)
        elif now - since > limit:
            return " without computing"
        return f" and {_STARVED} times that" if running > _STARVED * limit else ""

    def _end(self, process: WorkerProcess) -> None:
        self._forget(process)
        process.kill()

    def _forget(self, process: WorkerProcess) -> None:
        self._processes.remove(process)
        self._progress.pop(process, None)
        self._heard.pop(process, None)
