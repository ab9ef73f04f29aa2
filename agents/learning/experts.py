"""Expert labels: what another agent would do at each step where a learner drives (DAgger).

Cf. Ross et al., "A reduction of imitation learning and structured prediction to no-regret online
learning", 2011.
"""

from __future__ import annotations

import numpy as np
from crowdbench_agents.learning.lanes import Lanes
from numpy.typing import NDArray

import crowdbench

FOLLOW = np.array([0.7, 0.5])
"""Share of the change of (v, w) to what the expert wants that is made at each step: experts plan
from scratch at each step and are jerky."""


class Experts:
    """One expert for each of some lanes.

    Args:
        name: of the agent; it may be a privileged one.
        lanes: in which they are.
        which: (M,) of them.
    """

    def __init__(self, name: str, lanes: Lanes, which: NDArray[np.integer]) -> None:
        self.which, self._lanes = which, lanes
        self._agents = {index: crowdbench.AgentSpec.parse(name).make() for index in which}

    def begin(self, which: NDArray[np.integer]) -> None:
        """Start anew in those lanes, of any, whose episodes begin."""
        for index in which:
            if index in self._agents:
                self._agents[index].reset(self._lanes.robot(index), seed=0)

    def labels(self) -> NDArray[np.float32]:
        """(M, 2) actions in [-1, 1]; to be asked once a step, as experts may track people."""
        lanes = self._lanes
        wanted = np.array(
            [agent.act(lanes.observation(i)) for i, agent in self._agents.items()], np.float32
        ).reshape(-1, 2)
        velocity = lanes.sensed.velocity[self.which]
        return lanes.bounds.normalised(velocity + FOLLOW * (wanted - velocity)).astype(np.float32)
