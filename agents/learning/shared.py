"""What the processes of a run share: numbers, weights, and locks that open when a holder dies."""

from __future__ import annotations

import ctypes
import fcntl
from collections.abc import Mapping, Sequence
from multiprocessing.context import SpawnContext
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import torch
from torch import nn

STAGES = ("acting", "expert", "simulation", "replay", "waiting")
"""What an actor spends its time on."""


class FileLock:
    """Keeps processes apart; the kernel opens it when its holder dies, whatever it died of.

    Args:
        path: of a file, made where there is none.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("a")

    def attempt(self) -> bool:
        """Take it unless somebody else has it; returns whether it was taken."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def release(self) -> None:
        """Let others take it."""
        fcntl.flock(self._file, fcntl.LOCK_UN)

    def __enter__(self) -> None:
        fcntl.flock(self._file, fcntl.LOCK_EX)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()


class Ledger:
    """Numbers that a learner and N actors tell each other; each is written by one process alone.

    Only ``success`` is written by all actors: who loses one of its small steps loses little.

    Args:
        actors: N.
        scenarios: names of those that are trained in.
        context: of the processes, to which this is handed as they start.

    Attributes:
        steps, decisions, episodes: (N,) made by each actor.
        heartbeat: (N,) when each was last seen at work, by the monotonic clock [s].
        seconds: (N, stages) spent on each of ``STAGES``.
        success: (scenarios,) running success in each.
        allowed: (1,) steps that all actors together may make.
        version: (1,) of the weights; the first is 1.
        stop: (1,) whether actors should end.
    """

    _COLUMNS = 4 + len(STAGES)

    def __init__(self, actors: int, scenarios: Sequence[str], context: SpawnContext) -> None:
        self._actors, self.scenarios = actors, list(scenarios)
        count = actors * self._COLUMNS + len(scenarios) + 3
        self._memory = context.RawArray(ctypes.c_double, count)
        self._name_parts()

    def _name_parts(self) -> None:
        numbers = np.ctypeslib.as_array(self._memory)
        table = numbers[: self._actors * self._COLUMNS].reshape(self._actors, self._COLUMNS)
        self.steps, self.decisions, self.episodes, self.heartbeat = table.T[:4]
        self.seconds = table[:, 4:]
        rest = numbers[table.size :]
        self.success, rest = rest[: len(self.scenarios)], rest[len(self.scenarios) :]
        self.allowed, self.version, self.stop = rest[:1], rest[1:2], rest[2:]

    def __getstate__(self) -> dict[str, Any]:
        return {"_actors": self._actors, "scenarios": self.scenarios, "_memory": self._memory}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._name_parts()


class SharedWeights:
    """The tensors of a network, passed on from the process that trains it to those that use it.

    Args:
        network: of which these are.
        ledger: tells their version.
        context: of the processes, to which this is handed as they start.
        lock: path of the lock's file.
    """

    def __init__(
        self, network: nn.Module, ledger: Ledger, context: SpawnContext, lock: Path
    ) -> None:
        count = sum(tensor.numel() for tensor in network.state_dict().values())
        self._memory = context.RawArray(ctypes.c_float, count)
        self._ledger, self._path = ledger, lock
        self._open()

    def _open(self) -> None:
        self._flat = torch.frombuffer(self._memory, dtype=torch.float32)
        self._lock, self._seen = FileLock(self._path), 0

    @torch.no_grad()
    def publish(self, network: nn.Module) -> None:
        """Pass on the tensors of a network as they are now."""
        values = [tensor.detach().float().reshape(-1) for tensor in network.state_dict().values()]
        flat = torch.cat(values).cpu()
        with self._lock:
            self._flat.copy_(flat)
            self._ledger.version += 1

    @torch.no_grad()
    def fetch(self, network: nn.Module) -> bool:
        """Give a network the newest tensors; returns whether there were newer ones."""
        if self._ledger.version[0] == self._seen:
            return False
        with self._lock:
            self._seen = int(self._ledger.version[0])
            at = 0
            for tensor in network.state_dict().values():
                part = self._flat[at : at + tensor.numel()]
                tensor.copy_(part.view(tensor.shape))
                at += tensor.numel()
        return True

    def __getstate__(self) -> dict[str, Any]:
        return {"_memory": self._memory, "_ledger": self._ledger, "_path": self._path}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__dict__.update(state)
        self._open()
