"""MPPI for one robot on a CPU: the plan of ``mppi.plan`` for a fraction of the work.

What is saved, none of which changes a score by more than rounding:

- all candidates of a view start from the same z, so its part of the first layers is computed once;
- the policy's candidates and the constant actions stay the same over the iterations and are
  scored once;
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
from typing import NamedTuple

import torch
from crowdbench_agents.latent_planner.mppi import (
    Plan,
    Score,
    constant_actions,
    refit,
    smoothness_penalty,
    value_shares,
    view_signs,
)
from crowdbench_agents.latent_planner.world_model import Mlp, WorldModel
from crowdbench_agents.learning.config import Planner
from crowdbench_agents.learning.inputs import ACTION
from torch import Tensor, nn
from torch.nn.functional import layer_norm, linear, silu

BLOCK = 256
"""Candidates rolled out together at most: their widest layer then fits a 1 MB second-level cache.
Independent of the number of threads, so that the plan is too."""

_WIDE = 16  # outputs from which packing pays

Act = Callable[[int, Tensor], Tensor]
"""Actions (N, 2) at step t of candidates in states z (N, latent)."""


class FastPlanner:
    """Plans with copies of a world model's parameters; later changes to the model go unnoticed.

    Args:
        model: the world model.
        threads: blocks of candidates rolled out at the same time.
    """

    def __init__(self, model: WorldModel, threads: int = 1) -> None:
        self._model = model
        self._dynamics = _Layers(model.dynamics)
        self._outcome = _Layers(model.outcome)
        self._q_networks = [_Layers(network) for network in model.q_networks]
        self._policy = _Layers(model.policy_network)
        self._residual = model.settings.dynamics == "residual"
        latent = model.settings.latent
        self._one, self._zero = torch.ones(latent), torch.zeros(latent)
        self._pool = _single_threaded_pool(threads) if threads > 1 else None

    @torch.no_grad()
    def plan(
        self,
        views: Tensor,
        previous: Tensor,
        settings: Planner,
        discount: float,
        half_range: Tensor,
        generator: torch.Generator,
        warm_start: Tensor | None = None,
        score: Score = "reward_q",
    ) -> Plan:
        """As ``mppi.plan``, with M = 1 and the same noise for the same generator."""
        horizon = settings.horizon
        guided = round(settings.policy_share * settings.candidates)
        shape = (1, settings.candidates - guided, horizon, ACTION)
        mean = torch.zeros(1, horizon, ACTION) if warm_start is None else warm_start
        std = torch.full_like(mean, settings.max_std)

        def penalty(candidates: Tensor) -> Tensor:
            rough = smoothness_penalty(candidates, previous, half_range)
            return settings.smoothness_weight * rough

        begins = [self.start(z, sign) for z, sign in zip(views, view_signs(views), strict=True)]

        def returns(candidates: Tensor) -> Tensor:
            each = [self.returns(x, candidates[0], settings, discount, score) for x in begins]
            return torch.stack(each).mean(dim=0)

        noise = torch.randn(guided, horizon, ACTION, generator=generator)
        from_policy, fixed_scores = self._propose(begins, noise, settings, discount, score)
        if settings.start == "policy" and guided:
            mean = from_policy[:, 0]
        fixed, fixed_scores = from_policy, fixed_scores - penalty(from_policy)
        unscored = constant_actions(settings)[None]
        known = guided + unscored.shape[1]
        for _ in range(settings.iterations):
            sampled = mean[:, None] + std[:, None] * torch.randn(shape, generator=generator)
            fresh = torch.cat([unscored, sampled.clamp(-1, 1)], dim=1)
            scores = returns(fresh) - penalty(fresh)
            candidates = torch.cat([fixed, fresh], dim=1)
            scores = torch.cat([fixed_scores, scores], dim=1)
            mean, std, best = refit(candidates, scores, settings)
            # the constant actions are scored now, and come before what was drawn
            fixed, fixed_scores = candidates[:, :known], scores[:, :known]
            unscored = unscored[:, :0]
        return Plan(mean, std, best)

    @torch.no_grad()
    def returns(
        self,
        start: Start,
        candidates: Tensor,
        settings: Planner,
        discount: float,
        score: Score = "reward_q",
    ) -> Tensor:
        """phi without the smoothness penalty.

        Args:
            start: where all candidates start, in one view.
            candidates: (N, H, 2) in [-1, 1], of the world as it is.
            settings: of which ``values`` and ``return_lambda`` count.
            discount: gamma per step.
            score: which of the predicted terms count.

        Returns:
            (1, N).
        """
        candidates = candidates * start.sign
        count, horizon, _ = candidates.shape
        blocks = candidates.chunk(-(-count // BLOCK)) if count else ()

        def roll(block: Tensor) -> Tensor:
            with torch.no_grad():  # each thread has its own such setting
                return self._roll(
                    start, lambda t, _: block[:, t], len(block), horizon, settings, discount, score
                )

        run = map if self._pool is None else self._pool.map
        return torch.cat([torch.zeros(0), *run(roll, blocks)])[None]

    def _propose(
        self,
        starts: Sequence[Start],
        noise: Tensor,
        settings: Planner,
        discount: float,
        score: Score,
    ) -> tuple[Tensor, Tensor]:
        """Candidates (1, N, H, 2) of the policy in all views, noise (N, H, 2); returns (1, N)."""
        candidates, returns = [], []
        for start, part in zip(starts, noise.tensor_split(len(starts)), strict=True):
            if settings.start == "policy":
                part[:1] = 0.0
            actions, seen = self._follow_policy(start, part, settings, discount, score)
            others = [
                self.returns(other, actions, settings, discount, score)[0]
                for other in starts
                if other is not start
            ]
            candidates.append(actions)
            returns.append(torch.stack([seen, *others]).mean(dim=0))
        return torch.cat(candidates)[None], torch.cat(returns)[None]

    def _follow_policy(
        self, start: Start, noise: Tensor, settings: Planner, discount: float, score: Score
    ) -> tuple[Tensor, Tensor]:
        """Candidates (N, H, 2) of the policy in a view, and their returns (N,) there."""
        count, horizon, _ = noise.shape
        actions = torch.empty_like(noise)

        def act(t: int, z: Tensor) -> Tensor:
            actions[:, t] = self._model.sample(z, noise[:, t])[0]
            return actions[:, t]

        returns = self._roll(start, act, count, horizon, settings, discount, score)
        return actions * start.sign, returns

    def start(self, z: Tensor, sign: Tensor) -> Start:
        """What all candidates share that start in z (1, latent), a view with its sign (2,)."""
        q = [network.share(z) for network in self._q_networks]
        return Start(z, sign, self._outcome.share(z), self._dynamics.share(z), q)

    def _roll(
        self,
        start: Start,
        act: Act,
        count: int,
        horizon: int,
        settings: Planner,
        discount: float,
        score: Score,
    ) -> Tensor:
        """Returns (N,) of N = ``count`` candidates from the same state, as in ``mppi.evaluate``."""
        shares = value_shares(settings, horizon, score)
        outcomes, values = [], torch.zeros(horizon + 1, count)
        z = start.z.expand(count, -1)
        for t in range(horizon):
            action = act(t, z)
            first = t == 0
            inputs = action if first else torch.cat([z, action], dim=1)
            if shares[t] > 0:
                values[t] = self._value(inputs, start.q if first else (None, None))
            if score != "q":
                outcomes.append(self._outcome(inputs, start.outcome if first else None))
            if t + 1 < horizon or score != "reward":
                change = self._dynamics(inputs, start.dynamics if first else None)
                z = self._normalise(change.add_(z) if self._residual else change)
        if score != "reward":
            action = torch.tanh(self._policy(z)[:, :ACTION])
            values[horizon] = self._value(torch.cat([z, action], dim=1))
        total, weight = torch.zeros(horizon + 1, count), torch.ones(horizon + 1, count)
        if score != "q":
            reward, end = torch.stack(outcomes).unbind(dim=-1)
            weight[1:] = torch.sigmoid(-end).mul_(discount).cumprod(dim=0)
            total[1:] = (weight[:-1] * reward).cumsum(dim=0)
        return torch.tensor(shares) @ total.addcmul_(weight, values)

    def _value(self, inputs: Tensor, shared: Sequence[Tensor | None] = (None, None)) -> Tensor:
        """The smaller Q (N,) for states and actions (N, latent + 2), or as ``_Layers`` has it."""
        one, two = (q(inputs, part)[:, 0] for q, part in zip(self._q_networks, shared, strict=True))
        return torch.minimum(one, two)

    def _normalise(self, z: Tensor) -> Tensor:
        if self._model.settings.latent_norm == "layer":
            # with factors, even of one, PyTorch's kernel is vectorised and twice as fast
            return layer_norm(z, z.shape[-1:], self._one, self._zero)
        return self._model.normalise(z)


class Start(NamedTuple):
    """Where all candidates start in a view.

    Attributes:
        z: (1, latent), the view.
        sign: (2,) factors that turn actions into those of the view.
        outcome, dynamics: (1, hidden), what z contributes to their first layers.
        q: the same for both Qs.
    """

    z: Tensor
    sign: Tensor
    outcome: Tensor
    dynamics: Tensor
    q: list[Tensor]


class _Layers:
    """The layers of an Mlp, packed."""

    def __init__(self, mlp: Mlp) -> None:
        layers = list(mlp)
        self._hidden = []
        for layer, following in itertools.pairwise(layers):
            if isinstance(layer, nn.Linear):
                norm = following if isinstance(following, nn.LayerNorm) else None
                self._hidden.append((_Linear(layer), norm))
        self._last = _Linear(layers[-1])

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
