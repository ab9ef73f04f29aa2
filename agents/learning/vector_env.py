"""Many environments stepped together, each episode in a scenario drawn from a sampler."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from crowdbench_agents.learning.inputs import ActionBounds
from crowdbench_agents.learning.perception import MapGeometry, ObstacleMaps
from numpy.typing import NDArray

import crowdbench

ROBOT = "robot_0"


class Sensed(NamedTuple):
    """Observations of E environments: map (E, cells, cells), velocity (E, 2), goal (E, 2)."""

    map: NDArray[np.uint8]
    velocity: NDArray[np.float32]
    goal: NDArray[np.float32]

    def copy(self) -> Sensed:
        """The same, not changed by later steps."""
        return Sensed(self.map.copy(), self.velocity.copy(), self.goal.copy())


class Outcomes(NamedTuple):
    """What one step did in E environments.

    Attributes:
        reward: (E,) without the social term.
        social: (E,) the social term.
        end: (E,) arrival or collision.
        over: (E,) the episode is over, by its end or by the time limit.
        outcome: (E,) as in the environment's infos.
    """

    reward: NDArray[np.float32]
    social: NDArray[np.float32]
    end: NDArray[np.bool_]
    over: NDArray[np.bool_]
    outcome: NDArray[np.str_]


class VectorEnv:
    """E environments with automatic choice of the next episode, but no automatic reset.

    Args:
        count: E.
        episodes: yields the (scenario name, seed) of each episode to come.
        geometry: of the obstacle maps.
    """

    def __init__(
        self,
        count: int,
        episodes: Iterator[tuple[str, int]],
        geometry: MapGeometry,
    ) -> None:
        self.count = count
        self._episodes = episodes
        self._idle: dict[str, list[crowdbench.CrowdEnv]] = defaultdict(list)
        robot = crowdbench.RobotSpec.from_scenario(
            crowdbench.load_scenario(crowdbench.scenario_names()[0])
        )
        self.robot = robot
        self.bounds = ActionBounds.of(robot)
        self._maps = ObstacleMaps(count, robot.lidar_angles, robot.lidar_range, geometry)
        self._environments: list[crowdbench.CrowdEnv | None] = [None] * count
        self.scenario = np.empty(count, dtype=object)
        self.seed = np.zeros(count, np.int64)
        self.raw: list[dict[str, NDArray[np.float32]]] = [{}] * count
        cells = geometry.cells
        self.sensed = Sensed(
            np.zeros((count, cells, cells), np.uint8),
            np.zeros((count, 2), np.float32),
            np.zeros((count, 2), np.float32),
        )

    def begin(self, which: NDArray[np.integer]) -> NDArray[np.integer]:
        """Start the next episode in the given environments, fewer when no episodes are left.

        Returns:
            Those that were started; ``sensed`` holds their first observations.
        """
        started = []
        for index in which:
            item = next(self._episodes, None)
            if item is None:
                break
            self._release(index)
            name, seed = item
            idle = self._idle[name]
            environment = idle.pop() if idle else crowdbench.parallel_env(name)
            observations, _ = environment.reset(seed=seed)
            self._environments[index] = environment
            self.scenario[index], self.seed[index] = name, seed
            self.raw[index] = observations[ROBOT]
            self._maps.reset(index)
            started.append(index)
        indices = np.array(started, np.int64)
        self._sense(indices)
        return indices

    def step(self, which: NDArray[np.integer], actions: NDArray[np.floating]) -> Outcomes:
        """Act in the given environments (M,) with v [m/s], w [rad/s] (M, 2)."""
        reward, social = np.zeros((2, len(which)), np.float32)
        end, over = np.zeros(len(which), bool), np.zeros(len(which), bool)
        outcome = np.full(len(which), "running", dtype="U12")
        for i, index in enumerate(which):
            seen, rewards, ended, truncated, infos = self.environment(index).step(
                {ROBOT: actions[i]}
            )
            self.raw[index] = seen[ROBOT]
            social[i], end[i] = infos[ROBOT]["reward_terms"]["social"], ended[ROBOT]
            reward[i] = rewards[ROBOT] - social[i]
            over[i] = end[i] or truncated[ROBOT]
            outcome[i] = infos[ROBOT]["outcome"]
        self._sense(which)
        return Outcomes(reward, social, end, over, outcome)

    def observation(self, index: int, state: bool = False) -> crowdbench.Observation:
        """What an agent sees in one environment, with the true state for a privileged one."""
        known = self.environment(index).state() if state else None
        return crowdbench.Observation(**self.raw[index], state=known)

    def environment(self, index: int) -> crowdbench.CrowdEnv:
        """The environment of an episode that has begun."""
        environment = self._environments[index]
        assert environment is not None, f"no episode has begun in environment {index}"
        return environment

    def _sense(self, which: NDArray[np.integer]) -> None:
        if not len(which):
            return
        raw = [self.raw[index] for index in which]
        lidar = np.stack([seen["lidar"] for seen in raw])
        pose = np.stack([seen["pose"] for seen in raw])
        self.sensed.map[which] = self._maps.update(lidar, pose, which)
        self.sensed.velocity[which] = np.stack([seen["velocity"] for seen in raw])
        self.sensed.goal[which] = np.stack([seen["goal"] for seen in raw])

    def _release(self, index: int) -> None:
        environment = self._environments[index]
        if environment is not None:
            self._idle[self.scenario[index]].append(environment)
            self._environments[index] = None
