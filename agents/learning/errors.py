"""What stops a training."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class TrainingError(RuntimeError):
    """Training cannot go on; the message says why and what helps."""


@contextmanager
def to_disk(path: Path, then: str) -> Iterator[None]:
    """While ``path`` is written, say of a full disk to make room and do what ``then`` says.

    Raises:
        TrainingError: in place of every OSError.
    """
    try:
        yield
    except OSError as error:
        raise TrainingError(
            f"{path}: could not be written ({error.strerror or error}); make room on the disk and "
            f"{then}"
        ) from error
