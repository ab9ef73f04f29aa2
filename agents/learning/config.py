"""Configuration of the learned agents: the paper's values as defaults, config.yaml as shipped.

Every field says its unit where it has one. Unknown keys and values out of range are refused.
docs/training.md says why each value that differs from the paper's does.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

import crowdbench
from crowdbench.messages import explain, setting

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
Several = Annotated[int, Field(ge=2)]
Tier = Literal["paper", "hard", "situation"]

FINAL_LEARNING_RATE = 0.05
"""Share of the learning rates that is left after their decay."""


STORED_NAMES = {
    ("planner", "arcs"): "constant_actions",
    ("loss", "teaching"): "expert",
    ("loss", "teaching_end"): "expert_end",
    ("training", "teacher"): "expert",
    ("training", "taught_environments"): "labelled_environments",
    ("training", "teaching_updates"): "expert_updates",
}
"""Names of fields in weights files of version 0.1.0, and what they are called now."""


class ConfigError(ValueError):
    """A configuration that cannot be used; the message names the field and what is allowed."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Perception(_Section):
    """The stacked obstacle map."""

    cells: int = Field(48, ge=16, multiple_of=16, description="cells along each side")
    size: Positive = Field(6.0, le=100, description="side length [m]")
    ahead: NonNegative = Field(4.0, description="from the robot to the front edge [m]")

    @model_validator(mode="after")
    def _robot_is_in_the_map(self) -> Perception:
        if self.ahead > self.size:
            raise ValueError(
                f"ahead: {setting(self.ahead)} m leave the robot out of the map; allowed: "
                f"0 to {setting(self.size)} (size)"
            )
        return self

    @property
    def geometry(self) -> crowdbench.MapGeometry:
        """Where the map lies in the robot frame."""
        return crowdbench.MapGeometry(self.cells, self.size, self.ahead)


class Model(_Section):
    """Sizes and forms of the networks."""

    encoder: Literal["coarse", "fine"] = Field(
        "coarse", description="first layer of f_map: stride 4 and 4 frames, or 2 and all 8 frames"
    )
    latent: Count = Field(256, description="d, features of z")
    hidden: Count = Field(256, description="hidden units of reward, Q and policy")
    dynamics_hidden: Count = Field(256, description="hidden units of the dynamics")
    dynamics: Literal["plain", "residual"] = Field(
        "plain", description="z' = norm(f(z, a)), or norm(z + f(z, a)) with f starting at zero"
    )
    latent_norm: Literal["none", "layer", "simplex"] = Field(
        "none", description="simplex: softmax over groups of 8 (SimNorm, TD-MPC2)"
    )


class Planner(_Section):
    """MPPI in latent space."""

    horizon: Count = Field(6, description="H, steps")
    iterations: Count = Field(6)
    candidates: Count = Field(512)
    elites: Count = Field(64)
    policy_share: Share = Field(0.05, description="share of the candidates from the policy")
    start: Literal["previous", "policy"] = Field(
        "previous", description="the first mean: the previous plan moved on, or the policy's plan"
    )
    constant_actions: tuple[Several, Several] | None = Field(
        None,
        description="speeds and turn rates, evenly spaced, of further candidates that keep to one "
        "action; None: there are none",
    )
    values: Literal["final", "mean", "lambda"] = Field(
        "final",
        description="score: rewards and the Q behind the horizon (final); the mean of such returns "
        "of 1 .. H steps (mean); or the lambda-return of 0 .. H steps (lambda)",
    )
    return_lambda: Share = Field(0.5, description="lambda of the lambda-return")
    reflect: bool = Field(
        False,
        description="score candidates with left and right swapped as well; the mean counts",
    )
    temperature: Positive = Field(0.5, description="of the weights among elites, in Q scales")
    min_std: Positive = Field(0.05, description="of an action normalised to [-1, 1]")
    max_std: Positive = Field(1.0, description="of an action normalised to [-1, 1]")
    smoothness_weight: NonNegative = Field(
        0.1, description="lambda_smooth, on the squared change of (v [m/s], w [rad/s])"
    )


class Loss(_Section):
    """Weights of the losses (paper, section III.B) and of what was added to them."""

    reward: NonNegative = Field(0.5, description="c_1")
    value: NonNegative = Field(0.1, description="c_2")
    consistency: NonNegative = Field(2.0, description="c_3, on the mean over latent features")
    termination: NonNegative = Field(0.5, description="binary cross-entropy of the end")
    discount: Share = Field(0.97, description="gamma, per control step")
    horizon_decay: Share = Field(0.7, description="lambda and rho, per step of the rollout")
    n_step: Count = Field(
        1, description="states between those with a target value; rewards are summed up to them"
    )
    twin_minimum: bool = Field(True, description="the smaller of the two target Qs")
    imitation: NonNegative = Field(1.0, description="lambda, on |a - a_mppi|^2")
    expert: NonNegative = Field(0.0, description="on |a - a_expert|^2, at the start")
    expert_end: NonNegative = Field(0.0, description="on |a - a_expert|^2, in the end")
    imitation_shaping: NonNegative = Field(
        0.0, description="share of both imitation terms that shapes encoder and dynamics"
    )
    entropy: NonNegative = Field(0.01, description="alpha, or its start when it is tuned")
    entropy_target: float | None = Field(None, description="nats; None keeps alpha fixed")


class Training(_Section):
    """The trainer."""

    environments: Count = Field(32, description="stepped together")
    planning_environments: int = Field(16, ge=0, description="in which MPPI acts")
    replanned_states: NonNegative = Field(
        0.0,
        description="states of the past that are planned again, and then imitated, per step of all "
        "environments (lazy reanalysis, Wang et al., BMPC, 2025)",
    )
    epsilon_start: Share = Field(0.5)
    epsilon_end: Share = Field(0.05)
    epsilon_decisions: Count = Field(25_000)
    noise: NonNegative = Field(0.4, description="std of the exploration noise, actions in [-1, 1]")
    noise_correlation: Share = Field(0.8, description="of the noise from one step to the next")
    batch: Count = Field(64, description="sequences of H + 1 observations per update")
    collision_share: Share = Field(0.0, description="of the sequences that end in a collision")
    updates_per_step: Positive = Field(1.0, description="updates per step of all environments")
    replay: Count = Field(400_000, description="transitions kept")
    warmup: int = Field(5_000, ge=0, description="transitions before the first update")
    refill: int = Field(
        40_000,
        ge=0,
        description="transitions before the next update where a run goes on without its replay",
    )
    reflect: bool = Field(False, description="left-right reflection of half of the sequences")
    detour_price: NonNegative = Field(
        0.0,
        description="taken off the environment's rewards for each metre driven beyond the metres "
        "gained towards the goal; 0 where a map is trained in",
    )
    reward_scale: Positive = Field(1.0, description="factor on these rewards")
    learning_rate_model: Positive = Field(1e-4, description="encoder and dynamics")
    learning_rate: Positive = Field(3e-4, description="the other networks")
    learning_rate_decay: tuple[int, int] | None = Field(
        None, description="updates between which both rates fall linearly to a twentieth"
    )
    gradient_clip: Positive = Field(10.0)
    target_rate: Share = Field(0.01, description="of the slow target parameters, per update")
    tiers: tuple[Tier, ...] = Field(
        ("paper",),
        description="of the scenarios that are trained in; all have the robot of the last one",
    )
    variants: int = Field(
        1,
        ge=1,
        le=100,
        description="of each scenario that are trained in: itself, and others drawn around it",
    )
    expert: str = Field("informed", description="agent that demonstrates and labels")
    labelled_environments: int = Field(0, ge=0, description="in which the expert labels each step")
    expert_updates: Count = Field(
        20_000, description="over which the weight loss.expert goes from its start to its end"
    )
    demonstrations: int = Field(0, ge=0, description="transitions of the expert")
    demonstration_share: Share = Field(0.25, description="of each batch, once there is a replay")
    pretraining: int = Field(0, ge=0, description="updates on demonstrations before acting")
    validation_minutes: Positive = Field(10.0, description="between validations [min]")
    validation_episodes: Count = Field(10, description="per scenario")
    checkpoint_minutes: Positive = Field(5.0, description="between checkpoints [min]")
    bfloat16: bool = Field(
        False,
        description="matrix products and convolutions in bfloat16, where the CPU has instructions "
        "for it",
    )

    @field_validator("tiers", mode="before")
    @classmethod
    def _tiers_are_a_list(cls, value: Any) -> Any:
        known = get_args(Tier)
        listed = value if isinstance(value, list | tuple) else []
        if not listed or any(listed.count(tier) > 1 or tier not in known for tier in listed):
            raise ValueError(
                f"expected a list of {', '.join(known)}, each once at most (got {setting(value)})"
            )
        return value

    @model_validator(mode="after")
    def _everybody_has_an_environment(self) -> Training:
        if self.planning_environments + self.labelled_environments > self.environments:
            raise ValueError("planning_environments + labelled_environments exceed environments")
        return self

    @field_validator("learning_rate_decay")
    @classmethod
    def _decay_has_a_length(cls, value: tuple[int, int] | None) -> tuple[int, int] | None:
        if value is not None and not 0 <= value[0] < value[1]:
            raise ValueError("expected two counts of updates, the second above the first")
        return value


class Config(_Section):
    """Everything about a learned agent and its training.

    ``planner`` counts for the latent planner and its relatives alone.
    """

    perception: Perception = Perception()
    model: Model = Model()
    planner: Planner = Planner()
    loss: Loss = Loss()
    training: Training = Training()

    def expert_weight(self, updates: int) -> float:
        """Weight of the imitation of expert labels after some updates."""
        loss, done = self.loss, min(1.0, updates / self.training.expert_updates)
        return loss.expert + done * (loss.expert_end - loss.expert)

    def learning_rate_factor(self, updates: int) -> float:
        """Factor on both learning rates after some updates."""
        if self.training.learning_rate_decay is None:
            return 1.0
        first, last = self.training.learning_rate_decay
        done = min(1.0, max(0.0, (updates - first) / (last - first)))
        return 1.0 + done * (FINAL_LEARNING_RATE - 1.0)

    def override(self, changes: Mapping[str, Any]) -> Config:
        """Return a copy with some fields replaced, e.g. ``{"planner.horizon": 3}``.

        Raises:
            ConfigError: unknown field or value out of range.
        """
        document = self.model_dump()
        for key, value in changes.items():
            section, _, field = key.partition(".")
            document.setdefault(section, {})
            if not isinstance(document[section], dict) or not field:
                raise ConfigError(f"{key}: expected section.field, e.g. planner.horizon")
            document[section][field] = value
        return parse_config(document, source="override")


def load_config(path: str | Path | None = None) -> Config:
    """Read a configuration file; without a path, the shipped one.

    Raises:
        ConfigError: unreadable file, unknown key or value out of range.
    """
    path = Path(path) if path else Path(__file__).parent / "config.yaml"
    try:
        document = crowdbench.read_yaml(path)
    except crowdbench.YamlError as error:
        raise ConfigError(str(error)) from error
    if not isinstance(document, dict):
        raise ConfigError(f"{path}: expected sections {', '.join(Config.model_fields)}")
    return parse_config(document, source=str(path))


def with_present_names(document: Mapping[str, Any]) -> dict[str, Any]:
    """A stored configuration with the fields of ``STORED_NAMES`` called as they are now."""
    return {
        section: {STORED_NAMES.get((section, name), name): value for name, value in fields.items()}
        if isinstance(fields, Mapping)
        else fields
        for section, fields in document.items()
    }


def parse_config(document: Mapping[str, Any], source: str) -> Config:
    """Check a configuration.

    Raises:
        ConfigError: the message names the source, the field and what is allowed.
    """
    try:
        return Config.model_validate(document)
    except ValidationError as error:
        raise ConfigError(f"{source}: {explain(error, Config)}") from error
