"""SAC's training: it learns what its expert does, stops and goes on."""

import contextlib
import signal

import numpy as np
import pytest
import torch
from crowdbench_agents.learning import precision
from crowdbench_agents.learning.checkpoints import load_checkpoint
from crowdbench_agents.learning.config import load_config
from crowdbench_agents.sac.networks import FORMAT, load_actor
from crowdbench_agents.sac.training import BATCH, SacRun, train
from stable_baselines3 import SAC

TINY = {
    "perception.cells": 16, "model.latent": 32, "model.hidden": 32,
    "training.environments": 4, "training.planning_environments": 0,
    "training.labelled_environments": 2, "training.replay": 2000, "training.warmup": 60,
    "training.expert": "straight_line", "training.demonstrations": 600,
    "training.pretraining": 10, "training.validation_episodes": 1, "training.bfloat16": False,
}  # fmt: skip


def distance_from_expert(folder, **changes):
    """Mean squared distance of the actor from the demonstrations, before and after training."""
    config = load_config().override(TINY | changes)
    run = SacRun(folder / "run", config, seed=0, social=True)
    batch = run.demonstrations.sample(400, 1, np.random.default_rng(0))

    def error():
        seen = type(batch.inputs)(*(x[0] for x in batch.inputs))
        with torch.no_grad():
            off = (run.actor()(seen) - batch.reference[0]).square().sum(dim=-1)
        return float((off * batch.labelled[0]).sum() / batch.labelled[0].sum())

    before = error()
    for _ in range(150):
        run.update()
    assert run.updates == 150
    return before, error()


def test_the_actor_learns_what_the_expert_would_do(in_empty_folder):
    before, after = distance_from_expert(in_empty_folder)
    assert after < 0.3 * before


def test_without_the_weight_of_the_expert_it_does_not(in_empty_folder):
    off = {"loss.expert": 0.0, "loss.expert_end": 0.0}
    before, after = distance_from_expert(in_empty_folder, **off)
    assert after > 0.5 * before


def test_labels_reach_the_replay_of_labelled_environments_only(in_empty_folder):
    config = load_config().override(TINY)
    run = SacRun(in_empty_folder / "run", config, seed=0, social=True)
    run.model.learn(total_timesteps=80, log_interval=None)
    data = run.replay._data
    labelled = [data.source[lane, : run.replay.lengths()[lane]].any() for lane in range(4)]
    assert labelled == [False, False, True, True]
    assert run.model.replay_buffer.sampled.labelled.shape[1] == BATCH


def test_without_labelled_environments_nothing_is_labelled(in_empty_folder):
    config = load_config().override(TINY | {"training.labelled_environments": 0})
    run = SacRun(in_empty_folder / "run", config, seed=0, social=True)
    run.model.learn(total_timesteps=20, log_interval=None)
    assert not run.replay._data.source.any()


def test_learning_rates_fall_as_those_of_the_other_agents_do(in_empty_folder):
    changes = {"training.learning_rate": 1e-3, "training.learning_rate_decay": [10, 20]}
    config = load_config().override(TINY | changes)
    run = SacRun(in_empty_folder / "run", config, seed=0, social=True)
    model = run.model
    for updates, rate in ((0, 1e-3), (15, 5.25e-4), (30, 5e-5)):
        model._n_updates = updates
        model.train(1, BATCH)
        for optimizer in (model.actor.optimizer, model.critic.optimizer, model.ent_coef_optimizer):
            assert [g["lr"] for g in optimizer.param_groups] == pytest.approx([rate])


def test_a_run_trains_stops_and_goes_on(in_empty_folder):
    folder = train("short", steps=100, overrides=TINY)
    train("short", steps=160, resume=True, overrides=TINY)
    lines = (in_empty_folder / "results/training/short.csv").read_text().splitlines()
    steps = [int(line.split(",")[0]) for line in lines[1:]]
    updates = [int(line.split(",")[2]) for line in lines[1:]]
    assert steps == [0, 100, 160]
    assert updates[2] > updates[1] > updates[0] == TINY["training.pretraining"]
    _, config, _ = load_actor(folder / "last.safetensors")
    assert config.model.latent == 32


@pytest.mark.parametrize("pretraining", [0, 1000])
def test_a_signal_stops_a_run_before_and_after_its_pretraining(
    in_empty_folder, monkeypatch, pretraining
):
    train_ = SAC.train

    def interrupted(model, *args, **kwargs):
        train_(model, *args, **kwargs)
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(SAC, "train", interrupted)
    changes = TINY | {"training.pretraining": pretraining}
    folder = train("short", steps=10_000, overrides=changes)
    counters = load_checkpoint(folder, FORMAT)["counters"]
    assert counters["updates"] == 1
    assert counters["steps"] < 100


def test_networks_learn_in_bfloat16_where_the_cpu_is_fast_at_it(
    in_empty_folder, instructions, arithmetic
):
    config = load_config().override(TINY | {"training.bfloat16": True})
    run = SacRun(in_empty_folder / "run", config, seed=0, social=True)
    encoder = run.model.policy.actor.features_extractor.encoder
    assert arithmetic(encoder, run.update) == {torch.bfloat16 if instructions else torch.float32}
    assert run.facts["arithmetic"].startswith("bfloat16" if instructions else "float32 (this CPU")


def test_a_run_says_its_arithmetic_and_goes_on_in_another(in_empty_folder, monkeypatch, capsys):
    changes = TINY | {"training.bfloat16": True}
    for steps, instructions, said in ((20, True, "bfloat16"), (40, False, "float32 (this CPU")):
        monkeypatch.setattr(precision, "cpu_has_bfloat16", lambda has=instructions: has)
        train("moved", steps=steps, resume=steps > 20, overrides=changes)
        assert f"networks learn in {said}" in " ".join(capsys.readouterr().out.split())
