"""Soft Actor-Critic: one update of critic, actor and entropy coefficient.

Haarnoja et al., "Soft Actor-Critic algorithms and applications" (2018): twin critics with slow
targets, and the entropy coefficient alpha tuned so that the policy keeps a wanted entropy. Returns
have several steps, and the actor also imitates the expert where it labelled.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from crowdbench_agents.learning import kind
from crowdbench_agents.learning.batch import Batch
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.inputs import ACTION, Inputs
from crowdbench_agents.learning.validation import Act, PolicyInput
from crowdbench_agents.sac.networks import Critic, Policy, encode, make_policy
from numpy.typing import NDArray
from torch import Tensor

BATCH = 256
CPU = torch.device("cpu")


class Transitions(NamedTuple):
    """B transitions of up to n steps.

    Attributes:
        inputs, action: observations and what was done, in [-1, 1].
        returns: (B,) discounted sum of the rewards on the way.
        discount: (B,) gamma to the number of steps, 0 where the episode ended by them.
        later: observations behind the steps.
    """

    inputs: Inputs
    action: Tensor
    returns: Tensor
    discount: Tensor
    later: Inputs


def transitions(batch: Batch, discount: float) -> Transitions:
    """Sum the rewards of sequences up to their ends, as the latent planner's value targets do.

    At the time limit a transition is shorter and its value goes on: nothing has ended.
    """
    powers = discount ** torch.arange(len(batch.reward), device=batch.reward.device)[:, None]
    length = batch.valid.sum(dim=0).long()
    columns = torch.arange(len(length), device=length.device)
    ended = (batch.end * batch.valid).amax(dim=0)
    return Transitions(
        inputs=Inputs(*(x[0] for x in batch.inputs)),
        action=batch.action[0],
        returns=(batch.reward * batch.valid * powers).sum(dim=0),
        discount=discount**length * (1 - ended),
        later=Inputs(*(x[length, columns] for x in batch.inputs)),
    )


class Learner(kind.Learner):
    """Trains an actor and its critics.

    Args:
        config: all settings.
        seed: of the initial parameters and of the noise in the losses.
        device: where the networks are trained.
    """

    count = BATCH

    def __init__(self, config: Config, seed: int, device: torch.device = CPU) -> None:
        super().__init__(config, seed, device)
        self.horizon = config.loss.n_step
        self.network = self.actor = make_policy(config).to(device)
        self.critic = Critic(config.perception.cells, config.model).to(device)
        self.target = copy.deepcopy(self.critic).requires_grad_(False)
        wanted = config.loss.entropy_target
        self._wanted_entropy = -float(ACTION) if wanted is None else wanted
        self._parameters: dict[str, list[Tensor]] = {
            "critic": list(self.critic.parameters()),
            "actor": list(self.actor.parameters()),
            "alpha": [self.log_alpha],
        }
        optimizers = {
            name: torch.optim.Adam(parameters, lr=config.training.learning_rate, fused=True)
            for name, parameters in self._parameters.items()
        }
        networks = {"actor": self.actor, "critic": self.critic, "target": self.target}
        self._learn(networks, optimizers)

    def update(self, batch: Batch) -> dict[str, Tensor]:
        """One step of the critic, the actor and the entropy coefficient.

        Args:
            batch: sequences with unscaled rewards.

        Returns:
            The losses and their terms, for the log.
        """
        self._set_learning_rates()
        config, alpha = self.config, self.log_alpha.detach().exp()
        batch = batch._replace(reward=batch.reward * config.training.reward_scale)
        batch = batch.to(self.device)
        seen, taken, returns, discount, later = transitions(batch, config.loss.discount)
        noise = self._noise(2, *taken.shape)

        # Q(o, a) against r + gamma^n (min Q'(o', a') - alpha log pi(a')).
        with self.watch("critic"):
            with torch.no_grad():
                next_action, next_log_prob = self._draw(later, noise[1])
                next_q = self.target(self._features(self.target, later), next_action).amin(dim=0)
                target = returns + discount * (next_q - alpha * next_log_prob)
            q = self.critic(self._features(self.critic, seen), taken)
            critic_loss = 0.5 * (q - target).square().mean(dim=1).sum()
            self._step("critic", critic_loss)

        # alpha log pi(a) - min Q(o, a), and the distance of a from the expert's action.
        with self.watch("actor"):
            action, log_prob = self._draw(seen, noise[0])
            with torch.no_grad():
                features = self._features(self.critic, seen)
            value = self.critic(features, action).amin(dim=0)
            error = (action - batch.reference[0]).square().sum(dim=-1) * batch.labelled[0]
            imitation = config.expert_weight(self.updates) * error
            actor_loss = (alpha * log_prob - value + imitation).mean()
            self._step("actor", actor_loss)

        # More alpha where the entropy is below the wanted one.
        entropy = -log_prob.detach().mean()
        self._step("alpha", self.log_alpha * (entropy - self._wanted_entropy))
        self._update_target(self.target, self.critic)
        self.updates += 1
        labelled = batch.labelled[0].sum().clamp(min=1.0)
        terms = {
            "critic": critic_loss, "actor": actor_loss, "entropy": entropy,
            "value_mean": target.mean(), "expert": error.sum() / labelled,
        }  # fmt: skip
        return {name: value.detach() for name, value in terms.items()}

    def check(self, terms: Mapping[str, float]) -> None:
        """Stop a training that has diverged.

        Args:
            terms: means of what ``update`` returned.

        Raises:
            TrainingError: one of them is not finite.
        """
        for name, value in terms.items():
            if not math.isfinite(value):
                raise TrainingError(
                    f"{name} is {value} after {self.updates} updates; lower the learning rate "
                    "and resume from the last checkpoint"
                )

    def scalars(self) -> dict[str, float]:
        """The entropy coefficient."""
        return {"alpha": self.alpha}

    def policy(self) -> Act:
        """Act by the mean of the present actor."""

        @torch.no_grad()
        def act(given: PolicyInput) -> NDArray[np.float32]:
            inputs = Inputs(*(torch.from_numpy(x).to(self.device) for x in given.sensed))
            return self.actor(inputs).cpu().numpy()

        return act

    def tensors(self) -> dict[str, Tensor]:
        """The parameters of what acts."""
        return self.actor.tensors()

    def _draw(self, inputs: Inputs, noise: Tensor) -> tuple[Tensor, Tensor]:
        return self.actor.sample(self._features(self.actor, inputs), noise)

    def _features(self, network: Policy | Critic, inputs: Inputs) -> Tensor:
        return encode(network.encoder, inputs, self.config.training.bfloat16)

    def _step(self, name: str, loss: Tensor) -> None:
        """One step of one optimiser, by the gradient of its own parameters alone."""
        optimizer = self._optimizers[name]
        optimizer.zero_grad()
        loss.backward(inputs=self._parameters[name])
        optimizer.step()
