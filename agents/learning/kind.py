"""What a kind of learned agent brings to its training: networks that act, and a learner of them."""

from __future__ import annotations

import math
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

    Args:
        config: all settings.
        seed: of the initial parameters, which are drawn after this, and of the noise in the losses.
        device: where the networks are trained.

    Attributes:
        config, device: as given.
        network: what explorers act by; its tensors are what is passed on to other processes.
        log_alpha: logarithm of the entropy coefficient.
        generator: of the noise in the losses.
        updates: made so far.
        count: sequences in a batch.
        horizon: H, steps of each.
        watch: told what an update spends its time on.
    """

    network: nn.Module
    count: int
    horizon: int

    def __init__(self, config: Config, seed: int, device: torch.device) -> None:
        torch.manual_seed(seed)
        self.config, self.device = config, device
        self.generator = torch.Generator().manual_seed(seed)
        entropy = math.log(max(config.loss.entropy, 1e-8))
        self.log_alpha = torch.tensor(entropy, device=device, requires_grad=True)
        self.updates, self.watch = 0, Stopwatch()

    def _learn(
        self,
        networks: Mapping[str, nn.Module],
        optimizers: Mapping[str, torch.optim.Optimizer],
    ) -> None:
        """Name all that is learned, as the state does; learning rates are those without decay."""
        self._networks, self._optimizers = networks, optimizers
        self._rates = {
            name: [group["lr"] for group in optimizer.param_groups]
            for name, optimizer in optimizers.items()
        }

    def _set_learning_rates(self) -> None:
        """Let all learning rates follow their decay."""
        factor = self.config.learning_rate_factor(self.updates)
        for name, optimizer in self._optimizers.items():
            for group, rate in zip(optimizer.param_groups, self._rates[name], strict=True):
                group["lr"] = rate * factor

    @torch.no_grad()
    def _update_target(self, target: nn.Module, network: nn.Module) -> None:
        """Let a slow copy of a network follow it."""
        slow: list[Tensor] = list(target.parameters())
        fast: list[Tensor] = list(network.parameters())
        torch._foreach_lerp_(slow, fast, self.config.training.target_rate)

    def _noise(self, *shape: int) -> Tensor:
        """Standard normal, on the device."""
        return torch.randn(shape, generator=self.generator).to(self.device)

    @property
    def alpha(self) -> float:
        """Entropy coefficient."""
        return float(self.log_alpha.detach().exp())

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

    def state(self) -> dict[str, Any]:
        """Everything needed to continue: mappings and lists of tensors, numbers and text."""
        networks = {name: network.state_dict() for name, network in self._networks.items()}
        return {
            **networks,
            "optimizers": {name: o.state_dict() for name, o in self._optimizers.items()},
            "log_alpha": self.log_alpha.detach().clone(),
            "updates": self.updates,
            "generator": self.generator.get_state(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned, on whatever device that was."""
        for name, network in self._networks.items():
            network.load_state_dict(state[name])
        for name, optimizer in self._optimizers.items():
            optimizer.load_state_dict(state["optimizers"][name])
        with torch.no_grad():
            self.log_alpha.copy_(state["log_alpha"])
        self.updates = state["updates"]
        self.generator.set_state(state["generator"])


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
