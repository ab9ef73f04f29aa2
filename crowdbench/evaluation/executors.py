"""Where agents run: what an executor does, and how one is found.

The runner hands messages to an executor and gets the answers, in whatever order they come. It
simulates and stores what they say itself, so that rows are the same wherever agents run. Another
package adds an executor in one file and one line of its metadata, under the entry-point group
``crowdbench.executors``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from types import TracebackType
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from crowdbench.registry import ClassRegistry

if TYPE_CHECKING:
    from crowdbench.evaluation.pool import Limits
    from crowdbench.evaluation.protocol import Answer, Lost, Message
    from crowdbench.evaluation.results import Origin


class ExecutorError(RuntimeError):
    """Agents cannot be run where they should; the message says why and what helps."""


class Reply(NamedTuple):
    """What became of a message.

    Attributes:
        message: the one that was handed over.
        answer: to it.
        origin: where it was worked on; the timestamp is left empty.
    """

    message: Message
    answer: Answer | Lost
    origin: Origin


class Executor(ABC):
    """Runs agents somewhere, from ``__enter__`` to ``__exit__``.

    Whatever an agent does there becomes an answer, ``Lost`` included; a message that was lost for
    a reason from outside is tried once more before it is answered so.
    """

    remote: ClassVar[bool] = False
    """Whether agents run on other machines, each of which compiles for itself."""

    @abstractmethod
    def __init__(self, jobs: int | None, limits: Limits, address: str | None) -> None:
        """Start nothing yet.

        Args:
            jobs: processes that work at the same time, at most; by default all there is room for.
            limits: for agent code.
            address: where to run them, for executors that can be told.

        Raises:
            ExecutorError: an address that it has no use for.
        """

    @abstractmethod
    def __enter__(self) -> Executor:
        """Get hold of what is needed.

        Raises:
            ExecutorError: it cannot be had.
        """

    @abstractmethod
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        place: TracebackType | None,
    ) -> None:
        """End all that was started."""

    @property
    @abstractmethod
    def jobs(self) -> int:
        """Processes that work at the same time, as far as is known now."""

    @abstractmethod
    def prepare(self, count: int) -> None:
        """Start what takes long, for as many messages; called once, before the first of them."""

    @abstractmethod
    def run(self, queue: deque[Message]) -> Iterator[Reply]:
        """Take messages from the queue, about in its order, and yield each of them once.

        Raises:
            ExecutorError: there is nothing left to run them on.
        """


EXECUTORS: ClassRegistry[Executor] = ClassRegistry(
    "executor",
    "crowdbench.executors",
    {
        "local": "crowdbench.evaluation.local:Local",
        "ray": "crowdbench.evaluation.ray_executor:RayExecutor",
    },
    base="crowdbench.evaluation.executors:Executor",
)
"""Subclasses of ``Executor`` by the name that ``--executor`` gives."""
