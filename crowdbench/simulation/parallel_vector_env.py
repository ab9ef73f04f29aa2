"""Many environments with several robots at once, in the shape of PettingZoo's parallel ones.

``crowdbench.parallel_vector_env(scenario, num_envs=32, **{"robots.count": 4})`` runs ``num_envs``
lanes, each exactly ``CrowdEnv`` under the same scenario, seed and actions. What PettingZoo gives by
agent is here by agent with a leading axis of lanes, so that one policy can act for all robots of
all lanes (parameter sharing)::

    observations["robot_0"]["lidar"]    (num_envs, beams)
    actions["robot_0"]                  (num_envs, 2)

Robots leave a lane one by one. ``infos[robot]["acted"]`` says in which lanes a robot took part in
the step; elsewhere its reward is 0, its flags are False, its observation is its last one, and its
action is ignored. When the last robot of a lane is gone, or its time is up, the next step begins
the lane's next episode and ignores its actions (Gymnasium's ``NEXT_STEP``). Scenarios, weights and
seeds are as in ``crowdbench.vector_env``. Arrays that are returned are the caller's own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from crowdbench.scenario import Scenario
from crowdbench.simulation.episodes import Episodes, load_all, read_seeds
from crowdbench.simulation.lanes import OUTCOMES, RUNNING, TERMS, TIMEOUT
from crowdbench.simulation.obstacle_map import MapGeometry

_NAMES = np.array(OUTCOMES, dtype=object)
ByRobot = dict[str, Any]


def parallel_vector_env(
    scenario: str | Path | Scenario | Sequence[str | Path | Scenario] = "multimodal_fast",
    num_envs: int = 1,
    weights: Sequence[float] | None = None,
    obstacle_map: MapGeometry | None = None,
    **overrides: Any,
) -> CrowdParallelVectorEnv:
    """Make lanes of one scenario or several, with any number of robots.

    Args:
        scenario: as for ``parallel_env``, or a list of such.
        num_envs: number of lanes.
        weights: how often each scenario is drawn, in any unit; None draws all alike.
        obstacle_map: where the map lies that robots also observe; None: they observe none.
        overrides: scenario fields, nested or dotted, for all scenarios.

    Raises:
        ScenarioError: unknown scenario or field, a value out of range, or scenarios whose robots or
            LiDARs differ.
        ValueError: bad ``num_envs`` or ``weights``.
    """
    return CrowdParallelVectorEnv(scenario, num_envs, weights, obstacle_map, **overrides)


class CrowdParallelVectorEnv:
    """Lanes of several robots; the docstring of this module describes it.

    Attributes:
        num_envs: number of lanes.
        possible_agents: ``robot_0``, ...
        scenarios: that are drawn from.
    """

    metadata = {"name": "crowdbench/crowd-v0", "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | Path | Scenario | Sequence[str | Path | Scenario] = "multimodal_fast",
        num_envs: int = 1,
        weights: Sequence[float] | None = None,
        obstacle_map: MapGeometry | None = None,
        **overrides: Any,
    ) -> None:
        """Make the lanes; arguments as for ``parallel_vector_env``."""
        scenarios = load_all(scenario, overrides)
        self._episodes = Episodes(scenarios, num_envs, weights, obstacle_map)
        self.num_envs, self.scenarios = self._episodes.count, self._episodes.scenarios
        self.possible_agents = list(self._episodes.action_spaces)

    @property
    def weights(self) -> NDArray[np.float64]:
        """(scenarios,) how often each is drawn, as in ``CrowdVectorEnv``."""
        return self._episodes.weights

    @weights.setter
    def weights(self, weights: Sequence[float]) -> None:
        self._episodes.weights = weights

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """A robot's observation space in one lane, always the same object."""
        return self._episodes.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """A robot's action space in one lane, always the same object."""
        return self._episodes.action_spaces[agent]

    def reset(self, seed: int | Sequence[int | None] | None = None) -> tuple[ByRobot, ByRobot]:
        """Begin an episode in every lane.

        Args:
            seed: lane i gets seed + i, or its own of a list; None, there or here, draws the next.

        Returns:
            Observations and infos (``seed`` and ``scenario`` of each lane's episode) by robot.

        Raises:
            ValueError: another number of seeds.
            ScenarioError: a scenario has no room.
            RuntimeError: the environment is closed.
        """
        self._episodes.require_open()
        self._episodes.begin(np.arange(self.num_envs), read_seeds(seed, self.num_envs))
        return self._seen(), {name: self._episode_infos() for name in self.possible_agents}

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[ByRobot, ByRobot, ByRobot, ByRobot, ByRobot]:
        """Advance all lanes by one control period.

        Args:
            actions: (num_envs, 2) by robot; rows of robots that have left a lane are ignored.

        Returns:
            Observations, rewards, terminations, truncations and infos, by robot, of all lanes.
            Infos are ``acted``, ``outcome`` (None where it has not), ``reward_terms``, ``contact``,
            ``seed`` and ``scenario``.

        Raises:
            ValueError: a missing, wrongly shaped or non-finite action, or an unknown robot; the
                message names robot and lane.
            RuntimeError: ``reset`` has not been called, or the environment is closed.
        """
        self._episodes.require_running()
        resting = self._episodes.over.copy()
        lanes = np.flatnonzero(~resting)
        done = self._episodes.step(lanes, self._read_actions(actions, lanes))
        if resting.any():
            self._episodes.begin(np.flatnonzero(resting))
        rewards, ended, late, infos = {}, {}, {}, {}
        for r, name in enumerate(self.possible_agents):
            acted, outcome = self._spread(lanes, done.acted[:, r]), done.outcome[:, r]
            terms = done.terms[:, r]
            rewards[name] = self._spread(lanes, 0.0 + terms[:, 0] + terms[:, 1] + terms[:, 2])
            late[name] = self._spread(lanes, outcome == TIMEOUT)
            ended[name] = self._spread(lanes, (outcome != RUNNING) & (outcome != TIMEOUT))
            told = _NAMES[outcome]
            told[~done.acted[:, r]] = None
            infos[name] = {
                "acted": acted,
                "outcome": self._spread(lanes, told),
                "reward_terms": {
                    term: self._spread(lanes, terms[:, k]) for k, term in enumerate(TERMS)
                },
                "contact": self._spread(lanes, done.contacts[:, r]),
            } | self._episode_infos()
        return self._seen(), rewards, ended, late, infos

    def state(self, lane: int) -> dict[str, NDArray[Any]]:
        """Everything about a lane, as ``CrowdEnv.state()``.

        Raises:
            RuntimeError: ``reset`` has not been called.
        """
        return self._episodes.state(lane)

    def close(self) -> None:
        """Let no more episodes begin nor go on; may be called again."""
        self._episodes.close()

    def _seen(self) -> ByRobot:
        return {name: self._episodes.observations(r) for r, name in enumerate(self.possible_agents)}

    def _episode_infos(self) -> dict[str, Any]:
        return {"seed": self._episodes.seed.copy(), "scenario": self._episodes.scenario.copy()}

    def _spread(self, lanes: NDArray[np.int64], values: NDArray[Any]) -> NDArray[Any]:
        """Values of some lanes (M,) among all; zero, False or None in the others."""
        spread = np.full(self.num_envs, None if values.dtype == object else 0, dtype=values.dtype)
        spread[lanes] = values
        return spread

    def _read_actions(
        self, actions: Mapping[str, Any], lanes: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Commands (M, R, 2) within the drive's bounds."""
        if unknown := [name for name in actions if name not in self.possible_agents]:
            raise ValueError(
                f"action for unknown agent {unknown[0]!r}; known: {self.possible_agents}"
            )
        commands = np.zeros((len(lanes), len(self.possible_agents), 2))
        for r, name in enumerate(self.possible_agents):
            if name not in actions:
                raise ValueError(f"no actions for agent {name!r}")
            whose = f" of agent {name!r}"
            commands[:, r] = self._episodes.read_actions(actions[name], lanes, r, whose)
        return commands
