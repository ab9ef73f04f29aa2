"""SAC's update against Stable-Baselines3's."""

import gymnasium
import numpy as np
import pytest
import torch
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.sac.learner import Learner, transitions
from gymnasium import spaces
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.type_aliases import DictReplayBufferSamples


class Unused(gymnasium.Env):
    """Says what is seen and done, and is never stepped."""

    action_space = spaces.Box(-1, 1, (2,))

    def __init__(self, space):
        self.observation_space = space


def in_their_form(batch, discount, scale):
    """The n-step transitions of a batch, each summed on its own."""
    returns, discounts, ends, later = [], [], [], []
    for b in range(batch.reward.shape[1]):
        length = int(batch.valid[:, b].sum())
        rewards = batch.reward[:length, b].tolist()
        returns.append(scale * sum(discount**i * reward for i, reward in enumerate(rewards)))
        discounts.append(discount**length)
        ends.append(float(batch.end[:length, b].any()))
        later.append(length)
    columns = torch.arange(len(later))
    inputs = batch.inputs._asdict().items()
    return DictReplayBufferSamples(
        observations={key: value[0] for key, value in inputs},
        actions=batch.action[0],
        next_observations={key: value[later, columns] for key, value in inputs},
        dones=torch.tensor(ends)[:, None],
        rewards=torch.tensor(returns)[:, None],
        discounts=torch.tensor(discounts)[:, None],
    )


def of_their_networks(model):
    """Parameters of Stable-Baselines3's networks under our names."""
    theirs = model.actor
    actor = {
        "encoder": theirs.features_extractor.encoder, "hidden": theirs.latent_pi,
        "mean": theirs.mu, "log_std": theirs.log_std,
    }  # fmt: skip

    def critic(of):
        encoder = {"encoder": of.features_extractor.encoder}
        return encoder | {f"q_networks.{i}": network for i, network in enumerate(of.q_networks)}

    networks = {"actor": actor, "critic": critic(model.critic)}
    networks["target"] = critic(model.critic_target)
    return {
        name: {f"{part}.{key}": value for part, module in parts.items()
               for key, value in module.state_dict().items()}
        for name, parts in networks.items()
    }  # fmt: skip


def imitating(model, batch, noise, weight):
    """Adds the gradient of weight |a - a_expert|^2, averaged over the batch, to the actor's."""

    def add(*_):
        seen = {key: value[0] for key, value in batch.inputs._asdict().items()}
        mean, log_std, _ = model.actor.get_action_dist_params(seen)
        action = torch.tanh(mean + log_std.exp() * noise)
        error = (action - batch.reference[0]).square().sum(dim=1) * batch.labelled[0]
        (weight * error.mean()).backward()

    return model.actor.optimizer.register_step_pre_hook(add)


def test_updates_are_those_of_stable_baselines(tiny, sequences, reference_sac, space, monkeypatch):
    changes = {"loss.expert": 2.0, "loss.expert_end": 0.5, "training.expert_updates": 4}
    config = tiny(**changes, **{"training.target_rate": 0.2})
    ours, model = Learner(config, seed=0), reference_sac(config, Unused(space), seed=1)
    networks = {"actor": ours.actor, "critic": ours.critic, "target": ours.target}
    for name, tensors in of_their_networks(model).items():
        networks[name].load_state_dict(tensors)
    model.set_logger(Logger(None, []))
    for number in range(5):
        batch = sequences(3, 64, seed=number)
        noise = torch.randn(2, 64, 2, generator=torch.Generator().manual_seed(number))
        with monkeypatch.context() as patched:
            patched.setattr(torch, "randn", lambda *_, noise=noise, **__: noise)
            terms = ours.update(batch)
        samples = in_their_form(batch, config.loss.discount, config.training.reward_scale)
        draws = iter(noise)
        hook = imitating(model, batch, noise[0], config.expert_weight(number))
        with monkeypatch.context() as patched:
            patched.setattr(model.replay_buffer, "sample", lambda *_, s=samples, **__: s)
            patched.setattr(
                "torch.distributions.normal._standard_normal", lambda *_, d=draws, **__: next(d)
            )
            model.train(1, 64)
        hook.remove()
        told = model.logger.name_to_value
        imitation = config.expert_weight(number) * float(terms["expert"])
        imitation *= float(batch.labelled[0].mean())
        assert float(terms["critic"]) == pytest.approx(told["train/critic_loss"], rel=1e-4)
        assert float(terms["actor"]) - imitation == pytest.approx(
            told["train/actor_loss"], rel=1e-4, abs=1e-5
        )
        assert float(ours.log_alpha.detach()) == pytest.approx(model.log_ent_coef.item(), rel=1e-5)
    for name, tensors in of_their_networks(model).items():
        state = networks[name].state_dict()
        assert state.keys() == tensors.keys()
        for key, value in tensors.items():
            torch.testing.assert_close(state[key], value, rtol=1e-4, atol=1e-5, msg=key)


def test_a_transition_ends_at_the_end_of_its_episode(sequences):
    """Rewards 1, 2, 4: all steps; an arrival by the second; the time limit after the second."""
    batch = sequences(3, 3)
    reward = torch.tensor([[1.0, 1, 1], [2, 2, 2], [4, 4, 4]])
    valid, end = torch.ones(3, 3), torch.zeros(3, 3)
    valid[2, 1:], end[1, 1] = 0.0, 1.0
    made = transitions(batch._replace(reward=reward, valid=valid, end=end), 0.5)
    assert made.returns.tolist() == [3.0, 2.0, 2.0]
    assert made.discount.tolist() == [0.125, 0.0, 0.25]
    for before, after in zip(batch.inputs, made.later, strict=True):
        assert torch.equal(after[0], before[3, 0])
        assert torch.equal(after[1:], before[2, 1:])


def test_the_entropy_coefficient_seeks_the_wanted_entropy(tiny, sequences):
    """More of it where the policy is too certain, less where it is not, -2 nats by default."""
    for wanted, rises in ((50.0, True), (-50.0, False)):
        learner = Learner(tiny(**{"loss.entropy_target": wanted}), seed=0)
        before = learner.alpha
        learner.update(sequences(3, 8))
        assert (learner.alpha > before) == rises
    learners = [Learner(tiny(**{"loss.entropy_target": wanted}), 0) for wanted in (None, -2.0)]
    for learner in learners:
        learner.update(sequences(3, 8))
    assert learners[0].alpha == learners[1].alpha


def test_learning_rates_fall_as_those_of_the_other_agents_do(tiny, sequences):
    changes = {"training.learning_rate": 1e-3, "training.learning_rate_decay": [2, 4]}
    learner, seen = Learner(tiny(**changes), seed=0), []
    for seed in range(6):
        learner.update(sequences(3, 8, seed))
        groups = [g for o in learner.state()["optimizers"].values() for g in o["param_groups"]]
        seen.append([group["lr"] for group in groups])
    rates = [1e-3, 1e-3, 1e-3, 5.25e-4, 5e-5, 5e-5]
    np.testing.assert_allclose(seen, [[rate] * 3 for rate in rates])


def test_a_restored_learner_goes_on_as_if_nothing_had_happened(tmp_path, tiny, sequences):
    batches = [sequences(3, 8, seed=i) for i in range(4)]
    straight, first, second = (Learner(tiny(), seed) for seed in (0, 0, 9))
    for batch in batches:
        straight.update(batch)
    for batch in batches[:2]:
        first.update(batch)
    torch.save(first.state(), tmp_path / "state.pt")
    second.restore(torch.load(tmp_path / "state.pt", weights_only=True))
    for batch in batches[2:]:
        second.update(batch)
    for name in ("actor", "critic", "target"):
        pairs = zip(
            getattr(straight, name).parameters(), getattr(second, name).parameters(), strict=True
        )
        assert all(torch.equal(a, b) for a, b in pairs), name
    assert (second.updates, second.alpha) == (straight.updates, straight.alpha)


def test_a_diverged_training_is_stopped(tiny, sequences):
    learner = Learner(tiny(), seed=0)
    terms = learner.update(sequences(3, 8))
    learner.check({key: float(value) for key, value in terms.items()})
    with torch.no_grad():
        learner.actor.mean.bias[0] = float("nan")
    terms = learner.update(sequences(3, 8))
    with pytest.raises(TrainingError, match="is nan after 2 updates; lower the learning rate"):
        learner.check({key: float(value) for key, value in terms.items()})


@pytest.mark.parametrize("asked", [True, False])
def test_networks_learn_in_bfloat16_where_it_is_asked_for_and_the_cpu_is_fast_at_it(
    instructions, asked, arithmetic, tiny, sequences
):
    learner = Learner(tiny(**{"training.bfloat16": asked}), seed=0)
    for network in (learner.actor, learner.critic, learner.target):
        found = arithmetic(network.encoder, lambda: learner.update(sequences(3, 4)))
        assert found == {torch.bfloat16 if asked and instructions else torch.float32}
