"""Losses by hand."""

import numpy as np
import pytest
import torch
from crowdbench_agents.latent_planner.learner import Learner
from crowdbench_agents.latent_planner.losses import (
    encode_targets,
    model_loss,
    policy_loss,
    target_steps,
    value_targets,
)
from crowdbench_agents.learning.batch import Batch
from crowdbench_agents.learning.config import Loss
from crowdbench_agents.learning.inputs import Inputs
from hypothesis import given, settings
from hypothesis import strategies as st


def returns_of(reward, end, valid, value, steps, discount=0.5):
    """Value targets of one sequence and where they are known, numbers in lists."""
    reward, end, valid, value = (
        torch.tensor(x, dtype=torch.float32)[:, None] for x in (reward, end, valid, value)
    )
    batch = Batch(None, None, reward, end, end, valid, None, None, None)
    returns, known = value_targets(batch, value, discount, steps)
    return returns[:, 0].tolist(), known[:, 0].tolist()


GO, VALID = [0, 0, 0], [1, 1, 1]


def test_value_targets_by_hand():
    reward = [1.0, 2.0, 4.0]
    assert returns_of(reward, GO, VALID, [10.0, 20, 40], 1) == ([6, 12, 24], [1, 1, 1])
    # V at steps 2 and 3: 1 + 2 / 2 + 20 / 4, 2 + 20 / 2, 4 + 40 / 2
    assert returns_of(reward, GO, VALID, [20.0, 40], 2) == ([7, 12, 24], [1, 1, 1])
    # V at step 3 alone: 1 + 2 / 2 + 4 / 4 + 40 / 8, 2 + 4 / 2 + 40 / 4, 4 + 40 / 2
    assert returns_of(reward, GO, VALID, [40.0], 3) == ([8, 14, 24], [1, 1, 1])


def test_nothing_is_added_behind_an_end():
    returns, known = returns_of([1.0, 2, 4], [0, 1, 0], [1, 1, 0], [40.0], 3)
    assert (returns[:2], known) == ([2, 2], [1, 1, 0])


def test_behind_the_time_limit_the_value_counts_where_it_is_known():
    assert returns_of([1.0, 2, 4], GO, [1, 1, 0], [20.0, 40], 2) == ([7, 12, 24], [1, 1, 0])
    assert returns_of([1.0, 2, 4], GO, [1, 1, 0], [40.0], 3)[1] == [0, 0, 0]


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 9), st.integers(1, 4), st.integers(0, 1000))
def test_value_targets_sum_rewards_up_to_the_next_target_step(horizon, steps, seed):
    rng = np.random.default_rng(seed)
    reward, values = rng.normal(size=horizon), rng.normal(size=horizon + 1)
    at = target_steps(horizon, steps)
    found, _ = returns_of(
        reward.tolist(), [0] * horizon, [1] * horizon, values[at].tolist(), steps, discount=0.9
    )
    for t in range(horizon):
        until = next(k for k in at if k > t)
        sum_ = sum(0.9 ** (k - t) * reward[k] for k in range(t, until))
        assert found[t] == pytest.approx(sum_ + 0.9 ** (until - t) * values[until], abs=1e-5)


def test_steps_behind_the_end_of_an_episode_do_not_count(tiny, sequences):
    config = tiny()
    learner = Learner(config, seed=0)
    batch = sequences(3, 5)
    batch.valid[1:] = 0
    other = batch._replace(reward=batch.reward.clone())
    other.reward[1:] = 100.0
    noise = torch.zeros(3, 5, 2)
    loss = config.loss.model_copy(update={"n_step": 1})
    z = learner.model.encode(Inputs(*(x[0] for x in batch.inputs)))
    a, b = (
        model_loss(learner.model, z, encode_targets(learner.target, x, loss, noise), x, loss)
        for x in (batch, other)
    )
    assert a.total == b.total


@pytest.mark.parametrize("last", [(3, 3, 3), (1, 3, 2), (1, 1, 1)])
def test_targets_are_those_of_all_observations_where_these_count(last, tiny, sequences):
    """Each on its own; none is encoded behind the end, not even where that leaves none."""
    config = tiny(**{"loss.n_step": 3})
    model, loss, batch = Learner(config, seed=0).target, config.loss, sequences(3, 3)
    torch.nn.init.normal_(model.q_networks[0][-1].weight)
    seen = []
    model.encoder.register_forward_pre_hook(lambda _, inputs: seen.append(len(inputs[0].goal)))
    for sequence, length in enumerate(last):
        batch.valid[length:, sequence] = 0
    noise = torch.randn(3, 3, 2, generator=torch.Generator().manual_seed(0))
    found = encode_targets(model, batch, loss, noise)
    assert seen == [last.count(3)]
    for sequence, length in enumerate(last):
        if length < 3:
            assert not found.known[:, sequence].any()
            continue
        z = model.encode(Inputs(*(x[3, [sequence]] for x in batch.inputs)))
        value = model.q(z, model.sample(z, noise[0, [sequence]])[0]).amin()
        torch.testing.assert_close(found.z[0, [sequence]], z)
        last_reward = batch.reward[2, sequence]
        torch.testing.assert_close(found.returns[2, sequence], last_reward + loss.discount * value)


class Linear:
    """A hand-made critic for the policy's loss: Q = 2 a_0."""

    @staticmethod
    def q_along_action(latents, action):
        value = 2 * action[..., 0]
        return torch.stack([value, value + 1])


def test_policy_loss_by_hand(sequences):
    batch = sequences(3, 1)
    reference = torch.tensor([[[0.5, 0.0]], [[0.0, 0.0]], [[1.0, 1.0]]])
    planned, labelled = torch.tensor([[1.0], [0], [0]]), torch.tensor([[0.0], [0], [1]])
    batch = batch._replace(reference=reference, planned=planned, labelled=labelled)
    action = torch.tensor([[[1.0, 1.0]], [[-1.0, 0.0]], [[0.0, 0.5]]])
    drawn = action, -torch.ones(3, 1)
    loss = Loss(imitation=3.0, horizon_decay=0.5, twin_minimum=True)
    result = policy_loss(Linear, torch.zeros(3, 1, 4), drawn, batch, loss, 0.1, 4.0, 2.0)
    first = 0.1 * -1 - 2 / 4 + 3 * (0.25 + 1)
    second = 0.1 * -1 + 2 / 4
    third = 0.1 * -1 - 0 / 4 + 2 * (1 + 0.25)
    assert float(result.total) == pytest.approx((first + 0.5 * second + 0.25 * third) / 1.75)
