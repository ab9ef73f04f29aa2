"""Losses by hand, learning on a fixed batch, and runs that stop and go on."""

import contextlib
import json
import signal
from pathlib import Path

import numpy as np
import pytest
import torch
from crowdbench_agents.latent_planner.config import Config, ConfigError, Loss, load_config
from crowdbench_agents.latent_planner.crowds import Sensed
from crowdbench_agents.latent_planner.exploration import Explorer
from crowdbench_agents.latent_planner.learner import Learner, TrainingError
from crowdbench_agents.latent_planner.losses import (
    model_loss,
    policy_loss,
    target_steps,
    value_targets,
)
from crowdbench_agents.latent_planner.progress import Journal
from crowdbench_agents.latent_planner.replay import PLANNER, Batch
from crowdbench_agents.latent_planner.training import (
    Mixture,
    Run,
    load_checkpoint,
    run_folder,
    save_checkpoint,
    train,
)
from crowdbench_agents.latent_planner.validation import Validation
from crowdbench_agents.latent_planner.weights import load_world_model
from crowdbench_agents.latent_planner.world_model import ActionBounds, Inputs
from hypothesis import given, settings
from hypothesis import strategies as st

import crowdbench

TINY = {
    "perception.cells": 16, "model.latent": 32, "model.hidden": 32, "model.dynamics_hidden": 32,
    "training.environments": 4, "training.planning_environments": 2,
    "training.taught_environments": 1,
    "planner.candidates": 8, "planner.iterations": 1, "planner.elites": 4, "training.batch": 8,
    "training.replay": 2000, "training.warmup": 60, "training.demonstrations": 0,
    "training.pretraining": 0, "training.validation_episodes": 1, "planner.horizon": 3,
    "training.bfloat16": False,
}  # fmt: skip


def tiny(**changes):
    return load_config().override(TINY | changes)


def sequences(horizon, count, seed=0, cells=16):
    g = torch.Generator().manual_seed(seed)
    inputs = Inputs(
        torch.randint(0, 256, (horizon + 1, count, cells, cells), dtype=torch.uint8, generator=g),
        torch.rand(horizon + 1, count, 2, generator=g),
        torch.randn(horizon + 1, count, 2, generator=g),
    )
    ones, pair = torch.ones(horizon, count), torch.rand(horizon, count, 2, generator=g) * 2 - 1
    reward = torch.randn(horizon, count, generator=g)
    return Batch(inputs, pair, reward, 0 * ones, 0 * ones, ones, pair, ones, 0 * ones)


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


def test_steps_behind_the_end_of_an_episode_do_not_count():
    config = tiny()
    learner = Learner(config, seed=0)
    batch = sequences(3, 5)
    batch.valid[1:] = 0
    other = batch._replace(reward=batch.reward.clone())
    other.reward[1:] = 100.0
    noise = torch.zeros(3, 5, 2)
    loss = config.loss.model_copy(update={"n_step": 1})
    a, b = (model_loss(learner.model, learner.target, x, loss, noise) for x in (batch, other))
    assert a.total == b.total


class Linear:
    """A hand-made critic and policy for the policy's loss: Q = 2 a_0, a = noise, log pi = -1."""

    @staticmethod
    def sample(latents, noise):
        return noise, -torch.ones(noise.shape[:-1])

    @staticmethod
    def q(latents, action):
        value = 2 * action[..., 0]
        return torch.stack([value, value + 1])


def test_policy_loss_by_hand():
    batch = sequences(3, 1)
    reference = torch.tensor([[[0.5, 0.0]], [[0.0, 0.0]], [[1.0, 1.0]]])
    planned, taught = torch.tensor([[1.0], [0], [0]]), torch.tensor([[0.0], [0], [1]])
    batch = batch._replace(reference=reference, planned=planned, taught=taught)
    noise = torch.tensor([[[1.0, 1.0]], [[-1.0, 0.0]], [[0.0, 0.5]]])
    loss = Loss(imitation=3.0, horizon_decay=0.5, twin_minimum=True)
    result = policy_loss(Linear, torch.zeros(3, 1, 4), batch, loss, 0.1, 4.0, noise, 2.0)
    first = 0.1 * -1 - 2 / 4 + 3 * (0.25 + 1)
    second = 0.1 * -1 + 2 / 4
    third = 0.1 * -1 - 0 / 4 + 2 * (1 + 0.25)
    assert float(result.total) == pytest.approx((first + 0.5 * second + 0.25 * third) / 1.75)


def test_updates_on_a_fixed_batch_reduce_every_loss():
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


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ({"value": float("nan"), "latent_spread": 1.0}, "value is nan"),
        ({"value": 1.0, "latent_spread": 1e-4}, "latent state died"),
    ],
)
def test_a_dead_training_is_stopped(terms, message):
    with pytest.raises(TrainingError, match=message):
        Learner(tiny(), seed=0).check(terms)


def test_a_collapsed_encoder_is_noticed():
    learner = Learner(tiny(), seed=0)
    with torch.no_grad():
        for parameter in learner.model.encoder.fuse.parameters():
            parameter.zero_()
        learner.model.encoder.fuse.bias.normal_()
    terms = learner.update(sequences(3, 16))
    with pytest.raises(TrainingError, match="latent state died"):
        learner.check({key: float(value) for key, value in terms.items()})


def test_a_restored_learner_goes_on_as_if_nothing_had_happened(tmp_path):
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


def test_learning_rates_fall_between_two_counts_of_updates():
    rates = {"training.learning_rate_model": 1e-3, "training.learning_rate": 2e-3}
    learner = Learner(tiny(**rates, **{"training.learning_rate_decay": [2, 4]}), seed=0)
    seen = []
    for seed in range(6):
        learner.update(sequences(3, 8, seed))
        groups = [g for o in learner.state()["optimizers"].values() for g in o["param_groups"]]
        seen.append([group["lr"] for group in groups])
    first, half, last = [1e-3, 2e-3, 2e-3, 2e-3], [5.25e-4] + 3 * [1.05e-3], [5e-5] + 3 * [1e-4]
    np.testing.assert_allclose(seen, [first, first, first, half, last, last])


@pytest.mark.parametrize("decay", [[4, 4], [5, 4], [-1, 4], [3]])
def test_a_decay_without_length_is_refused(decay):
    with pytest.raises(ConfigError, match=r"training\.learning_rate_decay"):
        tiny(**{"training.learning_rate_decay": decay})


def test_epsilon_falls_from_a_half_to_a_twentieth_over_25000_decisions():
    config = Config()
    learner = Learner(tiny(), seed=0)
    robot = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario("unimodal_slow"))
    explorer = Explorer(learner.model, config, ActionBounds.of(robot), seed=0)
    seen = []
    for explorer.decisions in (0, 12_500, 25_000, 10**6):
        seen.append(explorer.epsilon)
    assert seen == pytest.approx([0.5, 0.275, 0.05, 0.05])


@pytest.mark.parametrize("reflect", [False, True])
def test_plans_are_examples_only_where_they_have_just_been_made(reflect):
    config = tiny(
        **{
            "training.planning_environments": 4, "training.taught_environments": 0,
            "planner.reflect": reflect,
        }
    )  # fmt: skip
    robot = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario("unimodal_slow"))
    explorer = Explorer(Learner(config, seed=0).model, config, ActionBounds.of(robot), seed=0)
    sensed = Sensed(
        np.zeros((4, 16, 16), np.uint8), np.zeros((4, 2), np.float32), np.ones((4, 2), np.float32)
    )
    examples = sum((explorer.act(sensed).source == PLANNER).sum() for _ in range(30))
    assert examples == explorer.decisions < 30 * 4


def test_the_mixture_draws_what_fails_more_often_and_training_seeds_only():
    mixture = Mixture(seed=3)
    for _ in range(500):
        for name in mixture.success:
            mixture.record(name, name != "corridor_dense")
    drawn = [next(mixture) for _ in range(1000)]
    share = np.mean([name == "corridor_dense" for name, _ in drawn])
    assert share == pytest.approx(1.1 / (1.1 + 11 * 0.1), abs=0.06)
    assert min(seed for _, seed in drawn) >= 1_000_000
    assert len({seed for _, seed in drawn}) == 1000


@pytest.fixture
def in_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(crowdbench, "scenario_names", lambda: ["corridor_sparse", "unimodal_slow"])
    return tmp_path


def test_a_run_trains_stops_and_goes_on(in_empty_folder):
    folder = train("short", steps=200, overrides=TINY)
    curve = in_empty_folder / "results/training/short.csv"
    lines = curve.read_text().splitlines()
    assert lines[0].startswith("steps,decisions,updates,seconds,success")
    updates = int(lines[-1].split(",")[2])
    assert int(lines[-1].split(",")[0]) == 200
    assert updates > 10
    with pytest.raises(TrainingError, match="holds a run"):
        train("short", steps=300, overrides=TINY)
    train("short", steps=300, resume=True, overrides=TINY)
    last = curve.read_text().splitlines()[-1].split(",")
    assert int(last[0]) == 300
    assert int(last[2]) > updates
    _, config = load_world_model(folder / "last.safetensors")
    assert config.model.latent == 32
    assert json.loads(json.dumps(TINY))["planner.horizon"] == config.planner.horizon


def test_a_run_is_not_resumed_in_other_worlds(in_empty_folder, monkeypatch):
    train("worlds", steps=100, overrides=TINY)
    monkeypatch.setattr(crowdbench, "scenario_names", lambda: ["corridor_sparse", "unimodal_fast"])
    with pytest.raises(TrainingError, match="scenarios have changed"):
        train("worlds", steps=200, resume=True, overrides=TINY)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_full_disk_is_told_and_leaves_the_checkpoint_before(tmp_path):
    save_checkpoint(tmp_path, {"updates": 7})
    (tmp_path / "checkpoint.part").symlink_to("/dev/full")
    with pytest.raises(TrainingError, match=r"checkpoint\.part: .* make room on the disk"):
        save_checkpoint(tmp_path, {"updates": 8, "weights": torch.zeros(100_000)})
    assert load_checkpoint(tmp_path)["updates"] == 7


def test_resuming_nothing_is_refused(tmp_path):
    with pytest.raises(TrainingError, match="nothing to resume"), run_folder(tmp_path, resume=True):
        pass


def test_a_run_that_is_being_trained_cannot_be_trained_by_another(tmp_path):
    folder = tmp_path / "run"
    refused = pytest.raises(TrainingError, match=r"run: another process is training this run")
    with run_folder(folder, resume=False), refused, run_folder(folder, resume=False):
        pass
    with run_folder(folder, resume=False):
        pass


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_arrives_in_a_callback_stops_a_run_at_a_whole_step(
    in_empty_folder, monkeypatch, number
):
    step = Run.step

    def interrupted(run):
        if run.steps == 40:
            with contextlib.suppress(KeyboardInterrupt):  # as C libraries do
                signal.raise_signal(number)
        step(run)

    monkeypatch.setattr(Run, "step", interrupted)
    folder = train("short", steps=400, overrides=TINY)
    assert json.loads(load_checkpoint(folder)["counters"])[0] == 44
    train("short", steps=80, resume=True, overrides=TINY)
    assert json.loads(load_checkpoint(folder)["counters"])[0] == 80


def test_a_learning_curve_keeps_the_columns_it_began_with(tmp_path):
    """An earlier version told no SPL."""
    curve = tmp_path / "curve.csv"
    counts = {"steps": 32, "decisions": 8, "updates": 1, "seconds": 2.0}
    result = Validation({"unimodal_slow": 0.5}, {"unimodal_slow": 0.25}, 0.125, 10.0)
    with Journal("run", tmp_path, curve, 100) as journal:
        journal.validated(result, counts, {})
        assert curve.read_text().splitlines() == [
            "steps,decisions,updates,seconds,success,spl,smoothness,time_to_goal,unimodal_slow",
            "32,8,1,2.0,0.5,0.25,0.125,10.0,0.5",
        ]
        curve.write_text("steps,success,unimodal_slow\n16,0.25,0.25\n")
        journal.validated(result, counts, {})
    assert curve.read_text() == "steps,success,unimodal_slow\n16,0.25,0.25\n32,0.5,0.5\n"
