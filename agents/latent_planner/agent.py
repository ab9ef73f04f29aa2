"""The latent planner as an agent: encode, plan, execute the first E actions, plan again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from crowdbench_agents.learning.agent import LearnedAgent
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

import crowdbench

if TYPE_CHECKING:
    from crowdbench_agents.latent_planner.world_model import WorldModel
    from crowdbench_agents.learning.config import Config
    from crowdbench_agents.learning.inputs import Inputs
    from torch import Tensor


ONLY = np.zeros(1, np.int64)
"""Which robot, of one."""


class Options(BaseModel):
    """The options of a latent planner, checked; see LatentPlanner."""

    model_config = ConfigDict(frozen=True, strict=True)

    horizon: Annotated[int, Field(ge=1, le=100)]
    execute: Annotated[int, Field(ge=1, le=100)]
    smoothness_weight: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None
    policy_prior: bool
    use_mppi: bool
    score: Literal["reward_q", "reward", "q"]
    iterations: Annotated[int, Field(ge=1)] | None
    candidates: Annotated[int, Field(ge=1)] | None
    elites: Annotated[int, Field(ge=1)] | None
    constant_actions: bool
    reflect: bool | None
    values: Literal["final", "mean", "lambda"] | None
    threads: Annotated[int, Field(ge=1, le=256)] | None


class LatentPlanner(LearnedAgent):
    """MPPI in a learned latent space, guided by a learned policy (the paper's planner).

    Args:
        horizon: H, steps planned ahead, 1 to 100.
        execute: E, actions of a plan that are executed before the next one is made, 1 to H.
        smoothness_weight: lambda_smooth; None takes the one of the weights' configuration.
        policy_prior: whether some candidates are drawn from the policy.
        use_mppi: False executes the policy alone.
        score: what candidates are scored by: predicted rewards and the final Q, or one of them.
        weights: name of shipped weights, or path of a ``.safetensors`` file; None takes the
            agent's own.
        iterations: MPPI's (6 in the paper). This and the next five are by default those of the
            weights' configuration; with fewer candidates than elites all are elites.
        candidates: per iteration, those of the policy included (512 in the paper).
        elites: candidates that the next iteration's Gaussian is fitted to (64 in the paper).
        constant_actions: whether there are further candidates that keep to one action, where the
            weights' configuration has them.
        reflect: whether candidates are scored with left and right swapped as well.
        values: what counts of the values: "final", the Q behind the horizon, the paper's score;
            "mean", the mean of the returns of 1 .. H steps; or "lambda", their lambda-return.
        threads: used to plan; None means as many as PyTorch uses.
    """

    version: ClassVar[str] = "0.1.0"
    trainer: ClassVar[str] = "latent_planner"
    folder: ClassVar[Path] = Path(__file__).parent / "weights"
    own_weights: ClassVar[str] = "social"

    def __init__(
        self,
        *,
        horizon: int = 6,
        execute: int = 1,
        smoothness_weight: float | None = None,
        policy_prior: bool = True,
        use_mppi: bool = True,
        score: str = "reward_q",
        weights: str | None = None,
        iterations: int | None = None,
        candidates: int | None = None,
        elites: int | None = None,
        constant_actions: bool = True,
        reflect: bool | None = None,
        values: str | None = None,
        threads: int | None = None,
    ) -> None:
        self.options = _checked(
            horizon=horizon,
            execute=execute,
            smoothness_weight=smoothness_weight,
            policy_prior=policy_prior,
            use_mppi=use_mppi,
            score=score,
            iterations=iterations,
            candidates=candidates,
            elites=elites,
            constant_actions=constant_actions,
            reflect=reflect,
            values=values,
            threads=threads,
        )
        super().__init__(self.own_weights if weights is None else weights)

    def reset(self, robot: crowdbench.RobotSpec, seed: int) -> None:
        """Forget the last episode; the planner's noise follows from the seed."""
        import torch
        from crowdbench_agents.latent_planner.plan_queue import PlanQueue

        super().reset(robot, seed)
        options = self.options
        self._generator = torch.Generator().manual_seed(seed)
        self._half_range = torch.from_numpy(self._bounds.half)
        self._queue = PlanQueue(1, options.horizon if options.use_mppi else options.execute)
        self._plans = 0

    def _choose(self, inputs: Inputs) -> NDArray[np.float32]:
        """The next action of the plan, after planning where that is due."""
        if self._plans == 0 or self._queue.taken[0] == self.options.execute:
            self._queue.put(ONLY, self._decide(inputs))
            self._plans += 1
        return self._queue.take(ONLY)[0].numpy()

    def diagnostics(self) -> dict[str, float]:
        """Return the number of plans made."""
        return {"plans": float(self._plans)}

    def _policy(self) -> Callable[[Inputs], Tensor]:
        """The policy alone, which acts with these options only."""
        if self.options.use_mppi:
            raise ValueError(
                "a plan by MPPI is no network; with use_mppi=false the policy acts alone"
            )
        if self.options.execute != 1:
            raise ValueError(f"execute: should be 1 to be exported, got {self.options.execute}")
        model: WorldModel = self._network
        return lambda inputs: model.act(model.encode(inputs))

    def _load(self, path: Path) -> tuple[WorldModel, Config, dict[str, Any]]:
        import torch
        from crowdbench_agents.latent_planner.fused import FusedEvaluator
        from crowdbench_agents.latent_planner.world_model import load_world_model
        from crowdbench_agents.learning.config import Planner

        model, config, training = load_world_model(path)
        options = self.options
        changes = options.model_dump(
            include=set(Planner.model_fields), exclude={"constant_actions"}, exclude_none=True
        )
        if not options.constant_actions:
            changes["constant_actions"] = None
        if not options.policy_prior:
            changes["policy_share"] = 0.0
        self._settings = config.planner.model_copy(update=changes)
        if options.use_mppi:
            self._evaluator = FusedEvaluator(model, options.threads or torch.get_num_threads())
        return model, config, training

    def _decide(self, inputs: Inputs) -> Tensor:
        """(1, H, 2) actions in [-1, 1], or (1, E, 2) of the policy alone."""
        import torch
        from crowdbench_agents.latent_planner.mppi import encode_views, plan

        model: WorldModel = self._network
        z = model.encode(inputs)
        if not self.options.use_mppi:
            actions = []
            for _ in range(self.options.execute):
                actions.append(model.act(z))
                z = model.next(z, actions[-1])
            return torch.stack(actions, dim=1)
        previous = self._bounds.normalised(inputs.velocity.numpy())
        result = plan(
            self._evaluator,
            encode_views(model, z, inputs, self._settings),
            torch.from_numpy(previous),
            self._settings,
            self._config.loss.discount,
            self._half_range,
            self._generator,
            warm_start=self._queue.rest(ONLY),
            score=self.options.score,
        )
        return result.actions


def _checked(**values: object) -> Options:
    """The options, or a ValueError that names the one to change and what is allowed."""
    try:
        options = Options.model_validate(values)
    except ValidationError as error:
        raise ValueError(
            "; ".join(
                f"{item['loc'][0]}: {item['msg'][0].lower()}{item['msg'][1:]}, "
                f"got {item['input']!r}"
                for item in error.errors()
            )
        ) from error
    if options.execute > options.horizon:
        raise ValueError(
            f"execute: should be 1 to horizon ({options.horizon}), got {options.execute}"
        )
    elites, candidates = options.elites, options.candidates
    if elites is not None and candidates is not None and elites > candidates:
        raise ValueError(f"elites: should be 1 to candidates ({candidates}), got {elites}")
    return options
