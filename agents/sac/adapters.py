"""What Stable-Baselines3's SAC learns from, in its forms: environments, replay and encoder."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from crowdbench_agents.learning.batch import Batch
from crowdbench_agents.learning.config import Config, Model
from crowdbench_agents.learning.encoder import Encoder
from crowdbench_agents.learning.experts import Experts
from crowdbench_agents.learning.inputs import Inputs
from crowdbench_agents.learning.precision import training_precision
from crowdbench_agents.learning.replay import EXPERT, NOBODY, Replay, Rows, final_rows
from crowdbench_agents.learning.sampler import ScenarioSampler
from crowdbench_agents.learning.vector_env import VectorEnv
from gymnasium import spaces
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor
from torch.nn.functional import layer_norm

Observations = dict[str, np.ndarray]
"""Maps, velocities and goals of all environments."""


class MapFeatures(BaseFeaturesExtractor):
    """The encoder of learned agents as a features extractor."""

    def __init__(self, space: spaces.Dict, cells: int, settings: Model, bfloat16: bool) -> None:
        super().__init__(space, settings.latent)
        self.encoder = Encoder(cells, settings.latent, settings.encoder)
        self._bfloat16 = bfloat16

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Observations (B, ...) -> features (B, latent)."""
        bits = observations["map"].to(torch.uint8)
        inputs = Inputs(bits, observations["velocity"], observations["goal"])
        with training_precision(self._bfloat16):
            z = self.encoder(inputs).float()
        return layer_norm(z, z.shape[-1:])


class CrowdVecEnv(VecEnv):
    """The environments as Stable-Baselines3 wants them: automatic reset, actions in [-1, 1].

    The expert's label, where there is an expert, is in the infos of the step (``label``).
    """

    def __init__(self, envs: VectorEnv, sampler: ScenarioSampler, experts: Experts) -> None:
        cells = envs.sensed.map.shape[-1]
        space = spaces.Dict(
            {
                "map": spaces.Box(0, 255, (cells, cells), np.uint8),
                "velocity": spaces.Box(-np.inf, np.inf, (2,), np.float32),
                "goal": spaces.Box(-np.inf, np.inf, (2,), np.float32),
            }
        )
        self.envs, self._sampler, self._experts = envs, sampler, experts
        self._everywhere = np.arange(envs.count)
        super().__init__(envs.count, space, spaces.Box(-1, 1, (2,), np.float32))

    def reset(self) -> Observations:
        """Begin an episode in every environment."""
        self._begin(self._everywhere)
        return self._sensed()

    def step_async(self, actions: np.ndarray) -> None:
        """Remember the actions."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Step every environment and begin again where an episode is over."""
        envs = self.envs
        labels = dict(zip(self._experts.which, self._experts.labels(), strict=True))
        result = envs.step(self._everywhere, envs.bounds.physical(self._actions))
        infos: list[dict[str, Any]] = [
            {"social": social, "collision": outcome == "collision"}
            for social, outcome in zip(result.social, result.outcome, strict=True)
        ]
        for index, action in labels.items():
            infos[index]["label"] = action
        over = np.flatnonzero(result.over)
        for index in over:
            infos[index]["terminal_observation"] = {
                key: value[index].copy() for key, value in self._sensed().items()
            }
            infos[index]["TimeLimit.truncated"] = not result.end[index]
            success = result.outcome[index] == "success"
            self._sampler.record(envs.scenario[index], success)
        self._begin(over)
        return self._sensed(), result.reward, result.over, infos

    def _begin(self, which: np.ndarray) -> None:
        self.envs.begin(which)
        self._experts.begin(which)

    def _sensed(self) -> Observations:
        return {key: value.copy() for key, value in self.envs.sensed._asdict().items()}

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """No attributes but the render mode are asked for."""
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Nothing can be set."""

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kw: Any) -> list[Any]:
        """No methods are offered."""
        return []

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Nothing is wrapped."""
        return [False] * self.num_envs


class CrowdReplay(DictReplayBuffer):
    """The replay of learned agents, with demonstrations, behind Stable-Baselines3's interface."""

    sampled: Batch
    """What was sampled last, with its expert labels."""

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Dict,
        action_space: spaces.Space,
        device: Any = "cpu",
        n_envs: int = 1,
        optimize_memory_usage: bool = False,
        *,
        config: Config,
        replay: Replay,
        draw: Callable[[int, int], Batch],
    ) -> None:
        super().__init__(1, observation_space, action_space, device, n_envs=n_envs)
        self._config, self._replay, self._draw = config, replay, draw

    def add(  # type: ignore[override]
        self,
        obs: Observations,
        next_obs: Observations,
        action: np.ndarray,
        reward: np.ndarray,
        done: np.ndarray,
        infos: list[dict[str, Any]],
    ) -> None:
        """Keep one step of every environment."""
        lanes, count = np.arange(self.n_envs), self.n_envs
        social = np.array([info["social"] for info in infos], np.float32)
        late = np.array([info.get("TimeLimit.truncated", False) for info in infos])
        collided = np.array([info["collision"] for info in infos])
        no, reference = np.zeros(count, bool), np.zeros((count, 2), np.float32)
        source = np.full(count, NOBODY, np.uint8)
        for index, info in enumerate(infos):
            if "label" in info:
                reference[index], source[index] = info["label"], EXPERT
        self._replay.append(
            lanes,
            Rows(
                obs["map"], obs["velocity"], obs["goal"], action, reward, social, done & ~late,
                collided, no, reference, source,
            ),
        )  # fmt: skip
        over = np.flatnonzero(done)
        if len(over):
            last = (next_obs[key][over] for key in ("map", "velocity", "goal"))
            self._replay.append(over, final_rows(*last))

    def sample(  # type: ignore[override]
        self, batch_size: int, env: Any = None
    ) -> DictReplayBufferSamples:
        """Draw n-step transitions, a share of them from the demonstrations."""
        loss, scale = self._config.loss, self._config.training.reward_scale
        self.sampled = self._draw(batch_size, loss.n_step)
        return n_step(self.sampled, loss.discount, scale)


def n_step(batch: Batch, discount: float, scale: float) -> DictReplayBufferSamples:
    """Sum the rewards of sequences up to their end; as the latent planner's value targets do."""
    powers = discount ** torch.arange(len(batch.reward))[:, None]
    reward = (batch.reward * batch.valid * powers).sum(dim=0) * scale
    length = batch.valid.sum(dim=0).long()
    columns = torch.arange(len(length))
    return DictReplayBufferSamples(
        observations={key: value[0] for key, value in batch.inputs._asdict().items()},
        actions=batch.action[0],
        next_observations={
            key: value[length, columns] for key, value in batch.inputs._asdict().items()
        },
        dones=(batch.end * batch.valid).amax(dim=0)[:, None],
        rewards=reward[:, None],
        discounts=(discount**length)[:, None],
    )
