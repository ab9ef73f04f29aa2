"""The executor ``ray``: agents run on the nodes of a Ray cluster, or of one that is started here.

Each worker is an actor with one processor (``ray_node``), which gets chunks of episodes of one
agent and streams the answers back. A worker that is lost with its node costs what it had not
answered, and that goes to another one.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any

from crowdbench.evaluation.executors import Executor, ExecutorError, Reply
from crowdbench.evaluation.parcel import Parcel
from crowdbench.evaluation.pool import Limits
from crowdbench.evaluation.protocol import Lost, Message
from crowdbench.evaluation.ray_cluster import LOOK, WITHOUT_NODES, connect, import_ray, reason_of
from crowdbench.evaluation.ray_node import Greeting, Node
from crowdbench.evaluation.work import Work

_CLOSING = 10.0
"""How long workers may take to end their processes [s]."""
_STILLBORN = 3
"""Workers in a row that do not start, before the run is given up."""


class _Worker:
    """An actor and what it owes: its greeting, then the answers of a chunk."""

    def __init__(self, actor: Any) -> None:
        self.actor = actor
        self.owes: Any = actor.greet.remote()
        self.greeting: Greeting | None = None


class RayExecutor(Executor):
    """Workers on the nodes of a Ray cluster, one for each processor unless ``jobs`` says less."""

    remote = True

    def __init__(self, jobs: int | None, limits: Limits, address: str | None = None) -> None:
        """Use the cluster of ``address`` or ``RAY_ADDRESS``, else one of its own on this machine.

        Raises:
            ExecutorError: Ray is not installed.
        """
        self._ray = import_ray()
        self._wanted, self._limits, self._address = jobs, limits, address
        self._connected = False
        self._workers: list[_Worker] = []
        self._parcels: dict[str, Any] = {}
        self._stillborn = 0
        self._processors, self._looked, self._last_seen = 0, -LOOK, 0.0

    def __enter__(self) -> RayExecutor:
        if not self._ray.is_initialized():
            connect(self._address)
            self._connected = True
        elif self._address is not None:
            raise ExecutorError(
                f"this process is connected to Ray already; leave the address {self._address} out"
            )
        self._kind = self._ray.remote(num_cpus=1, max_restarts=0)(Node)
        self._last_seen = time.monotonic()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        place: TracebackType | None,
    ) -> None:
        # Those that are busy are ended by Ray, and their processes with them.
        ends = [worker.actor.close.remote() for worker in self._workers if worker.owes is None]
        if ends:
            self._ray.wait(ends, num_returns=len(ends), timeout=_CLOSING)
        for worker in self._workers:
            self._ray.kill(worker.actor)
        self._workers.clear()
        if self._connected:
            self._ray.shutdown()

    @property
    def jobs(self) -> int:
        """Processors of the cluster, or as many as were asked for."""
        return self._wanted or max(1, self._count_processors())

    def prepare(self, count: int) -> None:
        """Start workers."""
        while len(self._workers) < min(count, self.jobs):
            self._workers.append(_Worker(self._kind.remote(self._limits, str(Path.cwd()))))

    def run(self, queue: deque[Message]) -> Iterator[Reply]:
        """Yield answers as they come from the nodes.

        Raises:
            ExecutorError: a node has another crowdbench or none, or no node is left.
        """
        work = Work(queue)
        while queue or work.busy:
            self._require_nodes()
            self.prepare(len(queue) + work.busy)
            self._hand_out(work)
            for worker in self._ready():
                reply = self._hear(worker, work)
                if reply is not None:
                    yield reply

    def _count_processors(self) -> int:
        now = time.monotonic()
        if now - self._looked > LOOK:
            self._processors = int(self._ray.cluster_resources().get("CPU", 0))
            self._looked = now
            if self._processors:
                self._last_seen = now
        return self._processors

    def _require_nodes(self) -> None:
        missing = time.monotonic() - self._last_seen
        if not self._count_processors() and missing > WITHOUT_NODES:
            raise ExecutorError(
                f"the Ray cluster has had no processors for {WITHOUT_NODES:g} s; finished "
                "episodes are stored, and the same command goes on from there"
            )

    def _hand_out(self, work: Work) -> None:
        """Give a chunk to every worker that has none."""
        for worker in self._workers:
            if worker.greeting is None or worker.owes is not None:
                continue
            messages = work.take(worker, worker.greeting.node, self.jobs)
            if messages:
                run = worker.actor.run.options(num_returns="streaming")
                worker.owes = run.remote(self._parcel(messages[0]), messages)

    def _parcel(self, message: Message) -> Any:
        label = str(message.agent)
        if label not in self._parcels:
            self._parcels[label] = self._ray.put(Parcel.of(message.agent))
        return self._parcels[label]

    def _ready(self) -> list[_Worker]:
        """Workers of which there is news, after waiting a while for the first."""
        owing = {worker.owes: worker for worker in self._workers if worker.owes is not None}
        if not owing:
            time.sleep(0.1)
            return []
        self._ray.wait(list(owing), num_returns=1, timeout=LOOK)
        ready, _ = self._ray.wait(list(owing), num_returns=len(owing), timeout=0)
        return [owing[one] for one in ready]

    def _hear(self, worker: _Worker, work: Work) -> Reply | None:
        """Take what a worker owes; a reply if it is an answer, or the last word on a message."""
        exceptions = self._ray.exceptions
        try:
            if worker.greeting is None:
                worker.greeting, worker.owes = self._ray.get(worker.owes), None
                self._stillborn = 0
                _require_same_release(worker.greeting)
                return None
            answer = self._ray.get(next(worker.owes))
            return Reply(work.answered(worker), answer, worker.greeting.origin)
        except StopIteration:
            worker.owes = None
            work.finished(worker)
        except exceptions.RayError as error:
            return self._dismiss(worker, work, error)
        return None

    def _dismiss(self, worker: _Worker, work: Work, error: Exception) -> Reply | None:
        """Do without a worker that is gone; what it had is done by another."""
        self._workers.remove(worker)
        self._ray.kill(worker.actor)
        reason = reason_of(error)
        if worker.greeting is None:
            self._stillborn += 1
            if self._stillborn >= _STILLBORN:
                raise ExecutorError(f"workers cannot be started on the Ray cluster: {reason}")
            return None
        message = work.lost(worker)
        if message is None:
            return None
        return Reply(
            message,
            Lost(f"its Ray worker was lost ({reason})", outside=True),
            worker.greeting.origin,
        )


def _require_same_release(greeting: Greeting) -> None:
    here = version("crowdbench-nav")
    if greeting.release != here:
        raise ExecutorError(
            f"a node ({greeting.origin.machine}) has crowdbench {greeting.release}, this machine "
            f"{here}; install the same version on all"
        )
