"""Trainings on a Ray cluster: what runs leave comes back, whatever becomes of the nodes."""

from __future__ import annotations

import csv
import os
import threading
import time
from pathlib import Path

import pytest

from crowdbench.cli import main

TINY = {
    "perception.cells": 16, "model.latent": 16, "model.hidden": 16, "training.environments": 2,
    "training.replay": 400, "training.warmup": 20, "training.validation_episodes": 1,
    "training.demonstrations": 0, "training.pretraining": 0, "training.bfloat16": "false",
    "training.labelled_environments": 0, "training.planning_environments": 0,
}  # fmt: skip
TRAINER = '''
import os, time
from pathlib import Path

HERE = Path(__file__).parent

def train(name, minutes, steps, resume, seed, overrides):
    """Says that it has begun, on which node, and ends when its seed may."""
    (HERE / f"{seed}-on-{os.environ['RAY_RAYLET_PID']}").touch()
    run = Path("runs", name)
    run.mkdir(parents=True)
    (run / "last.safetensors").write_text("half")
    while not (HERE / f"{seed}-may-end").exists():
        time.sleep(0.05)
    (run / "last.safetensors").write_text(f"of seed {seed}")
    return run
'''


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """A head without processors and two nodes with one each, all of which know the trainer."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    (tmp_path / "patient.py").write_text(TRAINER)
    info = tmp_path / "patient-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: patient\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[crowdbench.trainers]\npatient = patient:train\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.chdir(tmp_path)
    small = {"object_store_memory": 100_000_000}
    head = {"num_cpus": 0, "include_dashboard": False, **small}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    cluster.nodes = [cluster.add_node(num_cpus=1, **small) for _ in "ab"]
    yield cluster
    cluster.shutdown()


@pytest.fixture
def meanwhile():
    """Starts a function beside the test, and waits for it when the test ends."""
    threads = []

    def start(function):
        threads.append(threading.Thread(target=function))
        threads[-1].start()

    yield start
    for thread in threads:
        thread.join()


def wait_for_runs(count):
    """Pairs of seed and node, of runs that have begun."""
    until = time.monotonic() + 60
    while len(begun := [path.name for path in Path().glob("*-on-*")]) < count:
        assert time.monotonic() < until, f"only {begun} have begun"
        time.sleep(0.05)
    return {tuple(map(int, name.split("-on-"))) for name in begun}


def raylet(node):
    return node.all_processes["raylet"][0].process.pid


def train_on(cluster, seeds):
    there = ["--executor", "ray", "--address", cluster.address]
    return main(["train", "patient", *there, "--seeds", seeds, "--steps", "1"])


def told_of_runs(capsys):
    """Lines of the command, without what Ray itself prints of a node that dies."""
    told = capsys.readouterr()
    lines = told.out.splitlines() + told.err.splitlines()
    return [line for line in lines if line.startswith(("runs/", "patient", "the Ray cluster"))]


def left_by(seed):
    return Path(f"runs/patient-{seed}/last.safetensors").read_text()


@pytest.mark.slow
def test_the_run_of_a_node_that_dies_begins_anew_on_another(cluster, meanwhile, capsys):
    stays, dies = map(raylet, cluster.nodes)
    begun = {}

    def kill():
        begun.update({node: seed for seed, node in wait_for_runs(2)})
        cluster.remove_node(cluster.nodes[1], allow_graceful=False)
        for seed in {0, 1, 2} - {begun[dies]}:
            Path(f"{seed}-may-end").touch()
        wait_for_runs(4)
        Path(f"{begun[dies]}-may-end").touch()

    meanwhile(kill)
    assert train_on(cluster, "0-2") == 0
    assert sorted(told_of_runs(capsys)) == [
        f"runs/patient-{seed}: the run of patient" for seed in range(3)
    ]
    assert [left_by(seed) for seed in range(3)] == ["of seed 0", "of seed 1", "of seed 2"]
    where_it_stays = {(seed, stays) for seed in range(3)}
    assert wait_for_runs(4) == where_it_stays | {(begun[dies], dies)}


@pytest.mark.slow
def test_without_nodes_training_ends_and_runs_that_have_ended_stay(
    cluster, meanwhile, monkeypatch, capsys
):
    monkeypatch.setattr("crowdbench.cli.train_on_ray.WITHOUT_NODES", 0.5)

    def kill():
        wait_for_runs(2)
        Path("0-may-end").touch()
        while not Path("runs/patient-0/last.safetensors").exists():
            time.sleep(0.05)
        for node in cluster.nodes:
            cluster.remove_node(node, allow_graceful=False)

    meanwhile(kill)
    assert train_on(cluster, "0-1") == 2
    told = told_of_runs(capsys)
    assert told[0] == "runs/patient-0: the run of patient"
    assert "no node for a run for 0.5 s; runs that have ended are here" in told[1]
    assert len(told) == 2
    assert left_by(0) == "of seed 0"
    assert not Path("runs/patient-1").exists()


@pytest.mark.slow
def test_a_run_that_no_node_has_room_for_is_refused(cluster, capsys):
    command = ["train", "sac", "--executor", "ray", "--address", cluster.address, "--steps", "1"]
    assert main([*command, "--actors", "1"]) == 2
    needs = "a run needs 2 processors of one node, and no node has that; use fewer --actors"
    assert capsys.readouterr().err == f"{needs}\n"
    assert main([*command, "--device", "cuda"]) == 2
    assert "a run needs 1 processors and a GPU of one node" in capsys.readouterr().err


@pytest.mark.slow
def test_seeds_are_trained_on_ray_and_what_they_leave_comes_back(tmp_path, monkeypatch, capsys):
    pytest.importorskip("ray")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    settings = [f"--set={key}={value}" for key, value in TINY.items()]
    command = ["train", "sac", "--executor", "ray", "--seeds", "0-1", *settings]
    assert main([*command, "--steps", "40"]) == 0
    assert sorted(capsys.readouterr().out.splitlines()) == [
        f"runs/sac-{seed}: the run of sac" for seed in (0, 1)
    ]
    for seed in (0, 1):
        left = {path.name for path in Path(f"runs/sac-{seed}").iterdir()}
        assert {"best.safetensors", "last.safetensors", "checkpoint.safetensors"} <= left
        assert "replay" not in left
    assert main([*command, "--steps", "80", "--resume"]) == 0
    for seed in (0, 1):
        curve = Path(f"results/training/sac-{seed}.csv").read_text().splitlines()
        assert [row["steps"] for row in csv.DictReader(curve)] == ["40", "80"]
    capsys.readouterr()
    bad = ["--set=training.batch=0", "--name", "bad", "--steps", "40"]
    assert main([*command, *bad]) == 1
    told = capsys.readouterr().err.splitlines()
    assert sorted(line.partition(":")[0] for line in told) == ["bad-0", "bad-1"]
    assert all("training.batch: 0 is out of range; allowed: >= 1" in line for line in told)
