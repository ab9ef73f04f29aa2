"""Answers of a worker process, read so that nothing which an agent writes there can do harm.

An agent can write to every open file of its process. Half an answer must not stop the run, a
length must not fill its memory, and what is read must not run code here.
"""

from __future__ import annotations

import io
import os
import pickle
import socket
import struct
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

_LENGTH, _LONG_LENGTH = struct.Struct("!i"), struct.Struct("!Q")
"""Length before a message, as ``multiprocessing`` writes it; -1 before the long form."""
_LONGEST = 1 << 28
"""Bytes of an answer, at most; an episode of the most steps there can be takes a tenth."""
_CHUNK = 1 << 16
_ALLOWED = {
    "crowdbench.agent": {"AgentError"},
    "crowdbench.evaluation.driven": {"Driven"},
    "crowdbench.evaluation.protocol": {"Broken", "Described", "Done", "Refused"},
    "crowdbench.scenario.errors": {"NoRoomError", "ScenarioError"},
    "numpy": {"dtype", "ndarray"},
    "numpy._core.multiarray": {"_reconstruct"},
    "numpy.core.multiarray": {"_reconstruct"},  # before NumPy 2
}
"""What an answer is made of."""


class UnreadableAnswerError(Exception):
    """What a process has sent is not an answer."""


class AnswerReader:
    """Reads what has arrived, and never waits for the rest."""

    def __init__(self, connection: Connection) -> None:
        """Read from one end of a pipe, which stays the caller's."""
        self._socket = socket.socket(fileno=os.dup(connection.fileno()))
        self._arrived = bytearray()
        self.ended = False
        """Whether nothing more can come."""

    def close(self) -> None:
        """Stop reading."""
        self._socket.close()

    def read(self) -> Iterator[Any]:
        """The whole messages that have arrived.

        Raises:
            UnreadableAnswerError: something else has.
        """
        while not self.ended and len(self._arrived) <= _LONGEST:
            try:
                chunk = self._socket.recv(_CHUNK, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            except OSError:
                chunk = b""
            self._arrived += chunk
            self.ended = not chunk
        while (size := self._size()) is not None:
            begin, length = size
            if len(self._arrived) < begin + length:
                return
            message = bytes(self._arrived[begin : begin + length])
            del self._arrived[: begin + length]
            try:
                yield _Unpickler(io.BytesIO(message)).load()
            except Exception as error:  # whatever bytes can make an unpickler raise
                raise UnreadableAnswerError from error

    def _size(self) -> tuple[int, int] | None:
        """Where the next message begins and how long it is; None while that is not known."""
        begin = _LENGTH.size
        if len(self._arrived) < begin:
            return None
        (length,) = _LENGTH.unpack_from(self._arrived)
        if length == -1:
            begin += _LONG_LENGTH.size
            if len(self._arrived) < begin:
                return None
            (length,) = _LONG_LENGTH.unpack_from(self._arrived, _LENGTH.size)
        if not 0 <= length <= _LONGEST:
            raise UnreadableAnswerError
        return begin, length


class _Unpickler(pickle.Unpickler):
    """Makes what answers are made of, and nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        if name not in _ALLOWED.get(module, ()):
            raise pickle.UnpicklingError(f"{module}.{name} is no part of an answer")
        return super().find_class(module, name)
