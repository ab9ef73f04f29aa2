"""What a candidate is scored by, and what has to be known of a model to do so."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple, Protocol

import torch
from crowdbench_agents.learning.config import Planner
from torch import Tensor

Score = Literal["reward_q", "reward", "q"]


class Scoring(NamedTuple):
    """How predicted rewards and values become a return.

    Attributes:
        settings: of which ``values`` and ``return_lambda`` count.
        discount: gamma per step.
        score: which of the predicted terms count.
    """

    settings: Planner
    discount: float
    score: Score = "reward_q"

    def shares(self, horizon: int) -> list[float]:
        """H + 1 shares in a return: of those of k = 0 .. H rewards and the value behind them.

        "final" is the paper's. The others are less exposed to the error of a single value, which
        the best of many candidates would otherwise be chosen for. With "lambda" it is the
        lambda-return (Sutton and Barto, Reinforcement Learning, 2nd edition, section 12.1). Rewards
        alone are always summed up to the horizon.
        """
        decay = self.settings.return_lambda
        if self.settings.values == "final" or self.score == "reward":
            return [0.0] * horizon + [1.0]
        if self.settings.values == "mean":
            return [0.0] + [1 / horizon] * horizon
        return [(1 - decay) * decay**k for k in range(horizon)] + [decay**horizon]


class View(Protocol):
    """The present states of M robots in one view, and what a model predicts from there.

    Actions go in and come out as they are in the world, whatever the view. Rewards and values count
    only as far as the episode is predicted to go on. A value is the smaller of both Qs: of the
    candidate's own action after k < H steps, of the policy's behind the horizon.
    """

    def returns(self, candidates: Tensor) -> Tensor:
        """phi of the paper without the smoothness penalty: (M, N, H, 2) in [-1, 1] -> (M, N)."""

    def follow_policy(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Candidates (M, N, H, 2) of the policy, with noise of that shape, and their returns."""


class Views(Protocol):
    """The present states of M robots in V views; what they predict is as in ``View``."""

    def returns(self, candidates: Tensor) -> Tensor:
        """(M, N, H, 2) -> (V, M, N)."""

    def follow_policy(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Candidates (M, N, H, 2) of the policy, and their mean returns (M, N) over the views.

        Args:
            noise: (M, N, H, 2); each view proposes its share.
        """


class Evaluator(Protocol):
    """Predicts returns with a world model."""

    def views(self, views: Tensor, signs: Tensor, scoring: Scoring) -> Views:
        """The robots' states in all views.

        Args:
            views: (V, M, latent) latent states.
            signs: (V, 2) factors that turn actions of the world as it is into those of each view.
            scoring: what returns are made of.
        """


class ViewByView:
    """``Views`` that are evaluated one after the other.

    Args:
        each: of them.
    """

    def __init__(self, each: Sequence[View]) -> None:
        self._each = each

    def returns(self, candidates: Tensor) -> Tensor:
        """(M, N, H, 2) -> (V, M, N)."""
        return torch.stack([view.returns(candidates) for view in self._each])

    def follow_policy(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Candidates (M, N, H, 2) of the policy, and their mean returns (M, N) over the views."""
        candidates, returns = [], []
        for view, part in zip(self._each, noise.tensor_split(len(self._each), dim=1), strict=True):
            actions, here = view.follow_policy(part)
            elsewhere = [other.returns(actions) for other in self._each if other is not view]
            candidates.append(actions)
            returns.append(torch.stack([here, *elsewhere]).mean(dim=0))
        return torch.cat(candidates, dim=1), torch.cat(returns, dim=1)
