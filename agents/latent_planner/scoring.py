"""What a candidate is scored by, and what has to be known of a model to do so."""

from __future__ import annotations

from typing import Literal, NamedTuple, Protocol

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


class Evaluator(Protocol):
    """Predicts returns with a world model."""

    def view(self, z: Tensor, sign: Tensor, scoring: Scoring) -> View:
        """The view in which the robots' states are z (M, latent).

        Args:
            z: latent states.
            sign: (2,) factors that turn actions of the world as it is into those of the view.
            scoring: what returns are made of.
        """
