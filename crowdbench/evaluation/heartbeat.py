"""The heartbeat of a worker: what its parent can see while agent code runs, in shared memory.

Memory, not messages: an agent that is stuck inside C code sends none.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import struct
import time
from collections.abc import Iterator
from typing import NamedTuple

MAKING, WARM_UP, RESET = -3, -2, -1
"""What stands in place of a step: the agent's ``__init__``, its first calls, its ``reset``."""

_CALL = struct.Struct("<qdd")
_NUMBER = struct.Struct("<q")
_SIGNAL, _WARM = _CALL.size, _CALL.size + _NUMBER.size
_SIZE = _WARM + _NUMBER.size


class Call(NamedTuple):
    """A call to agent code.

    Attributes:
        step: of the episode, or one of the constants above.
        running: for how long it has been running [s]; None if it has returned.
        processor: processor time of the process when it began [s].
    """

    step: int
    running: float | None
    processor: float


class Heartbeat:
    """Which call to agent code runs, and since when; shared through a file."""

    def __init__(self, descriptor: int) -> None:
        """Map the file; a new one is made large enough first."""
        os.ftruncate(descriptor, _SIZE)
        self._memory = mmap.mmap(descriptor, _SIZE)
        self._owner = os.getpid()

    def beat(self, step: int | None) -> None:
        """Note that the agent's code begins to run for a step, or that it has returned.

        A process that the agent forked and that has come back from its code ends here: the
        episode is its parent's.
        """
        if os.getpid() != self._owner:
            os._exit(0)
        since = 0.0 if step is None else time.monotonic()
        _CALL.pack_into(self._memory, 0, step or 0, since, time.process_time())

    @contextlib.contextmanager
    def during(self, step: int) -> Iterator[None]:
        """Note that the agent's code runs inside the block."""
        self.beat(step)
        try:
            yield
        finally:
            self.beat(None)

    def read(self) -> Call:
        """The latest call."""
        step, since, processor = _CALL.unpack_from(self._memory)
        return Call(step, time.monotonic() - since if since else None, processor)

    def note_signal(self, number: int) -> None:
        """Note that the process, or one of its children, is about to send it a signal."""
        _NUMBER.pack_into(self._memory, _SIGNAL, number)

    @property
    def signal(self) -> int:
        """The latest signal that was noted, or 0."""
        number: int = _NUMBER.unpack_from(self._memory, _SIGNAL)[0]
        return number

    def note_warm(self) -> None:
        """Note that the agent's first calls are behind it."""
        _NUMBER.pack_into(self._memory, _WARM, 1)

    @property
    def warm(self) -> bool:
        """Whether the agent's first calls are behind it."""
        return bool(_NUMBER.unpack_from(self._memory, _WARM)[0])


def call_name(step: int) -> str:
    """The call that a step or phase stands for."""
    names = {MAKING: "__init__", WARM_UP: "the first reset or act", RESET: "reset"}
    return names.get(step, f"act at step {step}")
