"""The keeper of a worker: the process between a run and a worker that ends all it has started.

Linux gives it every descendant whose own parent has ended, whatever session, group and
environment that one has made for itself, so that nothing which an agent starts can get away from
it. It does nothing else, and no agent's code runs in it. Elsewhere there are no keepers.
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

KEPT = sys.platform == "linux"
"""Whether workers have keepers."""
PATIENCE = 2.0
"""How long a keeper takes at most to end what is there [s]."""
_PAUSE = 0.005
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36


def keep(parent: int, descriptors: tuple[int, ...]) -> None:
    """Return in a child of this process; this one stays its keeper, and ends as it does.

    SIGTERM makes it end its child and itself, SIGABRT it hands on.

    Args:
        parent: process with which keeper and child end.
        descriptors: those that the child alone shall have.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if not KEPT:
        _leave_unless_child_of(parent)
        return
    meant = {signal.SIGTERM, signal.SIGABRT}
    signal.pthread_sigmask(signal.SIG_BLOCK, meant)
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    _prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    _leave_unless_child_of(parent)
    keeper = os.getpid()
    child = os.fork()
    if not child:
        os.setsid()  # what it does to its group does not reach the keeper
        _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        _leave_unless_child_of(keeper)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, meant)
        return
    for descriptor in descriptors:
        os.close(descriptor)
    _end_as(_watched(child, meant))


class _EndError(Exception):
    """The parent is gone, or wants the child to end."""


def _watched(child: int, meant: set[signal.Signals]) -> int:
    """The wait status of the child, with which all others have ended."""

    def hand_on(number: int, frame: object) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, number)

    def end(number: int, frame: object) -> None:
        raise _EndError

    status = int(signal.SIGTERM)
    with contextlib.suppress(_EndError):
        signal.signal(signal.SIGABRT, hand_on)
        signal.signal(signal.SIGTERM, end)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, meant)
        while True:
            ended, status_of_it = os.waitpid(-1, 0)
            if ended == child:
                status = status_of_it
                break
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    _end_children()
    return status


def _end_children() -> None:
    """End all children, and those of theirs that become its own by that."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        found = list(_children())
        for child in found:
            with contextlib.suppress(OSError):  # gone by now, or somebody else's
                os.kill(child, signal.SIGKILL)
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
            time.sleep(_PAUSE)
            continue
        return


def _children() -> Iterator[int]:
    """Processes whose parent this one is."""
    own = str(os.getpid())
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            # After the name, which may hold anything: state, parent.
            if (place / "stat").read_text(errors="replace").rpartition(")")[2].split()[1] == own:
                yield int(place.name)


def _end_as(status: int) -> None:
    """End this process as another one has ended."""
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        with contextlib.suppress(OSError):  # of SIGKILL
            signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    os._exit(os.waitstatus_to_exitcode(status))


def _prctl(option: int, value: int) -> None:
    import ctypes

    ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _leave_unless_child_of(parent: int) -> None:
    """End if the parent has ended before it could be asked to tell."""
    if os.getppid() != parent:
        os._exit(0)
