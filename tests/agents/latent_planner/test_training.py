"""Runs that stop and go on."""

import contextlib
import shutil
import signal

import numpy as np
import pytest
from crowdbench_agents.latent_planner.training import train
from crowdbench_agents.latent_planner.world_model import FORMAT, load_world_model
from crowdbench_agents.learning.checkpoints import load_checkpoint
from crowdbench_agents.learning.config import ConfigError, load_config
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.replay import EXPERT, PLANNER
from crowdbench_agents.learning.run import TrainingRun
from crowdbench_agents.tdmpc.training import train as train_tdmpc

import crowdbench


def state_of(folder):
    """What a run has kept."""
    return load_checkpoint(folder, FORMAT).state


def test_a_run_trains_stops_and_goes_on(in_empty_folder, overrides):
    folder = train("short", steps=200, actors=0, overrides=overrides)
    curve = in_empty_folder / "results/training/short.csv"
    lines = curve.read_text().splitlines()
    assert lines[0].startswith("steps,decisions,updates,seconds,success")
    updates = int(lines[-1].split(",")[2])
    assert int(lines[-1].split(",")[0]) == 200
    assert updates > 10
    with pytest.raises(TrainingError, match="holds a run"):
        train("short", steps=300, actors=0, overrides=overrides)
    train("short", steps=300, resume=True, actors=0, overrides=overrides)
    last = curve.read_text().splitlines()[-1].split(",")
    assert int(last[0]) == 300
    assert int(last[2]) > updates
    _, config, training = load_world_model(folder / "last.safetensors")
    assert training["robot"]["beams"] == 180
    assert training["arithmetic"] == "float32"
    assert config.model.latent == 32
    assert overrides["planner.horizon"] == config.planner.horizon


def test_a_run_is_not_resumed_in_other_worlds(in_empty_folder, overrides, monkeypatch):
    train("worlds", steps=100, actors=0, overrides=overrides)
    load = crowdbench.load_scenario

    def changed(name, **robot):
        return load(name, **robot).override({"time_limit": 30.0} if name == "unimodal_slow" else {})

    before = {path: path.stat().st_mtime_ns for path in in_empty_folder.rglob("*")}
    monkeypatch.setattr(crowdbench, "load_scenario", changed)
    with pytest.raises(TrainingError, match=r"scenarios are other ones now: unimodal_slow"):
        train("worlds", steps=200, resume=True, actors=0, overrides=overrides)
    after = {path: path.stat().st_mtime_ns for path in in_empty_folder.rglob("*")}
    assert after == before


def test_a_run_goes_on_when_others_add_scenarios(in_empty_folder, overrides, monkeypatch):
    train("worlds", steps=100, actors=0, overrides=overrides)
    names = [*crowdbench.scenario_names("paper"), "unimodal_fast"]
    monkeypatch.setattr(crowdbench, "scenario_names", lambda tier: names)
    folder = train("worlds", steps=140, resume=True, actors=0, overrides=overrides)
    assert state_of(folder)["counters"]["steps"] == 140


def test_a_run_keeps_its_settings_and_says_which_change(in_empty_folder, overrides, capsys):
    begun = overrides | {"training.batch": 8}
    folder = train("kept", steps=100, actors=0, overrides=begun, seed=3, social=False)
    train("kept", steps=120, resume=True, actors=0)
    assert "from here on" not in capsys.readouterr().out
    train("kept", steps=140, resume=True, actors=0, overrides={"training.batch": 4}, seed=3)
    said = " ".join(capsys.readouterr().out.split())
    assert said.count("from here on") == 1
    assert "training.batch: 4 from here on, 8 before" in said
    _, config, training = load_world_model(folder / "last.safetensors")
    assert config == load_config().override(begun | {"training.batch": 4})
    assert (training["seed"], training["social"], training["steps"]) == (3, False, 140)
    then = r"^(--seed 4: the run was begun with 3|--social: the run was begun otherwise); leave it"
    for other in ({"seed": 4}, {"social": True}):
        with pytest.raises(TrainingError, match=then):
            train("kept", steps=160, resume=True, actors=0, **other)
    with pytest.raises(ConfigError, match=r"training\.batch"):
        train("kept", steps=160, resume=True, actors=0, overrides={"training.batch": 0})
    assert state_of(folder)["counters"]["steps"] == 140


def test_what_tdmpc_does_otherwise_does_not_replace_what_a_run_was_begun_with(
    in_empty_folder, overrides
):
    chosen = {"planner.smoothness_weight": 0.7}
    folder = train_tdmpc("kept", steps=60, actors=0, overrides=overrides | chosen)
    train_tdmpc("kept", steps=80, resume=True, actors=0)
    _, config, training = load_world_model(folder / "last.safetensors")
    assert (config.planner.smoothness_weight, config.loss.imitation) == (0.7, 0.0)
    assert training["social"] is False
    with pytest.raises(TrainingError, match=r"runs/kept: is a run of tdmpc, not of latent_planner"):
        train("kept", steps=100, resume=True, actors=0)


@pytest.mark.parametrize("expert", ["nobody", "informed:intent=nonsense", "orca:foo=1"])
def test_an_expert_that_cannot_be_made_is_refused_and_nothing_touched(
    in_empty_folder, overrides, expert
):
    curve = in_empty_folder / "results/training/mine.csv"
    curve.parent.mkdir(parents=True)
    curve.write_text("of another run")
    with pytest.raises(TrainingError, match=r"training\.expert: (unknown )?agent"):
        train("mine", steps=60, actors=0, overrides=overrides | {"training.expert": expert})
    assert [path for path in in_empty_folder.rglob("*") if path.is_file()] == [curve]
    assert curve.read_text() == "of another run"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_arrives_in_a_callback_stops_a_run_at_a_whole_step(
    in_empty_folder, overrides, monkeypatch, number
):
    step = TrainingRun.step

    def interrupted(run):
        if run.steps == 40:
            with contextlib.suppress(KeyboardInterrupt):  # as C libraries do
                signal.raise_signal(number)
        step(run)

    monkeypatch.setattr(TrainingRun, "step", interrupted)
    folder = train("short", steps=400, actors=0, overrides=overrides)
    assert state_of(folder)["counters"]["steps"] == 44
    train("short", steps=80, resume=True, actors=0, overrides=overrides)
    assert state_of(folder)["counters"]["steps"] == 80


def test_a_run_goes_on_in_other_processes_and_without_its_replay(in_empty_folder, overrides):
    changes = overrides | {"training.warmup": 20, "training.refill": 100}
    folder = train("moved", steps=200, actors=0, overrides=changes)
    before = state_of(folder)
    shutil.rmtree(folder / "replay")
    train("moved", steps=240, resume=True, actors=1, overrides=changes)
    filling = state_of(folder)
    assert filling["counters"]["updates"] == before["counters"]["updates"]
    train("moved", steps=360, resume=True, actors=0, overrides=changes)
    after = state_of(folder)
    assert 15 <= after["counters"]["updates"] - before["counters"]["updates"] <= 40
    seen = [state["sampler"]["episodes"] for state in (before, filling, after)]
    assert seen == sorted(set(seen)), "no episode comes twice"
    decisions = [state["acting"]["decisions"] for state in (before, filling, after)]
    assert decisions == sorted(set(decisions))


def test_states_of_the_past_are_planned_again_where_mppi_does_not_act(in_empty_folder, overrides):
    changes = {"training.planning_environments": 0, "training.replanned_states": 1.5}
    folder = train("lazy", steps=160, actors=0, overrides=overrides | changes)
    source = np.load(folder / "replay" / "source.npy")
    # 60 states in 40 steps, less those that are final or come twice
    assert 30 <= (source == PLANNER).sum() <= 60
    assert (source[-1] == EXPERT).sum() == 40, "labels of the expert stay"


def test_plans_that_are_not_imitated_are_not_made_again(in_empty_folder, overrides):
    changes = overrides | {"training.planning_environments": 0}
    for begin, again in ((train, True), (train_tdmpc, False)):
        folder = begin(f"again-{again}", steps=80, actors=0, overrides=changes)
        source = np.load(folder / "replay" / "source.npy")
        assert (source == PLANNER).any() == again
