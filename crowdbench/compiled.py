"""Numba's compiler with a cache that lasts: a function is compiled once per machine, not per start.

Numba keeps machine code beside the source file, where a reinstallation removes it and a read-only
installation has no room for it. Here it is kept in the user's cache folder, apart for every state
of the sources: a function that calls a changed one in another file is compiled anew as well.
``NUMBA_CACHE_DIR``, if set, comes first; without any folder to write to, one below the system's
folder for temporary files.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import os
import stat
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import platformdirs
from numba.core import event

F = TypeVar("F", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[F], F]:
    """Decorate a function for ``numba.njit``, with ``options`` as there and a lasting cache.

    Functions must not close over compiled ones: numba would compile them anew at every start. What
    is called in one place only compiles faster with ``inline="always"``.
    """
    settings: dict[str, Any] = {
        "cache": True,
        # What follows is a tenth each of the time to compile: a wrapper for C, where nobody calls
        # these from, and a test of every division, which gives inf or nan for 0 instead.
        "no_cfunc_wrapper": True,
        "error_model": "numpy",
        **options,
    }
    return _with_cache(numba.njit(**settings))


def compiled_callback(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """The same for a function that C calls (``numba.cfunc``); it is compiled at once."""
    return _with_cache(numba.cfunc(signature, cache=True))


class _WithoutCollector(event.Listener):
    """Leave garbage alone while numba compiles.

    Its many new objects would have everything that is in memory searched again and again.
    """

    def __init__(self) -> None:
        self._depth = 0
        self._enabled = False

    def on_start(self, _event: event.Event) -> None:
        """Called with numba's lock held, also for functions that the first one calls."""
        if self._depth == 0:
            self._enabled = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, _event: event.Event) -> None:
        """Collect as before once the outermost function is done, or has failed."""
        self._depth -= 1
        if self._depth == 0 and self._enabled:
            gc.enable()


event.register("numba:compile", _WithoutCollector())


def _with_cache(decorator: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Have the decorator keep machine code in the folder of this state of the sources."""

    def decorate(function: Any) -> Any:
        package = sys.modules[function.__module__.partition(".")[0]]
        folder = cache_folder() / _state(package.__name__, package.__path__[0])
        config: Any = numba.config
        before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
        try:
            return decorator(function)
        finally:
            config.CACHE_DIR = before

    return decorate


@cache
def cache_folder() -> Path:
    """The first folder for machine code that can be written to."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folders = [Path(chosen)] if chosen else []
    folders.append(Path(platformdirs.user_cache_dir("crowdbench", appauthor=False)) / "compiled")
    for folder in folders:
        if _can_be_used(folder):
            return folder
    user = os.getuid() if hasattr(os, "getuid") else "user"
    last = Path(tempfile.gettempdir()) / f"crowdbench-{user}"
    return last if _can_be_used(last) and _is_mine(last) else Path(tempfile.mkdtemp())


def was_run(name: str) -> bool:
    """Whether something has been run with these sources on this machine, and so was compiled."""
    return _note_of(name).exists()


def note_run(name: str) -> None:
    """Take note of what has been run."""
    note = _note_of(name)
    with contextlib.suppress(OSError):  # without a note it is said again, and nothing else
        note.parent.mkdir(parents=True, exist_ok=True)
        note.touch()


def _note_of(name: str) -> Path:
    folder = cache_folder() / _state("crowdbench", str(Path(__file__).parent))
    return folder / f"run-{hashlib.sha256(name.encode('utf-8', 'replace')).hexdigest()[:12]}"


def _can_be_used(folder: Path) -> bool:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _is_mine(folder: Path) -> bool:
    """Whether nobody else could have put something there: machine code is loaded unseen."""
    if not hasattr(os, "getuid"):
        return True
    status = folder.lstat()
    private = not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and private


@cache
def _state(name: str, folder: str) -> str:
    """Name of a package with a hash of its compiled sources and of crowdbench's."""
    digest = hashlib.sha256()
    for place in dict.fromkeys([str(Path(__file__).parent), folder]):
        for path in sorted(Path(place).rglob("*.py")):
            content = path.read_bytes()
            if b"@compiled" in content:
                digest.update(path.relative_to(place).as_posix().encode() + content)
    return f"{name}-{digest.hexdigest()[:12]}"
