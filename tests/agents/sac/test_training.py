"""SAC's training: it learns what its expert does, stops and goes on."""

import contextlib
import signal

import numpy as np
import pytest
import torch
from crowdbench_agents.learning import precision
from crowdbench_agents.learning.checkpoints import load_checkpoint
from crowdbench_agents.learning.detour import require_straight_ways
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.experts import Experts
from crowdbench_agents.learning.run import TrainingRun
from crowdbench_agents.learning.settings import RunSettings
from crowdbench_agents.learning.worlds import as_they_are
from crowdbench_agents.sac.learner import Learner
from crowdbench_agents.sac.networks import FORMAT, load_actor
from crowdbench_agents.sac.training import KIND, train
from full_disk import room_for

import crowdbench


def distance_from_expert(folder, config):
    """Mean squared distance of the actor from the demonstrations, before and after training."""
    run = TrainingRun(KIND, folder / "run", RunSettings("sac", config), torch.device("cpu"), 0)
    run.demonstrations.record([].append, lambda: False)
    run.learner.count, actor = 64, run.learner.actor
    batch = run.demonstrations.sample(400, 1, np.random.default_rng(0))

    def error():
        seen = type(batch.inputs)(*(x[0] for x in batch.inputs))
        with torch.no_grad():
            off = (actor(seen) - batch.reference[0]).square().sum(dim=-1)
        return float((off * batch.labelled[0]).sum() / batch.labelled[0].sum())

    before = error()
    for _ in range(150):
        run.update()
    assert run.updates == 150
    return before, error()


def test_the_actor_learns_what_the_expert_would_do(in_empty_folder, tiny):
    before, after = distance_from_expert(in_empty_folder, tiny())
    assert after < 0.3 * before


def test_without_the_weight_of_the_expert_it_does_not(in_empty_folder, tiny):
    off = {"loss.expert": 0.0, "loss.expert_end": 0.0}
    before, after = distance_from_expert(in_empty_folder, tiny(**off))
    assert after > 0.5 * before


def test_where_a_map_is_trained_in_detours_have_no_price(in_empty_folder, overrides, monkeypatch):
    monkeypatch.setattr(crowdbench, "scenario_names", lambda tier: ["situation_blind_corner"])
    allowed = r"training\.detour_price: 5; allowed: 0 where 'situation_blind_corner' is trained in"
    with pytest.raises(TrainingError, match=allowed):
        train("priced", steps=20, overrides=overrides | {"training.detour_price": 5.0}, actors=0)
    assert not list(in_empty_folder.iterdir()), "refused before anything is made"
    require_straight_ways(0.0, as_they_are(["situation_blind_corner"]))
    require_straight_ways(5.0, as_they_are(["unimodal_slow"]))


def counters_of(folder):
    """What a run has counted."""
    return load_checkpoint(folder, FORMAT).state["counters"]


def acted(folder, config, steps=20):
    """A run that has acted for some steps."""
    run = TrainingRun(KIND, folder / "run", RunSettings("sac", config), torch.device("cpu"), 0)
    run.begin(print, lambda: False)
    for _ in range(steps):
        run.step()
    assert run.steps == run.decisions == 4 * steps
    return run


def test_weights_that_have_no_room_are_named_and_leave_those_before(in_empty_folder, tiny):
    run = TrainingRun(
        KIND, in_empty_folder / "run", RunSettings("sac", tiny()), torch.device("cpu"), 0
    )
    run.export("best", {"steps": 1})
    before = {path: path.read_bytes() for path in run.folder.glob("*.safetensors")}
    told = r"best.safetensors: could not be written \(File too large\); make room on the disk"
    with room_for(1000), pytest.raises(TrainingError, match=told):
        run.export("best", {"steps": 2})
    assert {path: path.read_bytes() for path in run.folder.glob("*.safetensors")} == before
    assert len(before) == 1


def test_labels_reach_the_replay_of_labelled_environments_only(in_empty_folder, tiny):
    config = tiny()
    run = acted(in_empty_folder, config)
    data = run.replay._data
    labelled = [data.source[lane, : run.replay.lengths()[lane]].any() for lane in range(4)]
    assert labelled == [False, False, True, True]
    assert (run.learner.count, run.learner.horizon) == (256, config.loss.n_step)


def test_without_labelled_environments_nothing_is_labelled(in_empty_folder, tiny):
    run = acted(in_empty_folder, tiny(**{"training.labelled_environments": 0}), steps=5)
    assert not run.replay._data.source.any()


def test_a_run_trains_stops_and_goes_on(in_empty_folder, overrides):
    folder = train("short", steps=100, overrides=overrides, actors=0)
    train("short", steps=160, resume=True, overrides=overrides, actors=0)
    lines = (in_empty_folder / "results/training/short.csv").read_text().splitlines()
    steps = [int(line.split(",")[0]) for line in lines[1:]]
    updates = [int(line.split(",")[2]) for line in lines[1:]]
    assert steps == [0, 100, 160]
    assert updates[2] > updates[1] > updates[0] == overrides["training.pretraining"]
    _, config, _ = load_actor(folder / "last.safetensors")
    assert config.model.latent == 32


@pytest.mark.parametrize("pretraining", [0, 1000])
def test_a_signal_stops_a_run_before_and_after_its_pretraining(
    in_empty_folder, overrides, monkeypatch, pretraining
):
    update = Learner.update

    def interrupted(learner, batch):
        terms = update(learner, batch)
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        return terms

    monkeypatch.setattr(Learner, "update", interrupted)
    changes = overrides | {"training.pretraining": pretraining}
    folder = train("short", steps=10_000, overrides=changes, actors=0)
    counters = counters_of(folder)
    assert counters["updates"] == 1
    assert counters["steps"] < 100


def test_a_signal_stops_a_run_that_records_demonstrations_and_it_goes_on_with_them(
    in_empty_folder, overrides, monkeypatch
):
    calls, labels = [], Experts.labels

    def interrupted(experts):
        calls.append(experts)
        if len(calls) == 5:
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)
        return labels(experts)

    monkeypatch.setattr(Experts, "labels", interrupted)
    folder = train("short", steps=20, overrides=overrides, actors=0)
    counters = counters_of(folder)
    assert (counters["updates"], counters["steps"], len(calls)) == (0, 0, 5)
    train("short", steps=20, resume=True, overrides=overrides, actors=0)
    counters = counters_of(folder)
    assert counters["updates"] == overrides["training.pretraining"]
    (recorded,) = in_empty_folder.glob("runs/demonstrations-*/written.npy")
    assert 600 <= np.load(recorded).sum() <= 620


def test_a_run_says_its_arithmetic_and_goes_on_in_another(
    in_empty_folder, overrides, monkeypatch, capsys
):
    changes = overrides | {"training.bfloat16": True}
    for steps, instructions, said in ((20, True, "bfloat16"), (40, False, "float32 (this CPU")):
        monkeypatch.setattr(precision, "cpu_has_bfloat16", lambda has=instructions: has)
        train("moved", steps=steps, resume=steps > 20, overrides=changes, actors=0)
        assert f"networks learn in {said}" in " ".join(capsys.readouterr().out.split())
