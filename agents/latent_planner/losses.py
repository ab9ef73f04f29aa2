"""The losses of the world model and of the policy (paper, section III.B)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from crowdbench_agents.latent_planner.config import Loss
from crowdbench_agents.latent_planner.replay import Batch
from crowdbench_agents.latent_planner.world_model import Inputs, WorldModel
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
    model: WorldModel, target: WorldModel, batch: Batch, loss: Loss, noise: Tensor
) -> ModelLoss:
    """J of the paper: reward, value and consistency losses along a latent rollout, and the end.

    Args:
        model: whose parameters are trained.
        target: theta^-, the slow copy.
        batch: B sequences of H steps.
        loss: weights.
        noise: (H, B, 2) standard normal, for the target policy.
    """
    horizon = len(batch.action)
    with torch.no_grad():
        next_z = target.encode(Inputs(*(x[1:] for x in batch.inputs)))
        next_action, _ = target.sample(next_z, noise)
        next_q = target.q(next_z, next_action).float()
        next_value = next_q.amin(dim=0) if loss.twin_minimum else next_q[0]
        returns = value_targets(batch, next_value, loss.discount, loss.n_step)

    z = model.encode(Inputs(*(x[0] for x in batch.inputs)))
    latents, inconsistency = [z], []
    for t in range(horizon):
        z = model.next(z, batch.action[t]).float()
        inconsistency.append((z - next_z[t]).square().mean(dim=-1))
        latents.append(z)
    states = torch.stack(latents[:-1])

    reward, end = model.reward_and_end(states, batch.action)
    q = model.q(states, batch.action).float()
    decay = loss.horizon_decay ** torch.arange(horizon)[:, None]
    weight = batch.valid * decay
    weight = weight / weight.sum().clamp(min=1.0)
    terms = {
        "reward": ((reward.float() - batch.reward).square() * weight).sum(),
        "value": ((q - returns).square().sum(dim=0) * weight).sum(),
        "consistency": (torch.stack(inconsistency) * weight).sum(),
        "termination": (
            binary_cross_entropy_with_logits(end.float(), batch.end, reduction="none") * weight
        ).sum(),
    }
    total = sum(getattr(loss, name) * term for name, term in terms.items())
    assert isinstance(total, Tensor)
    if loss.imitation_shaping > 0:
        error = (model.act(states) - batch.reference).square().sum(dim=-1)
        total = total + loss.imitation_shaping * (error * batch.has_reference * weight).sum()
    first = latents[0].detach()
    terms["latent_spread"] = first.std(dim=0).mean()
    terms["value_mean"] = (returns * weight).sum()
    return ModelLoss(total, {k: v.detach() for k, v in terms.items()}, states.detach())


def value_targets(batch: Batch, next_value: Tensor, discount: float, steps: int) -> Tensor:
    """r_t + gamma r_{t+1} + ... + gamma^n V(o_{t+n}), (H, B).

    Fewer than n rewards are summed where the sequence or the episode stops earlier. Nothing is
    added behind an arrival or a collision; behind the time limit the value is.

    Args:
        batch: sequences of H steps.
        next_value: (H, B) V(o_{t+1}).
        discount: gamma.
        steps: n.
    """
    goes_on = discount * (1 - batch.end)
    one = batch.reward + goes_on * next_value
    returns = one
    for _ in range(steps - 1):
        later = torch.where(batch.valid[1:] > 0, returns[1:], next_value[:-1])
        returns = torch.cat([batch.reward[:-1] + goes_on[:-1] * later, one[-1:]])
    return returns


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
) -> PolicyLoss:
    """L_pi of the paper: sum of rho^t [alpha log pi - Q / scale + lambda |a - a_reference|^2].

    Args:
        model: of which only the policy is trained here.
        latents: (H, B, latent) states, without gradient.
        batch: the sequences they came from.
        loss: weights.
        alpha: entropy coefficient.
        q_scale: divides Q, so that the weights mean the same at each stage of training.
        noise: (H, B, 2) standard normal.
    """
    action, log_prob = model.sample(latents, noise)
    values = model.q(latents, action).float()
    value = values.amin(dim=0) if loss.twin_minimum else values.mean(dim=0)
    error = (action - batch.reference).square().sum(dim=-1) * batch.has_reference
    decay = loss.horizon_decay ** torch.arange(len(latents))[:, None]
    weight = batch.valid * decay
    weight = weight / weight.sum().clamp(min=1.0)
    imitated = (batch.has_reference * weight).sum()
    each = alpha * log_prob - value / q_scale + loss.imitation * error
    terms = {
        "entropy": (-log_prob * weight).sum().detach(),
        "policy_value": (value * weight).sum().detach(),
        "imitation": (error * weight).sum().detach() / imitated.clamp(min=1e-6),
    }
    return PolicyLoss((each * weight).sum(), terms, value.detach())
