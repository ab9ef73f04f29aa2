"""Episodes in chunks for workers that may vanish: who has which, and what has to be done again."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass

from crowdbench.evaluation.protocol import Job, Message

LONGEST = 16
"""Messages of a chunk: enough for the way to a worker to cost little."""
_ROUNDS = 2
"""Chunks are short enough for every worker to get about as many of what is left."""


@dataclass
class _Chunk:
    """What a worker has; it answers in order."""

    messages: list[Message]
    place: Hashable
    answered: int = 0

    @property
    def agent(self) -> str:
        return str(self.messages[0].agent)


class Work:
    """Hands the messages of a queue out in chunks and takes back what was lost.

    On each machine, an agent that has not acted there before goes to one worker first, so that
    what it needs is compiled once.
    """

    def __init__(self, queue: deque[Message]) -> None:
        self._queue = queue
        self._chunks: dict[Hashable, _Chunk] = {}
        self._warm: set[tuple[Hashable, str]] = set()
        self._again: list[Message] = []

    @property
    def busy(self) -> int:
        """Workers that have a chunk."""
        return len(self._chunks)

    def take(self, worker: Hashable, place: Hashable, workers: int) -> list[Message]:
        """The next chunk: of one agent, the shorter the less is left; empty if there is none now.

        Args:
            worker: who has none.
            place: the machine it is on.
            workers: how many share what is left.
        """
        cold = {chunk.agent for chunk in self._chunks.values() if chunk.place == place}
        cold -= {agent for where, agent in self._warm if where == place}
        start = next((n for n, m in enumerate(self._queue) if str(m.agent) not in cold), None)
        if start is None:
            return []
        length = max(1, min(LONGEST, len(self._queue) // (_ROUNDS * workers)))
        agent, messages = self._queue[start].agent, list[Message]()
        while len(messages) < length and len(self._queue) > start:
            if self._queue[start].agent != agent:
                break
            messages.append(self._queue[start])
            del self._queue[start]
        self._chunks[worker] = _Chunk(messages, place)
        return messages

    def answered(self, worker: Hashable) -> Message:
        """The message that a worker has answered now."""
        chunk = self._chunks[worker]
        message = chunk.messages[chunk.answered]
        chunk.answered += 1
        if isinstance(message, Job):
            self._warm.add((chunk.place, chunk.agent))
        return message

    def finished(self, worker: Hashable) -> None:
        """Note that a worker has answered all of its chunk."""
        del self._chunks[worker]

    def lost(self, worker: Hashable) -> Message | None:
        """Take back what a worker that is gone has not answered.

        Returns:
            The message that it was working on, if that was lost for the second time; it is not
            handed out any more.
        """
        chunk = self._chunks.pop(worker, None)
        left = chunk.messages[chunk.answered :] if chunk else []
        if not left:
            return None
        given_up = left.pop(0) if any(left[0] is one for one in self._again) else None
        if given_up is None:
            self._again.append(left[0])
        self._queue.extendleft(reversed(left))
        return given_up
