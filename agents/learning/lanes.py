"""Lanes of ``crowdbench.vector_env`` whose episodes are chosen one by one, as training needs it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from crowdbench_agents.geometry.under_way import foresee
from crowdbench_agents.learning.inputs import ActionBounds, Sensed
from crowdbench_agents.learning.worlds import Worlds
from numpy.typing import NDArray

import crowdbench


class Outcomes(NamedTuple):
    """What one step did in E lanes; nothing where no episode is running.

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
    outcome: NDArray[np.object_]


class Lanes:
    """E lanes, each with an episode of its own; none begins by itself.

    Args:
        count: E.
        worlds: that episodes may be in; of several variants the seed says which.
        episodes: yields the (scenario name, seed) of each episode to come.
        geometry: of the obstacle maps.

    Attributes:
        env: the vector environment.
        bounds: of the robot's actions.
        sensed: what networks see of the latest observations, from where the robots will be when
            their next actions begin to act.
        seen: its latest observations, which later steps do not change.
        scenario: (E,) names of the present episodes' scenarios.
    """

    def __init__(
        self,
        count: int,
        worlds: Worlds,
        episodes: Iterator[tuple[str, int]],
        geometry: crowdbench.MapGeometry,
    ) -> None:
        scenarios = [variant for variants in worlds.values() for variant in variants]
        self.env = crowdbench.vector_env(
            scenarios, count, autoreset_mode="Disabled", obstacle_map=geometry
        )
        self._robots = [crowdbench.RobotSpec.from_scenario(one) for one in self.env.scenarios]
        self.bounds = ActionBounds.of(self.env.robot)
        self.scenario = np.full(count, None, dtype=object)
        self._under_way = np.zeros((count, self.env.robot.latency, 2))
        counts = [len(variants) for variants in worlds.values()]
        firsts = np.cumsum([0, *counts])[:-1].tolist()
        self._variants = dict(zip(worlds, zip(firsts, counts, strict=True), strict=True))
        self._episodes = episodes
        self._place = np.zeros(count, np.int64)

    def __len__(self) -> int:
        """E."""
        return self.env.num_envs

    def begin(self, which: NDArray[np.integer]) -> NDArray[np.integer]:
        """Begin the next episode in lanes (N,), all of them at first.

        Returns:
            Those in which one began, fewer when no episodes are left.
        """
        chosen = list(zip(which, self._episodes, strict=False))
        if not chosen:
            return which[:0]
        begun = which[: len(chosen)]
        mask = np.zeros(len(self), bool)
        mask[begun] = True
        seeds: list[int | None] = [None] * len(self)
        for lane, (name, seed) in chosen:
            self._choose(lane, name, seed, seeds)
        options = {"reset_mask": mask, "scenario": self._place}
        while True:
            try:
                self.seen, _ = self.env.reset(seed=seeds, options=options)
                break
            except crowdbench.NoRoomError as error:  # rare, in a variant with more people
                if (other := next(self._episodes, None)) is None:
                    raise
                self._choose(seeds.index(error.seed), *other, seeds)
        self._under_way[begun] = 0.0
        self.sensed = self._sense()
        return begun

    def _choose(self, lane: int, name: str, seed: int, seeds: list[int | None]) -> None:
        first, variants = self._variants[name]
        self.scenario[lane], seeds[lane] = name, seed
        self._place[lane] = first + seed % variants

    def step(self, actions: NDArray[np.floating]) -> Outcomes:
        """Act in every lane with v [m/s], w [rad/s] (E, 2)."""
        self.seen, total, end, late, infos = self.env.step(actions)
        told = np.clip(actions, *np.array([self.env.robot.speed, self.env.robot.turn_rate]).T)
        self._under_way = np.concatenate([self._under_way, told[:, None]], axis=1)[:, 1:]
        self.sensed = self._sense()
        social = infos["reward_terms"]["social"].astype(np.float32)
        reward = total.astype(np.float32) - social
        return Outcomes(reward, social, end, end | late, infos["outcome"])

    def _sense(self) -> Sensed:
        velocity, goal = self.seen["velocity"], self.seen["goal"]
        if self.env.robot.latency:
            velocity, goal = velocity.copy(), goal.copy()
            # Scenarios may differ in the control period.
            for place in np.unique(self._place):
                one = self._place == place
                velocity[one], goal[one] = foresee(
                    self._robots[place],
                    self.seen["pose"][one],
                    velocity[one],
                    goal[one],
                    self._under_way[one],
                )[1:]
        return Sensed(self.seen["map"], velocity, goal)

    def robot(self, lane: int) -> crowdbench.RobotSpec:
        """What a planner may know about the robot in a lane."""
        return self._robots[self._place[lane]]

    def observation(self, lane: int) -> crowdbench.Observation:
        """What an agent sees in a lane, with the true state for a privileged one."""
        seen = {name: self.seen[name][lane] for name in ("lidar", "velocity", "goal", "pose")}
        return crowdbench.Observation(**seen, state=self.env.state(lane))
