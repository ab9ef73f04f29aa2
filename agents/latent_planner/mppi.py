"""MPPI in latent space (paper, section III.C), for several robots at once.

Candidate action sequences are drawn from a time-dependent Gaussian and from the policy, scored by
the returns that a model predicts for them and a smoothness penalty, and the best of them move the
Gaussian. Who predicts the returns is an ``Evaluator``.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from crowdbench_agents.latent_planner.scoring import Evaluator, Score, Scoring
from crowdbench_agents.latent_planner.world_model import WorldModel
from crowdbench_agents.learning.config import Planner
from crowdbench_agents.learning.inputs import ACTION, REFLECT, Inputs
from torch import Tensor


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
    evaluator: Evaluator,
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
        evaluator: of the world model.
        views: (V, M, latent) current latent states, as from ``encode_views``. Each view gives its
            share of the policy's candidates, and a score is the mean of what it is in each view.
        previous: (M, 2) the actions executed last, in [-1, 1].
        settings: horizon H, candidates (constant actions come on top), elites, iterations, weights.
        discount: gamma per step.
        half_range: (2,) half the range of v [m/s] and w [rad/s]: converts changes to physical ones.
        generator: of all noise.
        warm_start: (M, H, 2) the previous plan moved on by what was executed, zero by default; with
            ``settings.start`` "policy" and some candidates from the policy it is not used.
        score: which of the predicted terms count.
    """
    robots, horizon = views.shape[1], settings.horizon
    scoring = Scoring(settings, discount, score)
    seen = evaluator.views(views, view_signs(views), scoring)

    def penalty(candidates: Tensor) -> Tensor:
        return settings.smoothness_weight * smoothness_penalty(candidates, previous, half_range)

    def draw(count: int) -> Tensor:
        return torch.randn(robots, count, horizon, ACTION, generator=generator)

    guided = round(settings.policy_share * settings.candidates)
    from_policy_first = settings.start == "policy"
    # What the policy proposes stays the same over the iterations and is scored once.
    noise = draw(guided)
    if from_policy_first:
        for part in noise.tensor_split(len(views), dim=1):
            part[:, :1] = 0.0
    known, returns = seen.follow_policy(noise)
    scores = returns - penalty(known)
    if from_policy_first and guided:
        mean = known[:, 0]
    else:
        mean = torch.zeros(robots, horizon, ACTION) if warm_start is None else warm_start
    std = torch.full_like(mean, settings.max_std)
    # So do constant actions; they are scored beside the first candidates drawn.
    unscored = constant_actions(settings).expand(robots, -1, -1, -1)
    for _ in range(settings.iterations):
        sampled = mean[:, None] + std[:, None] * draw(settings.candidates - guided)
        fresh = torch.cat([unscored, sampled.clamp(-1, 1)], dim=1)
        candidates = torch.cat([known, fresh], dim=1)
        fresh_scores = seen.returns(fresh).mean(dim=0)
        all_scores = torch.cat([scores, fresh_scores - penalty(fresh)], dim=1)
        mean, std, best = refit(candidates, all_scores, settings)
        kept = known.shape[1] + unscored.shape[1]
        known, scores = candidates[:, :kept], all_scores[:, :kept]
        unscored = unscored[:, :0]
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
