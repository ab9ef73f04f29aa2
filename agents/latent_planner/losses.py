"""The losses of the world model and of the policy (paper, section III.B)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from crowdbench_agents.latent_planner.world_model import WorldModel
from crowdbench_agents.learning.batch import Batch
from crowdbench_agents.learning.config import Loss
from crowdbench_agents.learning.inputs import Inputs
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits


class ModelLoss(NamedTuple):
    """What the world model's loss was made of.

    Attributes:
        total: the weighted sum to be minimised.
        terms: each term before weighting, and the spread of the latent state.
        latents: (H, B, latent) the rollout z_0 .. z_{H-1}, without gradient.
    """

    total: Tensor
    terms: dict[str, Tensor]
    latents: Tensor


def model_loss(
    model: WorldModel,
    target: WorldModel,
    batch: Batch,
    loss: Loss,
    noise: Tensor,
    expert_weight: float = 0.0,
) -> ModelLoss:
    """J of the paper: reward, value and consistency losses along a latent rollout, and the end.

    Observations are encoded, for value targets and consistency, only every ``loss.n_step`` steps:
    encoding is most of the work.

    Args:
        model: whose parameters are trained.
        target: theta^-, the slow copy.
        batch: B sequences of H steps.
        loss: weights.
        noise: (H, B, 2) standard normal, for the target policy.
        expert_weight: present weight of the imitation of the expert.
    """
    horizon = len(batch.action)
    ahead = target_steps(horizon, loss.n_step)
    with torch.no_grad():
        later_z = target.encode(Inputs(*(x[ahead] for x in batch.inputs)))
        later_action, _ = target.sample(later_z, noise[: len(ahead)])
        later_q = target.q(later_z, later_action).float()
        later_value = later_q.amin(dim=0) if loss.twin_minimum else later_q[0]
        returns, known = value_targets(batch, later_value, loss.discount, loss.n_step)

    z = model.encode(Inputs(*(x[0] for x in batch.inputs)))
    latents = [z]
    for t in range(horizon):
        z = model.next(z, batch.action[t]).float()
        latents.append(z)
    states = torch.stack(latents[:-1])
    inconsistency = (torch.stack([latents[t] for t in ahead]) - later_z).square().mean(dim=-1)

    reward, end = model.reward_and_end(states, batch.action)
    q = model.q(states, batch.action).float()
    decay = loss.horizon_decay ** torch.arange(horizon)[:, None]
    weight = _shares(batch.valid * decay)
    last = [t - 1 for t in ahead]
    terms = {
        "reward": ((reward.float() - batch.reward).square() * weight).sum(),
        "value": ((q - returns).square().sum(dim=0) * _shares(known * decay)).sum(),
        "consistency": (inconsistency * _shares((batch.valid * decay)[last])).sum(),
        "termination": (
            binary_cross_entropy_with_logits(end.float(), batch.end, reduction="none") * weight
        ).sum(),
    }
    total = sum(getattr(loss, name) * term for name, term in terms.items())
    assert isinstance(total, Tensor)
    if loss.imitation_shaping > 0:
        error = (model.act(states) - batch.reference).square().sum(dim=-1)
        wanted = loss.imitation * batch.planned + expert_weight * batch.labelled
        total = total + loss.imitation_shaping * (error * wanted * weight).sum()
    first = latents[0].detach()
    terms["latent_spread"] = first.std(dim=0).mean()
    terms["value_mean"] = (returns * weight).sum()
    return ModelLoss(total, {k: v.detach() for k, v in terms.items()}, states.detach())


def target_steps(horizon: int, n_step: int) -> list[int]:
    """Steps of a sequence whose observations are encoded as targets: every n-th and the last."""
    return sorted({*range(n_step, horizon, n_step), horizon})


def value_targets(
    batch: Batch, later_value: Tensor, discount: float, n_step: int
) -> tuple[Tensor, Tensor]:
    """r_t + gamma r_{t+1} + ... + gamma^k V(o_{t+k}), where t + k is the next target step.

    Nothing is added behind an arrival or a collision.

    Args:
        batch: sequences of H steps.
        later_value: (K, B) V at the ``target_steps``.
        discount: gamma.
        n_step: distance of the target steps.

    Returns:
        (H, B) the targets, and (H, B) 1 where there is one: none where the time limit comes
        before the next target step, since no value is known there.
    """
    horizon = len(batch.reward)
    value = dict(zip(target_steps(horizon, n_step), later_value, strict=True))
    returns, known = torch.zeros_like(batch.reward), torch.zeros_like(batch.reward)
    for t in reversed(range(horizon)):
        if t + 1 in value:
            later, there = value[t + 1], torch.ones_like(value[t + 1])
        else:
            later, there = returns[t + 1], known[t + 1]
        returns[t] = batch.reward[t] + discount * (1 - batch.end[t]) * later
        known[t] = batch.valid[t] * torch.maximum(batch.end[t], there)
    return returns, known


def _shares(weight: Tensor) -> Tensor:
    return weight / weight.sum().clamp(min=1.0)


class PolicyLoss(NamedTuple):
    """What the policy's loss was made of.

    Attributes:
        total: to be minimised.
        terms: entropy [nats], value and imitation error.
        values: (H, B) Q of the policy's actions, without gradient, for the running scale.
    """

    total: Tensor
    terms: dict[str, Tensor]
    values: Tensor


def policy_loss(
    model: WorldModel,
    latents: Tensor,
    batch: Batch,
    loss: Loss,
    alpha: float,
    q_scale: float,
    noise: Tensor,
    expert_weight: float = 0.0,
) -> PolicyLoss:
    """L_pi of the paper: sum of rho^t [alpha log pi - Q / scale + lambda |a - a_mppi|^2].

    Expert labels are imitated like MPPI's plans, with a weight of its own.

    Args:
        model: of which only the policy is trained here.
        latents: (H, B, latent) states, without gradient.
        batch: the sequences they came from.
        loss: weights.
        alpha: entropy coefficient.
        q_scale: divides Q, so that the weights mean the same at each stage of training.
        noise: (H, B, 2) standard normal.
        expert_weight: present weight of the imitation of the expert.
    """
    action, log_prob = model.sample(latents, noise)
    values = model.q(latents, action).float()
    value = values.amin(dim=0) if loss.twin_minimum else values.mean(dim=0)
    error = (action - batch.reference).square().sum(dim=-1)
    wanted = loss.imitation * batch.planned + expert_weight * batch.labelled
    decay = loss.horizon_decay ** torch.arange(len(latents))[:, None]
    weight = _shares(batch.valid * decay)
    each = alpha * log_prob - value / q_scale + wanted * error
    terms = {
        "entropy": (-log_prob * weight).sum().detach(),
        "policy_value": (value * weight).sum().detach(),
        "imitation": _mean(error, batch.planned * weight),
        "expert": _mean(error, batch.labelled * weight),
    }
    return PolicyLoss((each * weight).sum(), terms, value.detach())


def _mean(error: Tensor, weight: Tensor) -> Tensor:
    return (error * weight).sum().detach() / weight.sum().clamp(min=1e-6)
