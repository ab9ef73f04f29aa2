"""Validation while training: the policy's success on seeds that nothing else uses."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from crowdbench_agents.learning.inputs import Sensed
from crowdbench_agents.learning.lanes import Lanes
from crowdbench_agents.learning.seeds import VALIDATION
from crowdbench_agents.learning.worlds import Worlds
from numpy.typing import NDArray

import crowdbench
from crowdbench.evaluation.navigation_metrics import path_efficiency, shortest_way

ENVIRONMENTS = 64


class PolicyInput(NamedTuple):
    """What N robots decide on.

    Attributes:
        sensed: their observations.
        velocity: (N, 2) their (v, w) in [-1, 1].
        place: (N,) number of each one's environment, in which episodes follow each other.
        steps: (N,) taken so far in the episode.
    """

    sensed: Sensed
    velocity: NDArray[np.float32]
    place: NDArray[np.integer]
    steps: NDArray[np.int64]


Act = Callable[[PolicyInput], NDArray[np.float32]]
"""Actions (N, 2) in [-1, 1] of N robots."""


class Validation(NamedTuple):
    """How often an agent arrives.

    Attributes:
        success: share of successes by scenario.
        spl: mean success weighted by path length, by scenario (crowdbench.evaluation.metrics).
        smoothness: mean squared change of (v [m/s], w [rad/s]) over all steps.
        seconds: mean time of the successful episodes [s].
    """

    success: dict[str, float]
    spl: dict[str, float]
    smoothness: float
    seconds: float

    @property
    def mean(self) -> float:
        """Mean success over scenarios."""
        return float(np.mean(list(self.success.values())))

    @property
    def mean_spl(self) -> float:
        """Mean SPL over scenarios."""
        return float(np.mean(list(self.spl.values())))


def validate(
    act: Act,
    geometry: crowdbench.MapGeometry,
    episodes: int,
    worlds: Worlds,
    first_seed: int = VALIDATION[0],
) -> Validation:
    """Run some validation seeds of each scenario.

    Args:
        act: the agent, for many environments at once.
        geometry: of the obstacle maps.
        episodes: per scenario.
        worlds: in which.
        first_seed: the others follow it.
    """
    wanted = ((name, first_seed + number) for number in range(episodes) for name in worlds)
    lanes = Lanes(min(ENVIRONMENTS, len(worlds) * episodes), worlds, wanted, geometry)
    shortest, driven = np.zeros((2, len(lanes)))

    def begin(which: NDArray[np.integer]) -> NDArray[np.integer]:
        begun = lanes.begin(which)
        for lane in begun:
            shortest[lane], driven[lane] = _shortest_way(lanes, lane), 0.0
        return begun

    running = begin(np.arange(len(lanes)))
    success: dict[str, list[bool]] = {name: [] for name in worlds}
    efficiency: dict[str, list[float]] = {name: [] for name in worlds}
    changes, seconds = [], []
    steps = np.zeros(len(lanes), np.int64)
    while len(running):
        sensed = Sensed(*(x[running] for x in lanes.sensed))
        velocity = lanes.bounds.normalised(sensed.velocity).astype(np.float32)
        action = lanes.bounds.physical(act(PolicyInput(sensed, velocity, running, steps[running])))
        moving = steps[running] > 0
        changes.append(np.square(action - sensed.velocity).sum(axis=-1)[moving])
        everybodys = np.zeros((len(lanes), 2), np.float32)  # lanes without an episode rest
        everybodys[running] = action
        before = lanes.seen["pose"][running, :2]
        result = lanes.step(everybodys)
        driven[running] += np.linalg.norm(lanes.seen["pose"][running, :2] - before, axis=-1)
        steps[running] += 1
        ended = result.over[running]
        over = running[ended]
        for lane in over:
            arrived, name = result.outcome[lane] == "success", lanes.scenario[lane]
            success[name].append(arrived)
            efficiency[name].append(arrived and path_efficiency(shortest[lane], driven[lane]))
            if arrived:
                seconds.append(steps[lane] * lanes.robot(lane).control_period)
            steps[lane] = 0
        running = np.sort(np.concatenate([running[~ended], begin(over)]))
    return Validation(
        {name: float(np.mean(values)) for name, values in success.items()},
        {name: float(np.nanmean(values)) for name, values in efficiency.items()},
        float(np.concatenate(changes).mean()),
        float(np.mean(seconds)) if seconds else float("nan"),
    )


def _shortest_way(lanes: Lanes, lane: int) -> float:
    state, robot = lanes.env.state(lane), lanes.robot(lane)
    return shortest_way(
        state["robot_pose"][0, :2], state["robot_goal"][0], state["walls"], state["obstacles"],
        (robot.length, robot.width), robot.goal_tolerance,
    )  # fmt: skip
