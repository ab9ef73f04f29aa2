"""MPPI in latent space (paper, section III.C), plain form, for several robots at once.

Candidate action sequences are drawn from a time-dependent Gaussian and from the policy, rolled
out with the world model, scored by predicted rewards, a final Q and a smoothness penalty, and the
best of them move the Gaussian.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from crowdbench_agents.latent_planner.world_model import WorldModel
from crowdbench_agents.learning.config import Planner
from crowdbench_agents.learning.inputs import ACTION, REFLECT, Inputs
from torch import Tensor

Score = Literal["reward_q", "reward", "q"]


class Plan(NamedTuple):
    """The outcome of planning for M robots.

    Attributes:
        actions: (M, H, 2) planned actions in [-1, 1], the Gaussian's final mean.
        std: (M, H, 2) the Gaussian's final standard deviation.
        score: (M,) of the best candidate in the last iteration.
    """

    actions: Tensor
    std: Tensor
    score: Tensor


@torch.no_grad()
def encode_views(model: WorldModel, z: Tensor, inputs: Inputs, settings: Planner) -> Tensor:
    """Views (V, M, latent) of the present to plan from, for inputs (M, ...) encoded as z.

    With ``settings.reflect`` the second is what the world looks like with left and right swapped.
    It is the same world, so where the model values an action differently in it, that is an error of
    the model; the mean of both has less of it.
    """
    if not settings.reflect:
        return z[None]
    return torch.stack([z, model.encode(inputs.reflected())])


def view_signs(views: Tensor) -> Tensor:
    """(V, 2) factors that turn actions of the world as it is into those of each view."""
    return torch.stack([torch.ones(ACTION), REFLECT])[: len(views)]


@torch.no_grad()
def plan(
    model: WorldModel,
    views: Tensor,
    previous: Tensor,
    settings: Planner,
    discount: float,
    half_range: Tensor,
    generator: torch.Generator,
    warm_start: Tensor | None = None,
    score: Score = "reward_q",
) -> Plan:
    """Optimise action sequences for M robots.

    Args:
        model: the world model.
        views: (V, M, latent) current latent states, as from ``encode_views``. Each view gives its
            share of the policy's candidates, and a score is the mean of what it is in each view.
        previous: (M, 2) the actions executed last, in [-1, 1].
        settings: horizon H, candidates (constant actions come on top), elites, iterations, weights.
        discount: gamma per step.
        half_range: (2,) half the range of v [m/s] and w [rad/s]: converts changes to physical ones.
        generator: of all noise.
        warm_start: (M, H, 2) the previous plan moved on by what was executed; with
            ``settings.start`` "policy" and some candidates from the policy it is not used.
        score: which of the predicted terms count.
    """
    robots, horizon, sign = views.shape[1], settings.horizon, view_signs(views)
    guided = round(settings.policy_share * settings.candidates)
    free = settings.candidates - guided
    mean = torch.zeros(robots, horizon, ACTION) if warm_start is None else warm_start
    std = torch.full_like(mean, settings.max_std)

    def draw(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    from_policy = []
    noises = draw(robots, guided, horizon, ACTION).tensor_split(len(views), dim=1)
    for view, flip, noise in zip(views, sign, noises, strict=True):
        if settings.start == "policy":
            noise[:, :1] = 0.0
        from_policy.append(flip * policy_rollouts(model, view, noise))
    from_policy = torch.cat(from_policy, dim=1)
    if settings.start == "policy" and guided:
        mean = from_policy[:, 0]
    fixed = torch.cat([from_policy, constant_actions(settings).expand(robots, -1, -1, -1)], dim=1)
    for _ in range(settings.iterations):
        sampled = mean[:, None] + std[:, None] * draw(robots, free, horizon, ACTION)
        candidates = torch.cat([fixed, sampled.clamp(-1, 1)], dim=1)
        options = settings, discount, half_range, score
        seen = [
            evaluate(model, view, flip * candidates, flip * previous, *options)
            for view, flip in zip(views, sign, strict=True)
        ]
        scores = torch.stack(seen).mean(dim=0)
        mean, std, best = refit(candidates, scores, settings)
    return Plan(mean, std, best)


def refit(candidates: Tensor, scores: Tensor, settings: Planner) -> Plan:
    """Move the Gaussian to the elites, weighted by exp(score / temperature).

    Args:
        candidates: (M, N, H, 2) in [-1, 1].
        scores: (M, N) phi.
        settings: elites, temperature and limits of the standard deviation.
    """
    best, indices = scores.topk(min(settings.elites, scores.shape[1]), dim=1)
    elites = candidates.gather(1, indices[..., None, None].expand(-1, -1, *candidates.shape[2:]))
    weights = torch.softmax(best / settings.temperature, dim=1)[..., None, None]
    mean = (weights * elites).sum(dim=1)
    variance = (weights * (elites - mean[:, None]).square()).sum(dim=1)
    std = variance.sqrt().clamp(settings.min_std, settings.max_std)
    return Plan(mean, std, best[:, 0])


@torch.no_grad()
def evaluate(
    model: WorldModel,
    z: Tensor,
    candidates: Tensor,
    previous: Tensor,
    settings: Planner,
    discount: float,
    half_range: Tensor,
    score: Score = "reward_q",
) -> Tensor:
    """phi of the paper for candidates (M, N, H, 2) from states z (M, latent): (M, N).

    Rewards and values count only as far as the episode is predicted to go on. A value is the
    smaller of both Qs: of the candidate's own action after k < H steps, of the policy's behind the
    horizon.
    """
    robots, count, horizon, _ = candidates.shape
    shares = value_shares(settings, horizon, score)
    z = z[:, None].expand(-1, count, -1)
    total = torch.zeros(robots, count)
    weight = torch.ones(robots, count)
    result = torch.zeros(robots, count)
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
    result += shares[horizon] * total
    return result - settings.smoothness_weight * smoothness_penalty(
        candidates, previous, half_range
    )


def value_shares(settings: Planner, horizon: int, score: Score) -> list[float]:
    """H + 1 shares in the score: of the returns of k = 0 .. H rewards and the value behind them.

    "final" is the paper's. The others are less exposed to the error of a single value, which the
    best of many candidates would otherwise be chosen for. With "lambda" the score is the
    lambda-return (Sutton and Barto, Reinforcement Learning, 2nd edition, section 12.1). Rewards
    alone are always summed up to the horizon.
    """
    decay = settings.return_lambda
    if settings.values == "final" or score == "reward":
        return [0.0] * horizon + [1.0]
    if settings.values == "mean":
        return [0.0] + [1 / horizon] * horizon
    return [(1 - decay) * decay**k for k in range(horizon)] + [decay**horizon]


def constant_actions(settings: Planner) -> Tensor:
    """Action sequences (A, H, 2) that keep to one action, on an even grid over [-1, 1]^2.

    They lie where neither the policy nor noise around its plan gets: the policy follows the slope
    of Q to the nearest maximum, and ways around somebody have several.
    """
    if settings.constant_actions is None:
        return torch.zeros(0, settings.horizon, ACTION)
    speeds, rates = (torch.linspace(-1, 1, count) for count in settings.constant_actions)
    return torch.cartesian_prod(speeds, rates)[:, None].expand(-1, settings.horizon, -1)


def smoothness_penalty(candidates: Tensor, previous: Tensor, half_range: Tensor) -> Tensor:
    """P of the paper: sum over time of the squared change of (v [m/s], w [rad/s]).

    Args:
        candidates: (M, N, H, 2) in [-1, 1].
        previous: (M, 2) the actions before the first, in [-1, 1].
        half_range: (2,) physical size of a change by one.
    """
    before = torch.cat([previous[:, None, None].expand_as(candidates[:, :, :1]), candidates], dim=2)
    return (before.diff(dim=2) * half_range).square().sum(dim=(2, 3))


def policy_rollouts(model: WorldModel, z: Tensor, noise: Tensor) -> Tensor:
    """Action sequences (M, N, H, 2) of the policy from states z, noise of that shape."""
    z = z[:, None].expand(-1, noise.shape[1], -1)
    actions = []
    for t in range(noise.shape[2]):
        action, _ = model.sample(z, noise[:, :, t])
        actions.append(action)
        z = model.next(z, action)
    return torch.stack(actions, dim=2)
