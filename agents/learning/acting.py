"""Who fills a run's replay: the run's own process, step by step, or others (``actors``)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

from crowdbench_agents.learning.rollout import Rollout
from torch import nn


class Acting(ABC):
    """All of a run's environments and those who act in them."""

    @property
    @abstractmethod
    def steps(self) -> int:
        """Environment steps so far."""

    @property
    @abstractmethod
    def decisions(self) -> int:
        """Decisions so far, each executed for one or more steps."""

    @abstractmethod
    def begin(self, say: Callable[[str], None], stopping: Callable[[], bool]) -> None:
        """Start an episode in every environment.

        Args:
            say: called with a line that the user has to see.
            stopping: tells whether to stop, and to wait for nothing any more.
        """

    @abstractmethod
    def step(self) -> None:
        """Let every environment take one more control step than at the last call."""

    @abstractmethod
    def updated(self) -> None:
        """Learn that the networks have changed."""

    @abstractmethod
    def seconds(self) -> dict[str, float]:
        """Seconds since this was last asked, by what they were spent on."""

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """What has to survive an interruption."""

    @abstractmethod
    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned, here or elsewhere."""

    @abstractmethod
    def close(self) -> None:
        """End all that was started."""


class InProcess(Acting):
    """Acting in the learner's own process and in turn with it, the same for the same seed.

    Args:
        rollout: of all environments.
        network: what it acts by.
        learned: what is trained: ``network`` itself, or its original elsewhere.
    """

    def __init__(self, rollout: Rollout, network: nn.Module, learned: nn.Module) -> None:
        self._rollout, self._network, self._learned = rollout, network, learned

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self._rollout.steps

    @property
    def decisions(self) -> int:
        """Decisions so far."""
        return self._rollout.explorer.decisions

    def begin(self, say: Callable[[str], None], stopping: Callable[[], bool]) -> None:
        """Start an episode in every environment."""
        self._rollout.begin()

    def step(self) -> None:
        """One control step in every environment, by the networks as they are now."""
        if self._network is not self._learned:
            self._network.load_state_dict(self._learned.state_dict())
        self._rollout.step()

    def updated(self) -> None:
        """Nothing is to be done before the next step."""

    def seconds(self) -> dict[str, float]:
        """Seconds since this was last asked, by what they were spent on."""
        return self._rollout.watch.take()

    def state(self) -> dict[str, Any]:
        """The explorer's counters and random state."""
        explorer = self._rollout.explorer.state()
        return {"steps": self.steps, "decisions": self.decisions, "explorer": explorer}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned; what actors returned says nothing of the noise."""
        self._rollout.steps = state["steps"]
        if state["explorer"]:
            self._rollout.explorer.restore(state["explorer"])
        self._rollout.explorer.decisions = state["decisions"]

    def close(self) -> None:
        """Nothing was started."""
