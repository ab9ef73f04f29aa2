"""Files that are whole or not there."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path beside ``path`` to write to; the file takes its place at the end.

    After an error, such as a full disk, what was there before is there still. The suffix is the
    same, as many libraries tell by it what to write; of a link, what it leads to is replaced.
    """
    place = Path(os.path.realpath(path))
    part = place.with_name(f".{place.stem}.{os.getpid()}{place.suffix}")
    try:
        yield part
        part.replace(place)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
