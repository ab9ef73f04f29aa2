"""A process beside this one for what simulates, whose memory would come on top of the rows'.

The compiler, the physics and pictures take as much memory as 100,000 rows and never give it back.
Who reads rows, fills tables and draws figures needs none of them: the few episodes to be shown are
simulated in a fresh interpreter, which stays for the next one and ends with this process.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from crowdbench.evaluation.database import ResultsError

Result = TypeVar("Result")

_START = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); " + (
    "from crowdbench.evaluation.apart import serve; serve(int(sys.argv[2]))"
)


def apart(function: Callable[..., Result], *arguments: Any) -> Result:
    """What a function returns that is called in the other process.

    Drives and walking models are those of installed packages, as in the processes of agents.

    Args:
        function: of a module; it, its arguments and its result are sent as pickles.
        arguments: its own.

    Raises:
        ResultsError: the process was ended.
        Exception: whatever the function raises.
    """
    connection = _process()
    try:
        connection.send((function, arguments))
        result, error = connection.recv()
    except (EOFError, OSError) as ending:
        _process.cache_clear()
        raise ResultsError("the process that simulates episodes was ended from outside") from ending
    if error is not None:
        raise error
    return result


def serve(descriptor: int) -> None:
    """Answer until the other end is closed."""
    with contextlib.suppress(EOFError), Connection(descriptor) as connection:
        while True:
            function, arguments = connection.recv()
            try:
                answer = pickle.dumps((function(*arguments), None))
            except Exception as error:
                answer = pickle.dumps((None, error))
            connection.send_bytes(answer)


@cache
def _process() -> Connection:
    """The connection to the process, which is started now; only this process holds it."""
    ours, theirs = Pipe()
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-c", _START, json.dumps(sys.path), str(theirs.fileno())],
            stdin=subprocess.DEVNULL,
            stdout=2,
            pass_fds=(theirs.fileno(),),
            start_new_session=True,  # Ctrl-C reaches this process alone
        )
    atexit.register(_end, process, ours)
    return ours


def _end(process: subprocess.Popen[bytes], connection: Connection) -> None:
    connection.close()
    process.wait()
