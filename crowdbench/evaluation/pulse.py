"""The pulse of a worker: what it lets its parent see while agent code runs, in shared memory.

Memory, not messages: an agent that is stuck inside C code sends none.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import struct
import time
from collections.abc import Iterator

MAKING, WARM_UP, RESET = -3, -2, -1
"""What stands in place of a step: the agent's ``__init__``, its first calls, its ``reset``."""

_LAYOUT = struct.Struct("<qd")


class Pulse:
    """Which call to agent code runs, and since when; shared through a file."""

    def __init__(self, descriptor: int) -> None:
        """Map the file; a new one is made large enough first."""
        os.ftruncate(descriptor, _LAYOUT.size)
        self._memory = mmap.mmap(descriptor, _LAYOUT.size)

    def beat(self, step: int | None) -> None:
        """Note that the agent's code begins to run for a step, or that it has returned."""
        since = 0.0 if step is None else time.monotonic()
        _LAYOUT.pack_into(self._memory, 0, step or 0, since)

    @contextlib.contextmanager
    def during(self, step: int) -> Iterator[None]:
        """Note that the agent's code runs inside the block."""
        self.beat(step)
        try:
            yield
        finally:
            self.beat(None)

    def read(self) -> tuple[int, float | None]:
        """The step, and how long its call has been running [s], or None if none runs."""
        step, since = _LAYOUT.unpack_from(self._memory)
        return step, time.monotonic() - since if since else None


def call_name(step: int) -> str:
    """The call that a step or phase stands for."""
    names = {MAKING: "__init__", WARM_UP: "the first reset or act", RESET: "reset"}
    return names.get(step, f"act at step {step}")
