"""What is wrong with a scenario, or with one of its seeds."""

from __future__ import annotations

from typing import Any


class ScenarioError(ValueError):
    """A scenario that cannot be used; the message names the file or field and what is allowed."""


class NoRoomError(ScenarioError):
    """A seed with which not everybody found a place; other seeds of the scenario may do.

    Attributes:
        seed: of the episode.
    """

    def __init__(self, message: str, seed: int) -> None:
        """Say who found no place."""
        super().__init__(message)
        self.seed = seed

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.seed)
