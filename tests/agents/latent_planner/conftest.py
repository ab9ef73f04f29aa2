"""A latent planner small enough to be trained in a test."""

import pytest
import torch
from crowdbench_agents.learning.batch import Batch
from crowdbench_agents.learning.inputs import Inputs


@pytest.fixture
def overrides(small):
    """Configuration fields that make a small one."""
    return small | {
        "model.dynamics_hidden": 32, "training.planning_environments": 2,
        "training.labelled_environments": 1, "planner.candidates": 8, "planner.iterations": 1,
        "planner.elites": 4, "planner.horizon": 3, "training.batch": 8,
        "training.demonstrations": 0, "training.pretraining": 0,
    }  # fmt: skip


@pytest.fixture
def sequences():
    """Makes a batch of random sequences."""
    return random_sequences


def random_sequences(horizon, count, seed=0, cells=16):
    g = torch.Generator().manual_seed(seed)
    inputs = Inputs(
        torch.randint(0, 256, (horizon + 1, count, cells, cells), dtype=torch.uint8, generator=g),
        torch.rand(horizon + 1, count, 2, generator=g),
        torch.randn(horizon + 1, count, 2, generator=g),
    )
    ones, pair = torch.ones(horizon, count), torch.rand(horizon, count, 2, generator=g) * 2 - 1
    reward = torch.randn(horizon, count, generator=g)
    return Batch(inputs, pair, reward, 0 * ones, 0 * ones, ones, pair, ones, 0 * ones)
