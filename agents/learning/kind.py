"""What a kind of learned agent brings to its training: networks that act, and a learner of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from crowdbench_agents.learning.batch import Batch
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.inputs import ActionBounds, Sensed
from crowdbench_agents.learning.stopwatch import Stopwatch
from crowdbench_agents.learning.validation import Act
from numpy.typing import NDArray
from torch import Tensor, nn


class Acts(NamedTuple):
    """What E environments do next, actions in [-1, 1].

    Attributes:
        action: (E, 2) to execute.
        reference: (E, 2) what is to be imitated, before exploration.
        source: (E,) whose that is, see ``Rows``.
    """

    action: NDArray[np.float32]
    reference: NDArray[np.float32]
    source: NDArray[np.uint8]


class Explorer(ABC):
    """Acts in E environments while training, by networks that somebody else trains.

    Attributes:
        decisions: made so far, each executed for one or more steps.
    """

    decisions: int

    @abstractmethod
    def begin(self, which: NDArray[np.integer], velocity: NDArray[np.float32]) -> None:
        """Forget what was going on in environments (N,), of 0 .. E - 1, whose episodes begin.

        Args:
            which: those that begin.
            velocity: (N, 2) of their robots, in [-1, 1].
        """

    @abstractmethod
    def act(self, sensed: Sensed) -> Acts:
        """The next action of every environment.

        Args:
            sensed: observations of all E environments.
        """

    def plan_again(self, sensed: Sensed) -> NDArray[np.float32] | None:
        """What is to be imitated in observations of the past, as things are seen now.

        Args:
            sensed: M observations.

        Returns:
            (M, 2) actions in [-1, 1], or None from those who do not plan.
        """
        return None

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """Counters and random state: tensors, numbers and text."""

    @abstractmethod
    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned."""


class Learner(ABC):
    """Networks, their optimisers and one update of them from a batch.

    Attributes:
        updates: made so far.
        count: sequences in a batch.
        horizon: H, steps of each.
        watch: told what an update spends its time on.
    """

    updates: int
    count: int
    horizon: int
    watch: Stopwatch

    @property
    @abstractmethod
    def network(self) -> nn.Module:
        """What explorers act by; its tensors are what is passed on to other processes."""

    @abstractmethod
    def update(self, batch: Batch) -> dict[str, Tensor]:
        """One update.

        Args:
            batch: on the CPU, with unscaled rewards; ``count`` sequences of ``horizon`` steps.

        Returns:
            The losses' terms, for the log.
        """

    @abstractmethod
    def check(self, terms: Mapping[str, float]) -> None:
        """Stop a training that has died or diverged.

        Args:
            terms: means of what ``update`` returned.

        Raises:
            TrainingError: it has; the message says how that shows and what helps.
        """

    @abstractmethod
    def scalars(self) -> dict[str, float]:
        """Numbers for the log beside the losses' terms."""

    @abstractmethod
    def policy(self) -> Act:
        """Act by the present policy, without noise."""

    @abstractmethod
    def tensors(self) -> dict[str, Tensor]:
        """The weights, as they are shipped."""

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """Everything needed to continue: mappings and lists of tensors, numbers and text."""

    @abstractmethod
    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned, on whatever device that was."""


class Kind(NamedTuple):
    """A kind of learned agent. Its members can be named from another process.

    Attributes:
        form: which networks the weights are of, as in ``save_weights``.
        learner: makes a learner of the configuration, the run's seed and a device.
        network: makes what explorers act by, on the CPU.
        explorer: makes an explorer of such a network, the configuration, the bounds of actions,
            the numbers (E,) of its environments among all those of a run, and a seed.
    """

    form: str
    learner: Callable[[Config, int, torch.device], Learner]
    network: Callable[[Config], nn.Module]
    explorer: Callable[[Any, Config, ActionBounds, NDArray[np.integer], int], Explorer]
