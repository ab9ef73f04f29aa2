"""Ray: how a cluster is reached, or started on this machine, and what it says when it fails."""

from __future__ import annotations

import logging
import os
import re
import socket
from typing import Any

from crowdbench.evaluation.executors import ExecutorError
from crowdbench.evaluation.machine import core_count

WITHOUT_NODES = 60.0
"""How long a command waits for a first or another node when there is none [s]."""
LOOK = 2.0
"""How often it is looked which nodes there are [s]."""

_LOCAL = "local"
"""What stands for a Ray that is started on this machine alone."""
_REACHED_WITHIN = 5.0
"""[s]; Ray itself tries for minutes."""
_OBJECT_STORE = 200_000_000
"""Of a Ray that is started here [bytes]; answers are small and do not go through it."""
_EXCEPTION = re.compile(r"[\w.]+: ")
"""How the last line of a traceback begins."""
_SETTINGS = bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + _SETTINGS
"""What an HTTP/2 client begins with; a server, Ray's too, begins with its own SETTINGS frame."""


def import_ray() -> Any:
    """The package.

    Raises:
        ExecutorError: it is not installed.
    """
    try:
        import ray
    except ImportError as error:
        raise ExecutorError(
            "the executor 'ray' needs Ray, which is not installed: "
            "pip install 'crowdbench-nav[ray]'"
        ) from error
    return ray


def connect(address: str | None) -> None:
    """Connect to the cluster of ``address`` or ``RAY_ADDRESS``, else start one on this machine.

    Ray's search for a cluster on this machine is not used: it finds those of others, and dead ones,
    with which Ray ends the process after a minute.

    Raises:
        ExecutorError: there is none at the address, or it cannot be used.
    """
    address = address or os.environ.get("RAY_ADDRESS") or _LOCAL
    settings: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address == _LOCAL:
        settings |= {"num_cpus": core_count(), "include_dashboard": False}
        settings |= {"object_store_memory": _OBJECT_STORE}
    else:
        _require_reachable(address)
    try:
        import_ray().init(address=address, **settings)
    except Exception as error:
        told = " ".join(str(error).split())
        if isinstance(error, ConnectionError) and "RAY_AUTH_MODE" not in os.environ:
            told += "; clusters that `ray start` makes want the user's token: RAY_AUTH_MODE=token"
        raise ExecutorError(f"Ray at {address}: {told}") from error


def reason_of(error: Exception) -> str:
    """What Ray says of a failure: the exception there, else its first sentence."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()] or [repr(error)]
    return lines[-1] if _EXCEPTION.match(lines[-1]) else lines[0]


def _require_reachable(address: str) -> None:
    """Find out within seconds whether a Ray cluster may be at an address, ``host:port``.

    Raises:
        ExecutorError: nothing there answers as Ray's server does.
    """
    host, separator, port = address.rpartition(":")
    if "://" in address or not separator or not port.isdigit():
        raise ExecutorError(
            f"Ray address {address!r}: expected HOST:PORT of the cluster's head, as `ray start "
            f"--head` says it, or {_LOCAL}"
        )
    try:
        with socket.create_connection((host, int(port)), timeout=_REACHED_WITHIN) as connection:
            if os.environ.get("RAY_USE_TLS") == "1":
                return
            connection.sendall(_PREFACE)
            answer = connection.recv(len(_SETTINGS))
    except (OSError, OverflowError) as error:
        raise ExecutorError(f"no Ray cluster at {address}: {error}") from error
    if answer[3:4] != _SETTINGS[3:4]:
        raise ExecutorError(f"no Ray cluster at {address}: something else answers there")
