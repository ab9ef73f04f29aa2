"""What Stable-Baselines3's SAC learns from, in its forms: crowds, replay and encoder."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from crowdbench_agents.latent_planner.config import Config, Model
from crowdbench_agents.latent_planner.crowds import Crowds
from crowdbench_agents.latent_planner.demonstrations import Teachers, final_rows
from crowdbench_agents.latent_planner.replay import NOBODY, TEACHER, Batch, Replay, Rows, join
from crowdbench_agents.latent_planner.training import Mixture
from crowdbench_agents.latent_planner.world_model import Encoder, Inputs
from gymnasium import spaces
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor
from torch.nn.functional import layer_norm


class MapFeatures(BaseFeaturesExtractor):
    """The latent planner's encoder as a features extractor."""

    def __init__(self, space: spaces.Dict, cells: int, settings: Model, bfloat16: bool) -> None:
        super().__init__(space, settings.latent)
        self.encoder = Encoder(cells, settings.latent, settings.encoder)
        self._bfloat16 = bfloat16

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Observations (B, ...) -> features (B, latent)."""
        bits = observations["map"].to(torch.uint8)
        inputs = Inputs(bits, observations["velocity"], observations["goal"])
        with torch.autocast("cpu", torch.bfloat16, enabled=self._bfloat16):
            z = self.encoder(inputs).float()
        return layer_norm(z, z.shape[-1:])


class CrowdVecEnv(VecEnv):
    """The crowds as Stable-Baselines3 wants them: automatic reset, actions in [-1, 1].

    What the teacher advises where there is one is in the infos of the step (``advice``).
    """

    def __init__(self, crowds: Crowds, mixture: Mixture, teachers: Teachers) -> None:
        cells = crowds.sensed.map.shape[-1]
        space = spaces.Dict(
            {
                "map": spaces.Box(0, 255, (cells, cells), np.uint8),
                "velocity": spaces.Box(-np.inf, np.inf, (2,), np.float32),
                "goal": spaces.Box(-np.inf, np.inf, (2,), np.float32),
            }
        )
        self.crowds, self._mixture, self._teachers = crowds, mixture, teachers
        self._everywhere = np.arange(crowds.count)
        super().__init__(crowds.count, space, spaces.Box(-1, 1, (2,), np.float32))

    def reset(self) -> dict[str, np.ndarray]:
        """Begin an episode in every environment."""
        self._begin(self._everywhere)
        return self._sensed()

    def step_async(self, actions: np.ndarray) -> None:
        """Remember the actions."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Step every environment and begin again where an episode is over."""
        crowds = self.crowds
        advice = dict(zip(self._teachers.which, self._teachers.advise(), strict=True))
        result = crowds.step(self._everywhere, crowds.bounds.physical(self._actions))
        infos: list[dict[str, Any]] = [
            {"social": social, "collision": outcome == "collision"}
            for social, outcome in zip(result.social, result.outcome, strict=True)
        ]
        for index, action in advice.items():
            infos[index]["advice"] = action
        over = np.flatnonzero(result.over)
        for index in over:
            infos[index]["terminal_observation"] = {
                key: value[index].copy() for key, value in self._sensed().items()
            }
            infos[index]["TimeLimit.truncated"] = not result.end[index]
            success = result.outcome[index] == "success"
            self._mixture.record(crowds.scenario[index], success)
        self._begin(over)
        return self._sensed(), result.reward, result.over, infos

    def _begin(self, which: np.ndarray) -> None:
        self.crowds.begin(which)
        self._teachers.begin(which)

    def _sensed(self) -> dict[str, np.ndarray]:
        return {key: value.copy() for key, value in self.crowds.sensed._asdict().items()}

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
    """The latent planner's replay, with demonstrations, behind Stable-Baselines3's interface."""

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        device: Any = "cpu",
        n_envs: int = 1,
        optimize_memory_usage: bool = False,
        *,
        config: Config,
        replay: Replay,
        demonstrations: Replay | None,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(1, observation_space, action_space, device, n_envs=n_envs)
        self._config, self._replay, self._demonstrations = config, replay, demonstrations
        self._rng = rng
        self.advice: Batch | None = None
        """What was sampled last, with what the teacher advised in it."""

    def add(self, obs, next_obs, action, reward, done, infos) -> None:
        """Keep one step of every environment."""
        lanes, count = np.arange(self.n_envs), self.n_envs
        social = np.array([info["social"] for info in infos], np.float32)
        late = np.array([info.get("TimeLimit.truncated", False) for info in infos])
        collided = np.array([info["collision"] for info in infos])
        no, reference = np.zeros(count, bool), np.zeros((count, 2), np.float32)
        source = np.full(count, NOBODY, np.uint8)
        for index, info in enumerate(infos):
            if "advice" in info:
                reference[index], source[index] = info["advice"], TEACHER
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

    def sample(self, batch_size: int, env: Any = None) -> DictReplayBufferSamples:
        """Draw n-step transitions, a share of them from the demonstrations."""
        settings, loss = self._config.training, self._config.loss
        options = loss.n_step, self._rng, settings.collision_share, settings.reflect
        shown = 0
        if self._demonstrations is not None:
            begun = len(self._replay) >= settings.warmup
            shown = round(settings.demonstration_share * batch_size) if begun else batch_size
        parts = []
        if shown < batch_size:
            parts.append(self._replay.sample(batch_size - shown, *options))
        if self._demonstrations is not None and shown:
            parts.append(self._demonstrations.sample(shown, *options))
        batch = join(*parts) if len(parts) == 2 else parts[0]
        self.advice = batch
        return n_step(batch, loss.discount, settings.reward_scale)


def n_step(batch: Batch, discount: float, scale: float) -> DictReplayBufferSamples:
    """Sum the rewards of sequences up to their end; see value_targets of the latent planner."""
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
