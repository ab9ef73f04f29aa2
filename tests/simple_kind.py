"""A kind of learned agent whose one number is what it does, for processes to tell apart."""

import time

import numpy as np
import torch
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.kind import Acts, Explorer, Kind
from crowdbench_agents.learning.replay import NOBODY

SMALL = Config().override(
    {
        "perception.cells": 16, "training.environments": 4, "training.planning_environments": 0,
        "training.replay": 4000, "training.expert": "straight_line",
        "training.labelled_environments": 1,
    }
)  # fmt: skip


class Number(torch.nn.Module):
    """One number."""

    def __init__(self, config=None):
        super().__init__()
        self.number = torch.nn.Parameter(torch.zeros(1))


class Doing(Explorer):
    """Turns by the number and stands still."""

    delay = 0.0

    def __init__(self, network, config, bounds, lanes, seed):
        self.decisions, self._network, self._count = 0, network, len(lanes)

    def begin(self, which, velocity):
        pass

    def act(self, sensed):
        time.sleep(self.delay)
        self.decisions += self._count
        action = np.tile(np.float32([-1.0, self._network.number.item()]), (self._count, 1))
        return Acts(action, np.zeros_like(action), np.full(self._count, NOBODY, np.uint8))

    def state(self):
        return {}

    def restore(self, state):
        pass


class SlowDoing(Doing):
    """Takes its time."""

    delay = 0.05


def refuse(*args):
    """An explorer that cannot be made."""
    raise ValueError("there is nothing to explore")


KIND = Kind("number", None, Number, Doing)
SLOW_KIND = KIND._replace(explorer=SlowDoing)
BROKEN_KIND = KIND._replace(explorer=refuse)
