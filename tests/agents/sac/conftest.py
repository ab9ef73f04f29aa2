"""A SAC small enough to be trained in a test, and Stable-Baselines3's as the reference."""

import pytest
import torch
from crowdbench_agents.learning.batch import Batch
from crowdbench_agents.learning.encoder import Encoder
from crowdbench_agents.learning.inputs import Inputs
from gymnasium import spaces
from stable_baselines3 import SAC
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch.nn.functional import layer_norm


@pytest.fixture
def overrides(small):
    """Configuration fields that make a small one."""
    return small | {
        "training.planning_environments": 0, "training.labelled_environments": 2,
        "training.expert": "straight_line", "training.demonstrations": 600,
        "training.pretraining": 10,
    }  # fmt: skip


@pytest.fixture
def sequences():
    """Makes a batch of random sequences, some of which end and some of which are cut short."""

    def make(horizon, count, seed=0):
        g = torch.Generator().manual_seed(seed)
        maps = torch.randint(0, 256, (horizon + 1, count, 16, 16), dtype=torch.uint8, generator=g)
        inputs = Inputs(
            maps, torch.rand(horizon + 1, count, 2, generator=g),
            torch.randn(horizon + 1, count, 2, generator=g),
        )  # fmt: skip
        length = torch.randint(1, horizon + 1, (count,), generator=g)
        step = torch.arange(horizon)[:, None]
        valid = (step < length).float()
        ended = torch.rand(count, generator=g) < 0.3
        end = ((step == length - 1) & ended).float()
        action, reference = torch.rand(2, horizon, count, 2, generator=g) * 2 - 1
        reward = torch.randn(horizon, count, generator=g)
        labelled = (torch.rand(horizon, count, generator=g) < 0.5) * valid
        no = torch.zeros(horizon, count)
        return Batch(inputs, action, reward, end, no, valid, reference, no, labelled)

    return make


class Features(BaseFeaturesExtractor):
    """The encoder of learned agents in front of Stable-Baselines3's networks."""

    def __init__(self, space, config):
        super().__init__(space, config.model.latent)
        model = config.model
        self.encoder = Encoder(config.perception.cells, model.latent, model.encoder)

    def forward(self, seen):
        z = self.encoder(Inputs(seen["map"].to(torch.uint8), seen["velocity"], seen["goal"]))
        return layer_norm(z, z.shape[-1:])


@pytest.fixture
def reference_sac():
    """Makes Stable-Baselines3's SAC with the settings of a configuration."""

    def make(config, env, **options):
        hidden, loss = config.model.hidden, config.loss
        return SAC(
            "MultiInputPolicy", env, learning_rate=config.training.learning_rate,
            tau=config.training.target_rate, gamma=loss.discount, ent_coef=f"auto_{loss.entropy}",
            target_entropy=loss.entropy_target, device="cpu",
            policy_kwargs={
                "net_arch": [hidden, hidden], "features_extractor_class": Features,
                "features_extractor_kwargs": {"config": config},
            },
            **options,
        )  # fmt: skip

    return make


@pytest.fixture
def space():
    """Of the observations of learned agents."""
    pair = spaces.Box(-10, 10, (2,))
    maps = spaces.Box(0, 255, (16, 16), "uint8")
    return spaces.Dict({"map": maps, "velocity": pair, "goal": pair})
