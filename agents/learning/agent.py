"""What the agents with learned networks have in common: checked weights, and what networks see."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from crowdbench_agents.learning.perception import ObstacleMap
from numpy.typing import NDArray

import crowdbench

if TYPE_CHECKING:
    from crowdbench_agents.learning.config import Config
    from crowdbench_agents.learning.inputs import Inputs


class LearnedAgent(crowdbench.Agent):
    """An agent with a weights file, which is found and looked into at once, so that an unusable one
    is refused before anything runs, and loaded at the first reset.

    PyTorch is imported when an agent is made, not with this module.

    Args:
        weights: name of shipped weights, or path of a ``.safetensors`` file.

    Raises:
        ValueError: there are none of that name.
        WeightsError: unreadable, or of other networks.
    """

    trainer: ClassVar[str]
    """``crowdbench train`` this to make the weights."""
    folder: ClassVar[Path]
    """Where shipped weights are."""

    def __init__(self, weights: str) -> None:
        from crowdbench_agents.learning.weights import file_digest, read_metadata

        self._path = self._find(weights)
        read_metadata(self._path, self._form())
        self.weights_sha256 = file_digest(self._path)
        self._network: Any = None

    @abstractmethod
    def _form(self) -> str:
        """Which networks the weights have to be of."""

    @abstractmethod
    def _load(self, path: Path) -> tuple[Any, Config]:
        """Read the network and its configuration from the weights file."""

    def reset(self, robot: crowdbench.RobotSpec, seed: int) -> None:
        """Load the weights if this has not been done, and forget the last episode.

        Raises:
            WeightsError: damaged, or changed since the agent was made.
        """
        import torch
        from crowdbench_agents.learning.inputs import ActionBounds
        from crowdbench_agents.learning.weights import WeightsError, file_digest

        if self._network is None:
            if file_digest(self._path) != self.weights_sha256:
                raise WeightsError(f"weights {self._path} changed since the agent was made")
            with torch.random.fork_rng(devices=[]):  # networks are made with random parameters
                self._network, self._config = self._load(self._path)
        geometry = self._config.perception.geometry
        self._map = ObstacleMap(robot.lidar_angles, robot.lidar_range, geometry)
        self._bounds = ActionBounds.of(robot)

    def act(self, observation: crowdbench.Observation) -> crowdbench.Action:
        """Add the scan to the map and return what the networks make of it."""
        import torch
        from crowdbench_agents.learning.inputs import Inputs

        maps = self._map.update(observation.lidar, observation.pose)
        arrays = (maps, observation.velocity, observation.goal)
        with _one_thread():
            action = self._choose(Inputs(*(torch.from_numpy(array[None]) for array in arrays)))
        # The mean of several plans at the bounds may lie beyond them by rounding.
        return self._bounds.physical(action.clip(-1, 1))

    @abstractmethod
    def _choose(self, inputs: Inputs) -> NDArray[np.float32]:
        """The action (2,) in [-1, 1] for a batch of one observation."""

    def _find(self, weights: str) -> Path:
        if not isinstance(weights, str):
            raise ValueError(f"weights: expected a name or path, got {weights!r}")
        if weights.endswith(".safetensors"):
            path = Path(weights)
            if not path.is_file():
                raise ValueError(f"weights: there is no file {weights!r}")
            return path
        path = self.folder / f"{weights}.safetensors"
        if not path.is_file():
            names = ", ".join(sorted(file.stem for file in self.folder.glob("*.safetensors")))
            raise ValueError(
                f"no weights {weights!r} (there are: {names or 'none'}); train with "
                f"`crowdbench train {self.trainer}`, or name a .safetensors file"
            )
        return path


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
