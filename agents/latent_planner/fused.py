"""Returns of candidates, fused form: those of ``plain`` for one robot on a CPU, with less work.

What is saved, none of which changes a return by more than rounding:

- all candidates of a view start from the same z, so its part of the first layers is computed once;
- the policy's candidates get their returns while they are made;
- candidates are rolled out in blocks whose intermediate results stay in the cache, one thread per
  block, instead of splitting each small matrix product between threads;
- matrix products go through oneDNN, which on many CPUs is faster than the BLAS that PyTorch uses
  by default, with packed weights and SiLU in the same pass.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import torch
from crowdbench_agents.latent_planner.scoring import Scoring, ViewByView
from crowdbench_agents.latent_planner.world_model import WorldModel
from crowdbench_agents.learning.inputs import ACTION
from torch import Tensor, nn
from torch.nn.functional import layer_norm, linear, silu

BLOCK = 256
"""Candidates rolled out together at most: their widest layer then fits a 1 MB second-level cache.
Independent of the number of threads, so that the plan is too."""

_WIDE = 16  # outputs from which packing pays

Act = Callable[[int, Tensor], Tensor]
"""Actions (N, 2) at step t of candidates in states z (N, latent)."""


class FusedEvaluator:
    """An ``Evaluator`` with copies of a world model's parameters, for one robot (M = 1).

    Later changes to the model go unnoticed.

    Args:
        model: the world model.
        threads: blocks of candidates rolled out at the same time.
    """

    def __init__(self, model: WorldModel, threads: int = 1) -> None:
        self.model = model
        self.dynamics = _Layers(model.dynamics)
        self.outcome = _Layers(model.outcome)
        self.q_networks = [_Layers(network) for network in model.q_networks]
        self._policy = _Layers(model.policy_network)
        self._residual = model.settings.dynamics == "residual"
        latent = model.settings.latent
        self._one, self._zero = torch.ones(latent), torch.zeros(latent)
        self._pool = _single_threaded_pool(threads) if threads > 1 else None

    def views(self, views: Tensor, signs: Tensor, scoring: Scoring) -> ViewByView:
        """The states (V, 1, latent) of the robot in all views."""
        each = zip(views, signs, strict=True)
        return ViewByView([self.view(z, sign, scoring) for z, sign in each])

    def view(self, z: Tensor, sign: Tensor, scoring: Scoring) -> FusedView:
        """The view in which the robot's state is z (1, latent)."""
        return FusedView(self, z, sign, scoring)

    def each(self, roll: Callable[[Tensor], Tensor], blocks: Sequence[Tensor]) -> list[Tensor]:
        """What ``roll`` makes of each block, in their order."""
        return list(map(roll, blocks) if self._pool is None else self._pool.map(roll, blocks))

    def next(self, z: Tensor, inputs: Tensor, shared: Tensor | None) -> Tensor:
        """States (N, latent) behind states z and actions, or as ``_Layers`` has it."""
        change = self.dynamics(inputs, shared)
        z = change.add_(z) if self._residual else change
        if self.model.settings.latent_norm == "layer":
            # with factors, even of one, PyTorch's kernel is vectorised and twice as fast
            return layer_norm(z, z.shape[-1:], self._one, self._zero)
        return self.model.normalise(z)

    def value(self, inputs: Tensor, shared: Sequence[Tensor | None] = (None, None)) -> Tensor:
        """The smaller Q (N,) for states and actions (N, latent + 2), or as ``_Layers`` has it."""
        one, two = (q(inputs, part)[:, 0] for q, part in zip(self.q_networks, shared, strict=True))
        return torch.minimum(one, two)

    def act(self, z: Tensor) -> Tensor:
        """The policy's actions (N, 2) in states (N, latent)."""
        return torch.tanh(self._policy(z)[:, :ACTION])


class FusedView:
    """A ``View`` of one robot, in state z (1, latent).

    What z contributes to the first layers is computed once and shared by all candidates.
    """

    def __init__(
        self, evaluator: FusedEvaluator, z: Tensor, sign: Tensor, scoring: Scoring
    ) -> None:
        self._evaluator, self._z, self._sign, self._scoring = evaluator, z, sign, scoring
        self._q = [network.share(z) for network in evaluator.q_networks]
        self._outcome = evaluator.outcome.share(z)
        self._dynamics = evaluator.dynamics.share(z)

    def returns(self, candidates: Tensor) -> Tensor:
        """(1, N, H, 2) -> (1, N)."""
        _, count, horizon, _ = candidates.shape
        actions = candidates[0] * self._sign
        blocks = actions.chunk(-(-count // BLOCK)) if count else ()

        def roll(block: Tensor) -> Tensor:
            with torch.no_grad():  # each thread has its own such setting
                return self._roll(lambda t, _: block[:, t], len(block), horizon)

        return torch.cat([torch.zeros(0), *self._evaluator.each(roll, blocks)])[None]

    def follow_policy(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Candidates (1, N, H, 2) of the policy and their returns (1, N)."""
        noise = noise[0]
        count, horizon, _ = noise.shape
        actions = torch.empty_like(noise)

        def act(t: int, z: Tensor) -> Tensor:
            actions[:, t] = self._evaluator.model.sample(z, noise[:, t])[0]
            return actions[:, t]

        returns = self._roll(act, count, horizon)
        return (actions * self._sign)[None], returns[None]

    def _roll(self, act: Act, count: int, horizon: int) -> Tensor:
        """Returns (N,) of N = ``count`` candidates."""
        evaluator, score = self._evaluator, self._scoring.score
        shares = self._scoring.shares(horizon)
        outcomes, values = [], torch.zeros(horizon + 1, count)
        z = self._z.expand(count, -1)
        for t in range(horizon):
            action = act(t, z)
            first = t == 0
            inputs = action if first else torch.cat([z, action], dim=1)
            if shares[t] > 0:
                values[t] = evaluator.value(inputs, self._q if first else (None, None))
            if score != "q":
                outcomes.append(evaluator.outcome(inputs, self._outcome if first else None))
            if t + 1 < horizon or score != "reward":
                z = evaluator.next(z, inputs, self._dynamics if first else None)
        if score != "reward":
            values[horizon] = evaluator.value(torch.cat([z, evaluator.act(z)], dim=1))
        total, weight = torch.zeros(horizon + 1, count), torch.ones(horizon + 1, count)
        if score != "q":
            reward, end = torch.stack(outcomes).unbind(dim=-1)
            weight[1:] = torch.sigmoid(-end).mul_(self._scoring.discount).cumprod(dim=0)
            total[1:] = (weight[:-1] * reward).cumsum(dim=0)
        return torch.tensor(shares) @ total.addcmul_(weight, values)


class _Layers:
    """The layers of an Mlp, packed."""

    def __init__(self, mlp: nn.Module) -> None:
        layers = list(mlp.children())
        self._hidden = []
        for layer, following in itertools.pairwise(layers):
            if isinstance(layer, nn.Linear):
                norm = following if isinstance(following, nn.LayerNorm) else None
                self._hidden.append((_Linear(layer), norm))
        last = layers[-1]
        assert isinstance(last, nn.Linear)
        self._last = _Linear(last)

    def share(self, z: Tensor) -> Tensor:
        """What a state (1, latent) contributes to the first layer, bias included."""
        return self._hidden[0][0].share(z)

    def __call__(self, x: Tensor, shared: Tensor | None = None) -> Tensor:
        """Outputs (N, outputs) for inputs (N, inputs), or for those that ``share`` left out."""
        for layer, norm in self._hidden:
            x = layer(x, norm is None) if shared is None else layer.add(shared, x, norm is None)
            shared = None
            if norm is not None:
                x = layer_norm(x, norm.normalized_shape, norm.weight, norm.bias, norm.eps)
                x = silu(x, inplace=True)
        return self._last(x, activate=False)


class _Linear:
    """A linear layer, with SiLU behind it where asked for."""

    def __init__(self, layer: nn.Linear) -> None:
        self._weight, self._bias = layer.weight.detach().clone(), layer.bias.detach().clone()
        self._packed = None
        if torch.backends.mkldnn.is_available() and layer.out_features >= _WIDE:
            self._packed = torch.ops.mkldnn._reorder_linear_weight(self._weight)

    def __call__(self, x: Tensor, activate: bool) -> Tensor:
        if self._packed is None:
            x = linear(x, self._weight, self._bias)
            return silu(x, inplace=True) if activate else x
        return torch.ops.mkldnn._linear_pointwise(
            x, self._packed, self._bias, "swish" if activate else "none", [], ""
        )

    def share(self, z: Tensor) -> Tensor:
        """The outputs (1, out) as far as they depend on the first inputs z (1, features)."""
        return linear(z, self._weight[:, : z.shape[1]], self._bias)

    def add(self, shared: Tensor, rest: Tensor, activate: bool) -> Tensor:
        """The outputs (N, out) from what is shared and the remaining inputs (N, features)."""
        x = torch.addmm(shared, rest, self._weight[:, -rest.shape[1] :].t())
        return silu(x, inplace=True) if activate else x


def _single_threaded_pool(threads: int) -> ThreadPoolExecutor:
    """Workers in which PyTorch does not start threads of its own."""
    before, started = torch.get_num_threads(), Barrier(threads + 1)

    def begin() -> None:
        torch.set_num_threads(1)
        started.wait()

    pool = ThreadPoolExecutor(threads, thread_name_prefix="planner", initializer=begin)
    for _ in range(threads):
        pool.submit(int)
    started.wait()
    torch.set_num_threads(before)  # the workers have theirs; this is for threads to come
    return pool
