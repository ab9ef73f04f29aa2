"""The ``crowdbench`` command: one file a command, composed in ``app``."""

import sys

try:
    from crowdbench.cli.app import app, main
except ImportError as error:
    if sys.platform != "win32":
        raise
    sys.exit(str(error))  # a sentence, where it cannot run

__all__ = ["app", "main"]
