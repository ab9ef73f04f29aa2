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


class Targets(NamedTuple):
    """What the slow networks make of later observations.

    Attributes:
        z: (K, B, latent) of the ``target_steps``.
        returns: (H, B) targets of Q.
        known: (H, B) 1 where there is one.
    """

    z: Tensor
    returns: Tensor
    known: Tensor


class ModelLoss(NamedTuple):
    """What the world model's loss was made of.

    Attributes:
        total: the weighted sum to be minimised.
        terms: each term before weighting, and the spread of the latent state.
        states: (H, B, latent) the rollout z_0 .. z_{H-1}, without gradient.
        policy: mean and log standard deviation of the policy in these, (H, B, 2) each, with
            gradient.
    """

    total: Tensor
    terms: dict[str, Tensor]
    states: Tensor
    policy: tuple[Tensor, Tensor]


@torch.no_grad()
def encode_targets(target: WorldModel, batch: Batch, loss: Loss, noise: Tensor) -> Targets:
    """Encode later observations, and what they are worth.

    Observations are encoded, for value targets and consistency, only every ``loss.n_step`` steps:
    encoding is most of the work. On a CPU those behind the end of an episode are left out, and both
    are 0 there: they count for nothing.

    Args:
        target: theta^-, the slow copy.
        batch: B sequences of H steps.
        loss: weights.
        noise: (H, B, 2) standard normal, for the target policy.
    """
    ahead = target_steps(len(batch.action), loss.n_step)
    inputs, noise = Inputs(*(x[ahead] for x in batch.inputs)), noise[: len(ahead)]
    if noise.device.type == "cpu":
        counts = batch.valid[[t - 1 for t in ahead]] > 0
        found = _encode_and_value(
            target, Inputs(*(x[counts] for x in inputs)), noise[counts], loss.twin_minimum
        )
        z, value = (x.new_zeros(counts.shape + x.shape[1:]) for x in found)
        z[counts], value[counts] = found
    else:  # where the learner would have to wait to know how many there are
        z, value = _encode_and_value(target, inputs, noise, loss.twin_minimum)
    return Targets(z, *value_targets(batch, value, loss.discount, loss.n_step))


def _encode_and_value(
    target: WorldModel, inputs: Inputs, noise: Tensor, twin_minimum: bool
) -> tuple[Tensor, Tensor]:
    """z (..., latent) of observations, and V (...) by an action drawn there."""
    z = target.encode(inputs)
    action, _ = target.sample(z, noise)
    q = target.q(z, action).float()
    return z, q.amin(dim=0) if twin_minimum else q[0]


def model_loss(
    model: WorldModel,
    z: Tensor,
    targets: Targets,
    batch: Batch,
    loss: Loss,
    expert_weight: float | Tensor = 0.0,
) -> ModelLoss:
    """J of the paper: reward, value and consistency losses along a latent rollout, and the end.

    Args:
        model: whose parameters are trained.
        z: (B, latent) the encoded first observations.
        targets: of the later ones.
        batch: B sequences of H steps.
        loss: weights.
        expert_weight: present weight of the imitation of the expert.
    """
    horizon = len(batch.action)
    ahead = target_steps(horizon, loss.n_step)
    latents = [z]
    for t in range(horizon):
        z = model.next(z, batch.action[t]).float()
        latents.append(z)
    states = torch.stack(latents[:-1])
    inconsistency = (torch.stack([latents[t] for t in ahead]) - targets.z).square().mean(dim=-1)

    reward, end = model.reward_and_end(states, batch.action)
    q = model.q(states, batch.action).float()
    decay = _decay(loss, batch.valid)
    weight = _shares(batch.valid * decay)
    last = [t - 1 for t in ahead]
    value = (q - targets.returns).square().sum(dim=0)
    terms = {
        "reward": ((reward.float() - batch.reward).square() * weight).sum(),
        "value": (value * _shares(targets.known * decay)).sum(),
        "consistency": (inconsistency * _shares((batch.valid * decay)[last])).sum(),
        "termination": (
            binary_cross_entropy_with_logits(end.float(), batch.end, reduction="none") * weight
        ).sum(),
    }
    total = sum(getattr(loss, name) * term for name, term in terms.items())
    assert isinstance(total, Tensor)
    policy = model.policy(states)
    if loss.imitation_shaping > 0:
        error = (torch.tanh(policy[0]) - batch.reference).square().sum(dim=-1)
        wanted = loss.imitation * batch.planned + expert_weight * batch.labelled
        total = total + loss.imitation_shaping * (error * wanted * weight).sum()
    first = latents[0].detach()
    terms["latent_spread"] = first.std(dim=0).mean()
    terms["value_mean"] = (targets.returns * weight).sum()
    return ModelLoss(total, {k: v.detach() for k, v in terms.items()}, states.detach(), policy)


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
    states: Tensor,
    drawn: tuple[Tensor, Tensor],
    batch: Batch,
    loss: Loss,
    alpha: float | Tensor,
    q_scale: float | Tensor,
    expert_weight: float | Tensor = 0.0,
) -> PolicyLoss:
    """L_pi of the paper: sum of rho^t [alpha log pi - Q / scale + lambda |a - a_mppi|^2].

    Expert labels are imitated like MPPI's plans, with a weight of its own.

    Args:
        model: whose Q is followed.
        states: (H, B, latent), without gradient.
        drawn: the policy's actions (H, B, 2) in these and their log pi (H, B).
        batch: the sequences they came from.
        loss: weights.
        alpha: entropy coefficient.
        q_scale: divides Q, so that the weights mean the same at each stage of training.
        expert_weight: present weight of the imitation of the expert.
    """
    action, log_prob = drawn
    values = model.q_along_action(states, action).float()
    value = values.amin(dim=0) if loss.twin_minimum else values.mean(dim=0)
    error = (action - batch.reference).square().sum(dim=-1)
    wanted = loss.imitation * batch.planned + expert_weight * batch.labelled
    weight = _shares(batch.valid * _decay(loss, batch.valid))
    each = alpha * log_prob - value / q_scale + wanted * error
    terms = {
        "entropy": (-log_prob * weight).sum().detach(),
        "policy_value": (value * weight).sum().detach(),
        "imitation": _mean(error, batch.planned * weight),
        "expert": _mean(error, batch.labelled * weight),
    }
    return PolicyLoss((each * weight).sum(), terms, value.detach())


def _decay(loss: Loss, like: Tensor) -> Tensor:
    """(H, 1) lambda^t."""
    return loss.horizon_decay ** torch.arange(len(like), device=like.device)[:, None]


def _mean(error: Tensor, weight: Tensor) -> Tensor:
    return (error * weight).sum().detach() / weight.sum().clamp(min=1e-6)
