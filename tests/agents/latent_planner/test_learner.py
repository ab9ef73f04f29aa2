"""Learning on a fixed batch, and what stops it."""

import numpy as np
import pytest
import torch
from crowdbench_agents.latent_planner.learner import Learner
from crowdbench_agents.latent_planner.losses import encode_targets, model_loss, policy_loss
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.inputs import Inputs


def test_updates_on_a_fixed_batch_reduce_every_loss(tiny, sequences):
    changes = {
        "loss.imitation": 10.0, "loss.imitation_shaping": 0.0, "loss.entropy_target": -4.0,
        "training.reward_scale": 1.0,
    }  # fmt: skip
    learner = Learner(tiny(**changes), seed=0)
    batch = sequences(3, 16)
    history = [learner.update(batch) for _ in range(150)]
    for name in ("reward", "termination", "imitation"):
        before = np.mean([float(terms[name]) for terms in history[:5]])
        after = np.mean([float(terms[name]) for terms in history[-5:]])
        assert after < 0.8 * before, name
    learner.check({key: float(value) for key, value in history[-1].items()})


def test_an_update_is_that_of_the_plain_formula(tiny, sequences):
    """One network after the other, each with a graph of its own."""
    config = tiny(**{"training.gradient_clip": 0.5, "loss.n_step": 2})
    learner, plain = Learner(config, seed=0), Learner(config, seed=0)
    batch, loss = sequences(3, 8), config.loss
    batch = batch._replace(labelled=(batch.reward > 0).float())
    model, rates = plain.model, config.training
    for _ in range(3):  # networks that start at zero pass no gradients on
        expert_weight = config.expert_weight(learner.updates)
        learner.update(batch)
        scaled = batch._replace(reward=batch.reward * rates.reward_scale)
        noise = torch.randn(batch.action.shape, generator=plain.generator)
        targets = encode_targets(plain.target, scaled, loss, noise)
        z = model.encode(Inputs(*(x[0] for x in batch.inputs)))
        result = model_loss(model, z, targets, scaled, loss, expert_weight)
        policy = list(model.policy_network.parameters())
        others = [p for name, p in model.named_parameters() if not name.startswith("policy")]
        step(plain._optimizers["model"], result.total, others, rates.gradient_clip)
        noise = torch.randn(batch.action.shape, generator=plain.generator)
        drawn = model.sample(result.states, noise)
        actor = policy_loss(
            model, result.states, drawn, scaled, loss, plain.alpha, plain.q_scale, expert_weight
        )
        step(plain._optimizers["policy"], actor.total, policy, rates.gradient_clip)
        with torch.no_grad():
            spread = np.quantile(actor.values.numpy(), 0.95) - np.quantile(actor.values, 0.05)
            plain._q_scale += 0.01 * (max(spread, 1.0) - plain._q_scale)
            excess = actor.terms["entropy"] - loss.entropy_target
        step(plain._optimizers["alpha"], plain.log_alpha * excess, [plain.log_alpha], 0.5)
        with torch.no_grad():
            for slow, fast in zip(plain.target.parameters(), model.parameters(), strict=True):
                slow += rates.target_rate * (fast - slow)
    for found, expected in ((learner.model, model), (learner.target, plain.target)):
        for name, tensor in expected.state_dict().items():
            torch.testing.assert_close(found.state_dict()[name], tensor, msg=name)
    assert learner.alpha == pytest.approx(plain.alpha)
    assert learner.q_scale == pytest.approx(plain.q_scale)


def step(optimizer, loss, parameters, clip):
    """One step of an optimiser by the gradient of a loss."""
    for parameter in parameters:
        parameter.grad = None
    loss.backward(retain_graph=True)
    torch.nn.utils.clip_grad_norm_(parameters, clip)
    optimizer.step()


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ({"value": float("nan"), "latent_spread": 1.0}, "value is nan"),
        ({"value": 1.0, "latent_spread": 1e-4}, "latent state died"),
    ],
)
def test_a_dead_training_is_stopped(terms, message, tiny):
    with pytest.raises(TrainingError, match=message):
        Learner(tiny(), seed=0).check(terms)


def test_a_collapsed_encoder_is_noticed(tiny, sequences):
    learner = Learner(tiny(), seed=0)
    with torch.no_grad():
        for parameter in learner.model.encoder.fuse.parameters():
            parameter.zero_()
        learner.model.encoder.fuse.bias.normal_()
    terms = learner.update(sequences(3, 16))
    with pytest.raises(TrainingError, match="latent state died"):
        learner.check({key: float(value) for key, value in terms.items()})


def test_a_restored_learner_goes_on_as_if_nothing_had_happened(tmp_path, tiny, sequences):
    batches = [sequences(3, 8, seed=i) for i in range(6)]
    straight = Learner(tiny(), seed=0)
    for batch in batches:
        straight.update(batch)
    first = Learner(tiny(), seed=0)
    for batch in batches[:3]:
        first.update(batch)
    torch.save(first.state(), tmp_path / "state.pt")
    second = Learner(tiny(), seed=9)
    second.restore(torch.load(tmp_path / "state.pt", weights_only=True))
    for batch in batches[3:]:
        second.update(batch)
    for a, b in zip(straight.model.parameters(), second.model.parameters(), strict=True):
        assert torch.equal(a, b)
    assert (second.updates, second.alpha) == (straight.updates, straight.alpha)


def test_learning_rates_fall_between_two_counts_of_updates(tiny, sequences):
    rates = {"training.learning_rate_model": 1e-3, "training.learning_rate": 2e-3}
    learner = Learner(tiny(**rates, **{"training.learning_rate_decay": [2, 4]}), seed=0)
    seen = []
    for seed in range(6):
        learner.update(sequences(3, 8, seed))
        groups = [g for o in learner.state()["optimizers"].values() for g in o["param_groups"]]
        seen.append([group["lr"] for group in groups])
    first, half, last = [1e-3, 2e-3, 2e-3, 2e-3], [5.25e-4] + 3 * [1.05e-3], [5e-5] + 3 * [1e-4]
    np.testing.assert_allclose(seen, [first, first, first, half, last, last])


@pytest.mark.parametrize("asked", [True, False])
def test_networks_learn_in_bfloat16_where_it_is_asked_for_and_the_cpu_is_fast_at_it(
    instructions, asked, arithmetic, tiny, sequences
):
    learner = Learner(tiny(**{"training.bfloat16": asked}), seed=0)
    found = arithmetic(learner.model.encoder, lambda: learner.update(sequences(3, 4)))
    assert found == {torch.bfloat16 if asked and instructions else torch.float32}
