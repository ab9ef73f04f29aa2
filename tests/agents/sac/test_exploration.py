"""Acting while SAC trains."""

import numpy as np
import pytest
import torch
from crowdbench_agents.learning.inputs import ActionBounds, Inputs, Sensed
from crowdbench_agents.sac.exploration import Explorer
from crowdbench_agents.sac.networks import encode, make_policy

import crowdbench

ROBOT = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario("multimodal_fast"))


@pytest.fixture
def sensed():
    """Observations of three environments."""
    rng = np.random.default_rng(0)
    maps = rng.integers(0, 256, (3, 16, 16), dtype=np.uint8)
    return Sensed(maps, *rng.normal(size=(2, 3, 2)).astype(np.float32))


def explorer(config, count=3):
    torch.manual_seed(0)
    return Explorer(make_policy(config), config, ActionBounds.of(ROBOT), np.arange(count), seed=1)


def test_actions_are_spread_around_the_policys_as_it_says(tiny, sensed):
    acting = explorer(tiny(), count=6000)
    drawn = acting.act(Sensed(*(np.concatenate([x] * 2000) for x in sensed))).action
    drawn = drawn.reshape(2000, 3, 2)
    assert acting.decisions == 6000
    policy = acting._network
    inputs = Inputs(*map(torch.from_numpy, sensed))
    with torch.no_grad():
        log_std = policy.log_std(policy.hidden(encode(policy.encoder, inputs, bfloat16=False)))
        mean = torch.arctanh(policy(inputs)).detach()
    before = np.arctanh(drawn.astype(float).clip(-1 + 1e-7, 1 - 1e-7))
    np.testing.assert_allclose(before.mean(axis=0), mean, atol=0.1)
    np.testing.assert_allclose(before.std(axis=0), log_std.exp(), rtol=0.1)


def test_without_demonstrations_it_acts_at_random_until_the_run_has_warmed_up(tiny, sensed):
    """60 decisions in three environments are 20 steps; others may make some of them."""
    acting = explorer(tiny(**{"training.demonstrations": 0, "training.warmup": 60}))
    for parameter in acting._network.parameters():
        parameter.data.zero_()
    acting._network.log_std.bias.data.fill_(-20.0)
    spread = [np.abs(acting.act(sensed).action).max() for _ in range(21)]
    assert min(spread[:20]) > 0.05
    assert spread[20] < 1e-6
    acting.decisions = 57
    assert np.abs(acting.act(sensed).action).max() > 0.05
    assert np.abs(acting.act(sensed).action).max() < 1e-6


def test_nothing_it_does_is_to_be_imitated(tiny, sensed):
    assert not explorer(tiny()).act(sensed).source.any()


def test_a_restored_explorer_goes_on_as_if_nothing_had_happened(tiny, sensed):
    first, second = explorer(tiny()), explorer(tiny())
    first.act(sensed)
    second.restore(first.state())
    assert np.array_equal(first.act(sensed).action, second.act(sensed).action)
    assert second.decisions == first.decisions == 6
