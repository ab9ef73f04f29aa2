"""Acting while training: environments, an explorer in them, expert labels, all into the replay."""

from __future__ import annotations

import numpy as np
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.experts import Experts
from crowdbench_agents.learning.kind import Kind
from crowdbench_agents.learning.lanes import Lanes
from crowdbench_agents.learning.replay import EXPERT, PLANNER, Replay
from crowdbench_agents.learning.sampler import ScenarioSampler
from crowdbench_agents.learning.stopwatch import Stopwatch
from crowdbench_agents.learning.worlds import Worlds
from numpy.typing import NDArray
from torch import nn

PLANNED_AT_ONCE = 4
"""States of the past, since planning for several at once takes less time for each."""


class Rollout:
    """Some of a run's environments, stepped together.

    The planner acts in the first environments of a run, the expert labels the last.

    Args:
        kind: of agent.
        network: what it acts by, followed while it is trained.
        config: all settings.
        lanes: (E,) numbers of these environments among all of the run; those of the replay's lanes.
        worlds: in which.
        sampler: of episodes.
        replay: what is driven goes there.
        seed: of exploration.

    Attributes:
        explorer: who acts.
        steps: of environments so far.
        watch: seconds spent on "acting", "expert", "simulation" and "replay".
    """

    def __init__(
        self,
        kind: Kind,
        network: nn.Module,
        config: Config,
        lanes: NDArray[np.integer],
        worlds: Worlds,
        sampler: ScenarioSampler,
        replay: Replay,
        seed: int,
    ) -> None:
        settings = config.training
        self._lanes, self._sampler, self._replay = lanes, sampler, replay
        self._everywhere = np.arange(len(lanes))
        self._envs = Lanes(len(lanes), worlds, sampler, config.perception.geometry)
        unlabelled = settings.environments - settings.labelled_environments
        self._experts = Experts(settings.expert, self._envs, np.flatnonzero(lanes >= unlabelled))
        self.explorer = kind.explorer(network, config, self._envs.bounds, lanes, seed)
        self._config, self._owed = config, 0.0
        self._rng = np.random.default_rng([seed, 4])
        self.steps = 0
        self.watch = Stopwatch()

    def begin(self) -> None:
        """Start an episode in every environment."""
        self._replay.mark_episode_ends(self._lanes)
        self._begin(self._everywhere)

    def step(self) -> None:
        """One control step in every environment."""
        envs, experts, watch = self._envs, self._experts, self.watch
        with watch("acting"):
            acts = self.explorer.act(envs.sensed)
        with watch("expert"):
            acts.reference[experts.which] = experts.labels()
            acts.source[experts.which] = EXPERT
        with watch("simulation"):
            before = envs.sensed
            result = envs.step(envs.bounds.physical(acts.action))
        with watch("replay"):
            self._replay.append_step(
                self._lanes, before, acts.action, result, acts.reference, acts.source, envs.sensed
            )
        self.steps += len(self._lanes)
        over = np.flatnonzero(result.over)
        for index in over:
            self._sampler.record(envs.scenario[index], result.outcome[index] == "success")
        if len(over):
            self._begin(over)
        self._replan()

    def _replan(self) -> None:
        """Plan again in some of what has been seen before (BMPC's lazy reanalysis)."""
        settings = self._config.training
        # Of the states that are planned again for all environments together, the share of these.
        self._owed += settings.replanned_states * len(self._lanes) / settings.environments
        if self._owed < PLANNED_AT_ONCE:
            return
        count = int(self._owed)
        self._owed -= count
        with self.watch("acting"):
            which, sensed = self._replay.draw_observations(self._lanes, count, self._rng)
            plans = self.explorer.plan_again(sensed) if len(which) else None
        if plans is not None:
            self._replay.replace_references(which, plans, PLANNER)

    def _begin(self, which: NDArray[np.integer]) -> None:
        envs = self._envs
        with self.watch("simulation"):
            envs.begin(which)
        with self.watch("expert"):
            self._experts.begin(which)
        self.explorer.begin(which, envs.bounds.normalised(envs.sensed.velocity[which]))
