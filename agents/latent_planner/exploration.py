"""Acting while training: the policy or MPPI, random lengths, decaying exploration.

As in the paper, section IV.A: a decision is executed for L ~ Uniform(1, H) steps before the next
one, and with probability epsilon, which falls from 0.5 to 0.05 over the first 25,000 decisions, it
is an exploring one: correlated noise is added to what it does.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from crowdbench_agents.latent_planner.batched import BatchedEvaluator
from crowdbench_agents.latent_planner.mppi import Plan, encode_views, plan
from crowdbench_agents.latent_planner.plan_queue import PlanQueue
from crowdbench_agents.latent_planner.world_model import WorldModel
from crowdbench_agents.learning import kind
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.inputs import ActionBounds, Inputs, Sensed
from crowdbench_agents.learning.kind import Acts
from crowdbench_agents.learning.noise import CorrelatedNoise
from crowdbench_agents.learning.precision import training_precision
from crowdbench_agents.learning.replay import NOBODY, PLANNER
from numpy.typing import NDArray


class Explorer(kind.Explorer):
    """Acts in E environments; MPPI plans in the first ``planning_environments`` of a run's.

    Args:
        model: the world model that is being trained.
        config: all settings.
        bounds: of the robot's actions.
        lanes: (E,) numbers of the environments among all of the run.
        seed: of all randomness in acting.
    """

    def __init__(
        self,
        model: WorldModel,
        config: Config,
        bounds: ActionBounds,
        lanes: NDArray[np.integer],
        seed: int,
    ) -> None:
        self.decisions = 0
        self.rng = np.random.default_rng(seed)
        self.generator = torch.Generator().manual_seed(seed)
        self._model, self._config, self._bounds = model, config, bounds
        self._half = torch.from_numpy(bounds.half)
        count, horizon = len(lanes), config.planner.horizon
        self._evaluator = BatchedEvaluator(model)
        self._queue = PlanQueue(count, horizon)
        self._left = np.zeros(count, np.int64)
        self._exploring = np.zeros(count, bool)
        training = config.training
        self._noise = CorrelatedNoise(
            (count, 2), training.noise, training.noise_correlation, self.rng
        )
        self._last = torch.zeros(count, 2)
        self._planning = lanes < config.training.planning_environments

    @property
    def epsilon(self) -> float:
        """Probability that the next decision explores."""
        training = self._config.training
        done = min(1.0, self.decisions / training.epsilon_decisions)
        return training.epsilon_start + done * (training.epsilon_end - training.epsilon_start)

    def begin(self, which: NDArray[np.integer], velocity: NDArray[np.float32]) -> None:
        """Forget the plans of environments (N,) that begin, at ``velocity`` (N, 2) in [-1, 1]."""
        self._left[which] = 0
        self._queue.clear(which)
        self._last[which] = torch.from_numpy(velocity.astype(np.float32))

    @torch.no_grad()
    def act(self, sensed: Sensed) -> Acts:
        """Decide where a decision is due and return everybody's next action."""
        with training_precision(self._config.training.bfloat16):
            return self._act(sensed)

    @torch.no_grad()
    def plan_again(self, sensed: Sensed) -> NDArray[np.float32]:
        """First actions (M, 2) of plans in M observations, without what was planned before."""
        inputs = Inputs(*map(torch.from_numpy, sensed))
        with training_precision(self._config.training.bfloat16):
            z = self._model.encode(inputs)
            before = torch.from_numpy(self._bounds.normalised(sensed.velocity).astype(np.float32))
            return self._plan(z, inputs, before, None).actions[:, 0].numpy()

    def _plan(
        self, z: torch.Tensor, inputs: Inputs, before: torch.Tensor, start: torch.Tensor | None
    ) -> Plan:
        planner, discount = self._config.planner, self._config.loss.discount
        views = encode_views(self._model, z, inputs, planner)
        return plan(
            self._evaluator, views, before, planner, discount, self._half, self.generator, start
        )

    def _act(self, sensed: Sensed) -> Acts:
        count = len(self._left)
        inputs = Inputs(*map(torch.from_numpy, sensed))
        z = self._model.encode(inputs)
        self._decide(z, inputs)
        noise = torch.randn(count, 2, generator=self.generator)
        drawn = self._model.sample(z, noise)[0].float()
        planning = torch.from_numpy(self._planning)
        just_made = self._queue.taken == 0
        planned = self._queue.take(np.arange(count))
        action = torch.where(planning[:, None], planned, drawn).numpy()
        explored = action + self._noise.step() * self._exploring[:, None]
        executed = np.clip(explored, -1, 1).astype(np.float32)
        self._last = torch.from_numpy(executed)
        # What was planned some steps ago, blind to what has been seen since, is no good example.
        source = np.where(self._planning & just_made, PLANNER, NOBODY).astype(np.uint8)
        self._left -= 1
        return Acts(executed, planned.numpy(), source)

    def _decide(self, z: torch.Tensor, inputs: Inputs) -> None:
        due = np.flatnonzero(self._left <= 0)
        horizon = self._config.planner.horizon
        epsilon = self.epsilon
        self._left[due] = self.rng.integers(1, horizon + 1, size=len(due))
        self._exploring[due] = self.rng.random(len(due)) < epsilon
        self.decisions += len(due)
        due = due[self._planning[due]]
        if len(due):
            seen = Inputs(*(x[due] for x in inputs))
            made = self._plan(z[due], seen, self._last[due], self._queue.rest(due))
            self._queue.put(due, made.actions)

    def state(self) -> dict[str, Any]:
        """Counters and random state."""
        return {
            "decisions": self.decisions,
            "rng": self.rng.bit_generator.state,
            "generator": self.generator.get_state(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from what ``state`` returned."""
        self.decisions = state["decisions"]
        self.rng.bit_generator.state = state["rng"]
        self.generator.set_state(state["generator"])
