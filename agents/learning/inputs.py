"""What networks see and what they answer: batches of observations, normalised actions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from crowdbench_agents.learning.trained_robot import TrainedRobot
from numpy.typing import NDArray
from torch import Tensor

import crowdbench

ACTION = 2
"""Numbers in an action: v and w."""
REFLECT = torch.tensor([1.0, -1.0])
"""Factors on (x, y) or (v, w) that swap left and right."""


class Sensed(NamedTuple):
    """Observations of E environments.

    Attributes:
        map: (E, cells, cells) the obstacle map, see crowdbench.ObstacleMaps.
        velocity: (E, 2) v [m/s], w [rad/s].
        goal: (E, 2) goal in the robot frame [m].
    """

    map: NDArray[np.uint8]
    velocity: NDArray[np.float32]
    goal: NDArray[np.float32]


class Inputs(NamedTuple):
    """A batch of observations; leading dimensions (...) are equal.

    Attributes:
        map: (..., cells, cells) uint8, see crowdbench.ObstacleMaps.
        velocity: (..., 2) v [m/s], w [rad/s].
        goal: (..., 2) goal in the robot frame [m].
    """

    map: Tensor
    velocity: Tensor
    goal: Tensor

    def reflected(self) -> Inputs:
        """The same with left and right swapped."""
        turned = torch.from_numpy(reflect(self.map.numpy()))
        return Inputs(turned, self.velocity * REFLECT, self.goal * REFLECT)


def reflect(maps: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Swap left and right of maps (..., cells, cells)."""
    return np.ascontiguousarray(maps[..., ::-1])


class ActionBounds(NamedTuple):
    """Converts actions normalised to [-1, 1] to v [m/s], w [rad/s] and back."""

    centre: NDArray[np.float32]
    half: NDArray[np.float32]

    @classmethod
    def of(cls, robot: crowdbench.RobotSpec | TrainedRobot) -> ActionBounds:
        """The bounds of a robot."""
        low, high = np.array([robot.speed, robot.turn_rate], np.float32).T
        return cls((low + high) / 2, (high - low) / 2)

    def physical(self, action: NDArray[np.floating]) -> NDArray[np.floating]:
        """(..., 2) normalised -> v [m/s], w [rad/s]."""
        return action * self.half + self.centre

    def normalised(self, action: NDArray[np.floating]) -> NDArray[np.floating]:
        """(..., 2) v [m/s], w [rad/s] -> normalised."""
        return (action - self.centre) / self.half
