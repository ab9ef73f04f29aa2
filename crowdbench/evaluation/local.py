"""The executor ``local``: agents run in worker processes of this machine."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from types import TracebackType

from crowdbench.evaluation.executors import Executor, ExecutorError, Reply
from crowdbench.evaluation.machine import core_count, machine_name
from crowdbench.evaluation.pool import Limits, Pool
from crowdbench.evaluation.protocol import Message
from crowdbench.evaluation.results import Origin


class Local(Executor):
    """Worker processes of this machine."""

    def __init__(self, jobs: int | None, limits: Limits, address: str | None = None) -> None:
        """Use one process per core by default; there is no address."""
        if address is not None:
            raise ExecutorError(
                f"an address ({address}) is for executors on other machines; agents run on this one"
            )
        self._jobs = jobs or core_count()
        self._pool = Pool(self._jobs, limits)
        self._origin = Origin.of(machine_name())

    def __enter__(self) -> Local:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        place: TracebackType | None,
    ) -> None:
        self._pool.__exit__(kind, error, place)

    @property
    def jobs(self) -> int:
        """Worker processes."""
        return self._jobs

    def prepare(self, count: int) -> None:
        """Start worker processes."""
        self._pool.prepare(count)

    def run(self, queue: deque[Message]) -> Iterator[Reply]:
        """Yield answers as the processes give them."""
        for message, answer in self._pool.run(queue):
            yield Reply(message, answer, self._origin)
