"""What the agents with learned networks have in common: checked weights, and what networks see."""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from crowdbench_agents.geometry.under_way import CommandsUnderWay
from crowdbench_agents.learning.trained_robot import TrainedRobot, warn_of_other_robot
from numpy.typing import NDArray

import crowdbench
from crowdbench.messages import setting, short

if TYPE_CHECKING:
    from crowdbench_agents.learning.config import Config
    from crowdbench_agents.learning.inputs import Inputs
    from torch import Tensor


class LearnedAgent(crowdbench.Agent):
    """An agent with a weights file, which is checked and loaded at once, so that an unusable one is
    refused before anything runs.

    PyTorch is imported when an agent is made, not with this module.

    Args:
        weights: name of shipped weights, or path of a ``.safetensors`` file.

    Raises:
        ValueError: there are none of that name.
        WeightsError: damaged, or of other networks.
    """

    trainer: ClassVar[str]
    """``crowdbench train`` this to make the weights."""
    folder: ClassVar[Path]
    """Where shipped weights are."""

    def __init__(self, weights: str) -> None:
        from crowdbench_agents.learning.weights import file_digest

        path = self._find(weights)
        self._name = f"the weights of {self.trainer} ({path.stem})"
        self.weights_sha256 = file_digest(path)
        self._network, self._config, training = self._load(path)
        self._trained = TrainedRobot.from_training(training, path)

    @abstractmethod
    def _load(self, path: Path) -> tuple[Any, Config, dict[str, Any]]:
        """The network of the weights file, its configuration, and how it was trained."""

    def reset(self, robot: crowdbench.RobotSpec, seed: int) -> None:
        """Forget the last episode; warn of a robot that the networks were not trained with."""
        from crowdbench_agents.learning.inputs import ActionBounds

        warn_of_other_robot(self._name, self._trained, robot)
        geometry = self._config.perception.geometry
        self._map = crowdbench.ObstacleMap(robot, geometry)
        self._under_way = CommandsUnderWay(robot)
        self._bounds = ActionBounds.of(robot)

    def act(self, observation: crowdbench.Observation) -> crowdbench.Action:
        """Add the scan to the map and return what the networks make of it.

        They see everything from where the robot will be when the action begins to act.
        """
        import torch
        from crowdbench_agents.learning.inputs import Inputs

        ahead = self._under_way.foresee(observation)
        maps = self._map.update(observation.lidar, observation.pose, ahead.pose)
        arrays = (maps, ahead.velocity, ahead.goal)
        with _one_thread():
            action = self._choose(Inputs(*(torch.from_numpy(array[None]) for array in arrays)))
        # The mean of several plans at the bounds may lie beyond them by rounding.
        return self._under_way.send(self._bounds.physical(action.clip(-1, 1)))

    @abstractmethod
    def _choose(self, inputs: Inputs) -> NDArray[np.float32]:
        """The action (2,) in [-1, 1] for a batch of one observation."""

    def export_onnx(self, path: Path) -> None:
        """Write what acts as an ONNX file, which the agent ``onnx`` drives by.

        Raises:
            ValueError: what acts is no network, or a package is missing.
            OSError: the file cannot be written.
        """
        policy = self._policy()
        from crowdbench_agents.learning.onnx_export import export_policy

        export_policy(path, self._network, policy, self._config, self._trained)

    @abstractmethod
    def _policy(self) -> Callable[[Inputs], Tensor]:
        """What acts, as a function of inputs (B, ...) whose values are actions (B, 2) in [-1, 1].

        Raises:
            ValueError: there is no such function; the message says with which options there is.
        """

    def _find(self, weights: str) -> Path:
        if not isinstance(weights, str):
            raise ValueError(f"weights: expected a name or path, got {setting(weights)}")
        if weights.endswith(".safetensors"):
            if not os.path.isfile(weights):  # noqa: PTH113 - unlike Path, never raises
                raise ValueError(f"weights: there is no file {short(weights)}")
            return Path(weights)
        shipped = {path.stem: path for path in sorted(self.folder.glob("*.safetensors"))}
        if weights not in shipped:
            raise ValueError(
                f"no weights {short(weights)} (there are: {', '.join(shipped) or 'none'}); train "
                f"with `crowdbench train {self.trainer}`, or name a .safetensors file"
            )
        return shipped[weights]


@contextmanager
def _one_thread() -> Iterator[None]:
    """Keep PyTorch from splitting small operations: waiting for each other takes longer."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
