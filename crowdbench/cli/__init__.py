"""The ``crowdbench`` command: one file a command, composed in ``app``."""

from crowdbench.cli.app import app, main

__all__ = ["app", "main"]
