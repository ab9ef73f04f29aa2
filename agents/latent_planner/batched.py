"""Returns of candidates, batched form: many robots in all views at once, while a model is trained.

The returns are those of ``plain`` up to rounding, for less work:

- the views of a robot are evaluated together, as if they were further robots;
- all candidates of a view start from the same z, so its part of the first layers is computed once;
- the first layers of all networks that see z and a are one product;
- the policy's candidates get their returns while they are made.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import torch
from crowdbench_agents.latent_planner.scoring import Scoring
from crowdbench_agents.latent_planner.world_model import Mlp, WorldModel
from crowdbench_agents.learning.inputs import ACTION
from torch import Tensor, nn
from torch.nn.functional import linear, pad

Act = Callable[[int, Tensor], Tensor]
"""Actions (R, N, 2) at step t of candidates in states z (R, N, latent)."""


class BatchedEvaluator:
    """An ``Evaluator`` for any number of robots; follows the model while it is trained.

    Args:
        model: the world model.
    """

    def __init__(self, model: WorldModel) -> None:
        self._model = model

    def views(self, views: Tensor, signs: Tensor, scoring: Scoring) -> BatchedViews:
        """The robots' states (V, M, latent) in all views."""
        return BatchedViews(self._model, views, signs, scoring)


class BatchedViews:
    """``Views`` whose V x M states are evaluated together."""

    def __init__(self, model: WorldModel, views: Tensor, signs: Tensor, scoring: Scoring) -> None:
        self._model, self._scoring = model, scoring
        self._count = len(views)
        self._z = views.flatten(0, 1)[:, None]
        self._sign = signs[:, None, None, None]
        networks = [model.dynamics, model.outcome, *model.q_networks]
        first = [_linear(network[0]) for network in networks]
        weight = torch.cat([layer.weight for layer in first])
        self._for_z, self._for_action = weight[:, :-ACTION], weight[:, -ACTION:]
        self._bias = torch.cat([layer.bias for layer in first])
        self._sizes = [layer.out_features for layer in first]
        self._start = linear(self._z, self._for_z, self._bias)

    def returns(self, candidates: Tensor) -> Tensor:
        """(M, N, H, 2) -> (V, M, N)."""
        return self._returns((self._sign * candidates).flatten(0, 1))

    def follow_policy(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """The policy's candidates, a share of them in each view, and their mean returns.

        Args:
            noise: (M, N, H, 2).

        Returns:
            Candidates (M, N, H, 2) and returns (M, N).
        """
        robots, count, horizon, _ = noise.shape
        each = -(-count // self._count)
        even = pad(noise, (0, 0, 0, 0, 0, each * self._count - count))
        part = torch.cat(even.split(each, dim=1))
        actions = torch.empty_like(part)

        def act(t: int, z: Tensor) -> Tensor:
            actions[:, :, t] = self._model.sample(z, part[:, :, t])[0]
            return actions[:, :, t]

        returns = self._roll(act, each, horizon).unflatten(0, (self._count, robots))
        candidates = self._sign * actions.unflatten(0, (self._count, robots))
        for turn in range(1, self._count):
            turned = self._returns((self._sign * candidates.roll(turn, 0)).flatten(0, 1))
            returns = returns + turned.roll(-turn, 0)
        # what the views propose side by side, without what was added to make their shares even
        together = candidates.transpose(0, 1).flatten(1, 2), returns.transpose(0, 1).flatten(1, 2)
        return together[0][:, :count], together[1][:, :count] / self._count

    def _returns(self, actions: Tensor) -> Tensor:
        """(V M, N, H, 2) of the views -> (V, M, N)."""
        _, count, horizon, _ = actions.shape
        result = self._roll(lambda t, z: actions[:, :, t], count, horizon)
        return result.unflatten(0, (self._count, -1))

    def _roll(self, act: Act, count: int, horizon: int) -> Tensor:
        """Returns (V M, N) of N = ``count`` candidates."""
        model, discount, score = self._model, self._scoring.discount, self._scoring.score
        shares = self._scoring.shares(horizon)
        z = self._z.expand(-1, count, -1)
        total, result = torch.zeros(2, *z.shape[:2])
        weight = torch.ones(z.shape[:2])
        for t in range(horizon):
            action = act(t, z)
            of_z = self._start if t == 0 else linear(z, self._for_z, self._bias)
            joint = of_z + linear(action, self._for_action)
            dynamics, outcome, *q = joint.split(self._sizes, dim=-1)
            if shares[t] > 0:
                result += shares[t] * (total + weight * self._value(q))
            if score != "q":
                reward, end = model.outcome.behind_first(outcome).unbind(dim=-1)
                total = total + weight * reward
                weight = weight * discount * torch.sigmoid(-end)
            if t + 1 < horizon or score != "reward":
                z = model.advance(z, model.dynamics.behind_first(dynamics)).float()
        if score != "reward":
            total = total + weight * model.q(z, model.act(z)).float().amin(dim=0)
        return result + shares[horizon] * total

    def _value(self, first: Sequence[Tensor]) -> Tensor:
        """The smaller Q for what the first layers return."""
        networks = zip(self._model.q_networks, first, strict=True)
        one, two = (cast(Mlp, network).behind_first(x).squeeze(-1) for network, x in networks)
        return torch.minimum(one, two)


def _linear(layer: nn.Module) -> nn.Linear:
    assert isinstance(layer, nn.Linear)
    return layer
