"""Trainers that packages bring, and one run of one of them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from crowdbench.cli.common import UserError
from crowdbench.messages import nearest

ENTRY_POINT_GROUP = "crowdbench.trainers"
RUNS, CURVES = Path("runs"), Path("results/training")


class Trainer:
    """Who trains the agent of a name.

    Raises:
        UserError: nobody does, or a package for it is missing.
    """

    def __init__(self, name: str) -> None:
        from importlib.metadata import entry_points

        points = {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}
        if name not in points:
            raise UserError(f"nothing to train is called {name!r}{nearest(name, sorted(points))}")
        self.name = name
        self._point: EntryPoint = points[name]
        try:
            self._function: Callable[..., Path] = self._point.load()
        except ImportError as error:
            raise UserError(f"{name}: {error}; is the extra 'train' installed?") from error

    def takes(self, argument: str) -> bool:
        """Whether an argument can be given to it."""
        parameters = inspect.signature(self._function).parameters
        takes_all = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
        return argument in parameters or takes_all

    def needs(self, argument: str) -> bool:
        """Whether it has no default for an argument."""
        parameter = inspect.signature(self._function).parameters.get(argument)
        return parameter is not None and parameter.default is parameter.empty

    def train(self, arguments: Mapping[str, Any]) -> Path:
        """Train once; returns the run's folder.

        Raises:
            UserError: what the trainer's own package has to say to the user.
        """
        try:
            return self._function(**arguments)
        except Exception as error:
            # What the trainer's own package raises was written for the user; the rest is a bug.
            if type(error).__module__.partition(".")[0] != self._point.module.partition(".")[0]:
                raise
            raise UserError(f"{self.name}: {error}") from error
