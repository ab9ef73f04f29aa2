"""Files that several processes append to and that survive a kill at any moment.

A record is appended with one write to a descriptor opened for appending, under an exclusive lock.
What a kill or a full disk can leave behind is therefore one incomplete record at the end, which
the next writer cuts off.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path


class ResultsError(RuntimeError):
    """Results that cannot be read or written; the message names the path and the reason."""


@contextlib.contextmanager
def locked(path: Path) -> Iterator[int]:
    """Open a file for reading and appending and hold its lock; yields the descriptor.

    Raises:
        ResultsError: the file cannot be opened, locked, read or written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            yield descriptor
        finally:
            os.close(descriptor)
    except OSError as error:
        raise ResultsError(f"{path}: cannot be written ({error.strerror or error})") from error


def append(descriptor: int, record: bytes) -> None:
    """Append a record to a locked file; when there is no room for all of it, write none of it."""
    end = os.fstat(descriptor).st_size
    try:
        while record:
            record = record[os.write(descriptor, record) :]
    except OSError:
        with contextlib.suppress(OSError):
            os.ftruncate(descriptor, end)
        raise


def read_from(descriptor: int, start: int) -> bytes:
    """Everything from a byte offset to the end that the file has now."""
    end = os.fstat(descriptor).st_size
    parts = []
    while start < end and (part := os.pread(descriptor, min(end - start, 1 << 20), start)):
        parts.append(part)
        start += len(part)
    return b"".join(parts)


def require_writable(folder: Path) -> None:
    """Find out before hours are spent whether results can be stored in a folder.

    Raises:
        ResultsError: the folder cannot be made or written to, or its disk is full.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(bytes(1 << 16))
            probe.flush()
            os.fsync(probe.fileno())
    except OSError as error:
        reason = error.strerror or str(error)
        raise ResultsError(f"{folder}: results cannot be written here ({reason})") from error
