"""What runs on a Ray node: chunks of episodes of one agent, with the local executor's processes."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from crowdbench.agent import AgentSpec
from crowdbench.evaluation.machine import machine_name
from crowdbench.evaluation.parcel import Parcel, below, without_root
from crowdbench.evaluation.pool import Limits, Pool
from crowdbench.evaluation.protocol import Answer, Lost, Message
from crowdbench.evaluation.results import Origin

_KEPT = 2
"""Processes of a worker: there may be as many workers as processors, and memory is limited."""
_FOLDER = "crowdbench-node-"
"""Prefix of workers' folders."""
_YOUNG = 60.0
"""A folder without a lock may be about to get it for so long [s]."""


class Greeting(NamedTuple):
    """What a node says of itself.

    Attributes:
        node: by which Ray knows the machine.
        release: of crowdbench.
        origin: as rows name it.
    """

    node: str
    release: str
    origin: Origin


class Node:
    """One worker, an actor of Ray's: it holds agents' processes and runs one episode at a time."""

    def __init__(self, limits: Limits, folder: str) -> None:
        """Start a process ahead of its work.

        Args:
            limits: for agent code.
            folder: the one that the run was started in, where it was started.
        """
        self._root, self._lock = own_folder()
        here = below(self._root, folder)
        here.mkdir(parents=True, exist_ok=True)
        os.chdir(here)  # processes start in it
        self._unpacked: dict[str, AgentSpec] = {}
        self._pool = Pool(1, limits, keep=_KEPT)
        self._pool.prepare(1)

    def greet(self) -> Greeting:
        """Say which node this is."""
        import ray

        node = ray.get_runtime_context().get_node_id()
        return Greeting(node, version("crowdbench-nav"), Origin.of(machine_name()))

    def run(self, parcel: Parcel, messages: Sequence[Message]) -> Iterator[Answer | Lost]:
        """Answer messages about the agent in the parcel, one after the other."""
        label = str(parcel.agent)
        if label not in self._unpacked:
            self._unpacked[label] = parcel.unpack(self._root)
        agent = self._unpacked[label]
        queue: deque[Message] = deque(replace(message, agent=agent) for message in messages)
        for _, answer in self._pool.run(queue):
            yield without_root(answer, self._root)

    def close(self) -> None:
        """End the processes and remove what was written."""
        self._pool.__exit__(None, None, None)
        os.chdir("/")
        shutil.rmtree(self._root, ignore_errors=True)
        os.close(self._lock)


def own_folder() -> tuple[Path, int]:
    """Make a temporary folder, and remove those of workers that were killed.

    Returns:
        The folder, and a descriptor that locks it until it is closed or this process ends.
    """
    for left in Path(tempfile.gettempdir()).glob(f"{_FOLDER}*"):
        try:
            lock = os.open(left, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except OSError:  # gone by now, or somebody else's
            continue
        try:
            if time.time() - os.fstat(lock).st_mtime > _YOUNG:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(left, ignore_errors=True)
        except BlockingIOError:
            pass  # of a worker that lives
        finally:
            os.close(lock)
    root = Path(tempfile.mkdtemp(prefix=_FOLDER)).resolve()
    lock = os.open(root, os.O_RDONLY | os.O_DIRECTORY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    return root, lock
