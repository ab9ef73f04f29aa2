"""Returns of candidates, plain form: the world model called step by step, for several robots."""

from __future__ import annotations

import torch
from crowdbench_agents.latent_planner.scoring import Scoring, ViewByView
from crowdbench_agents.latent_planner.world_model import WorldModel
from torch import Tensor


class PlainEvaluator:
    """An ``Evaluator`` for any number of robots; follows the model while it is trained.

    Args:
        model: the world model.
    """

    def __init__(self, model: WorldModel) -> None:
        self._model = model

    def views(self, views: Tensor, signs: Tensor, scoring: Scoring) -> ViewByView:
        """The states (V, M, latent) in all views."""
        each = zip(views, signs, strict=True)
        return ViewByView([self.view(z, sign, scoring) for z, sign in each])

    def view(self, z: Tensor, sign: Tensor, scoring: Scoring) -> PlainView:
        """The view in which the robots' states are z (M, latent)."""
        return PlainView(self._model, z, sign, scoring)


class PlainView:
    """A ``View``: predictions from states z (M, latent), by the module's own functions."""

    def __init__(self, model: WorldModel, z: Tensor, sign: Tensor, scoring: Scoring) -> None:
        self._model, self._z, self._sign, self._scoring = model, z, sign, scoring

    def returns(self, candidates: Tensor) -> Tensor:
        """(M, N, H, 2) -> (M, N)."""
        return self._evaluate(self._sign * candidates)

    def follow_policy(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Candidates (M, N, H, 2) of the policy and their returns (M, N)."""
        model, z, actions = self._model, self._start(noise.shape[1]), []
        for t in range(noise.shape[2]):
            action, _ = model.sample(z, noise[:, :, t])
            actions.append(action)
            z = model.next(z, action)
        candidates = torch.stack(actions, dim=2)
        return self._sign * candidates, self._evaluate(candidates)

    def _start(self, count: int) -> Tensor:
        return self._z[:, None].expand(-1, count, -1)

    def _evaluate(self, candidates: Tensor) -> Tensor:
        """Returns (M, N) of actions (M, N, H, 2) of this view."""
        model, discount, score = self._model, self._scoring.discount, self._scoring.score
        robots, count, horizon, _ = candidates.shape
        shares = self._scoring.shares(horizon)
        z = self._start(count)
        total, result = torch.zeros(2, robots, count)
        weight = torch.ones(robots, count)
        for t in range(horizon):
            action = candidates[:, :, t]
            if shares[t] > 0:
                result += shares[t] * (total + weight * model.q(z, action).float().amin(dim=0))
            if score != "q":
                reward, end = model.reward_and_end(z, action)
                total = total + weight * reward.float()
                weight = weight * discount * torch.sigmoid(-end.float())
            z = model.next(z, action)
        if score != "reward":
            total = total + weight * model.q(z, model.act(z)).float().amin(dim=0)
        return result + shares[horizon] * total
