"""Agents on the nodes of a Ray cluster: the same rows as here, whatever becomes of the nodes."""

from __future__ import annotations

import json
import socket
import sys
from collections import Counter

import pytest
from short_episodes import TINY

from crowdbench import AgentSpec
from crowdbench.agent import AgentError
from crowdbench.evaluation.executors import ExecutorError
from crowdbench.evaluation.machine import machine_name
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.pool import Limits
from crowdbench.evaluation.ray_executor import RayExecutor
from crowdbench.evaluation.ray_node import Node
from crowdbench.evaluation.results import load_results
from crowdbench.evaluation.runner import Task, run

PLANNER = '''
import os, pathlib, signal, tempfile, time
import crowdbench

class Planner(crowdbench.Agent):
    """Drives at the speed in a file, and does one thing wrong when its seed is even."""

    def __init__(self, speed, fault="none", log=""):
        self.speed, self.fault, self.log = float(pathlib.Path(speed).read_text()), fault, log

    def reset(self, robot, seed):
        self.seed, self.steps = seed, 0

    def act(self, observation):
        self.steps += 1
        if self.steps == 3 and self.seed % 2 == 0:
            getattr(self, self.fault)()
        if self.steps == 2 and self.log:  # the warm-up acts once
            pathlib.Path(self.log, f"{self.seed}-{time.monotonic_ns()}").touch()
            time.sleep(0.1)
        return self.speed, 0.1

    def none(self):
        pass

    def raises(self):
        raise KeyError("no plan")

    def sleeps(self):
        time.sleep(60)

    def exits(self):
        os._exit(7)

    def diagnostics(self):
        copied = __file__.startswith(str(pathlib.Path(tempfile.gettempdir(), "crowdbench-")))
        return {"copied": copied, "raylet": float(os.environ.get("RAY_RAYLET_PID", 0))}
'''
QUICK = Limits(step=0.5, first=0.5, making=5)
WRONG = ("none", "raises", "sleeps", "exits")


@pytest.fixture
def planner(tmp_path, monkeypatch):
    """Spec of the planner above, a file in the present folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "planner.py").write_text(PLANNER)
    (tmp_path / "speed.txt").write_text("0.375")

    def spec(**options):
        return AgentSpec("planner.py:Planner", {"speed": "speed.txt", **options})

    return spec


@pytest.fixture(scope="module")
def cluster():
    """A head without processors and two nodes with one each."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    small = {"object_store_memory": 100_000_000, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, **small})
    cluster.nodes = [cluster.add_node(num_cpus=1, object_store_memory=100_000_000) for _ in "ab"]
    yield cluster
    cluster.shutdown()


@pytest.mark.slow
def test_rows_are_those_of_the_local_executor(tmp_path, planner, cluster):
    tasks = [Task(TINY, planner(fault=fault), range(4)) for fault in WRONG]
    tasks.append(Task(TINY, AgentSpec("straight_line", {}), range(4)))
    local = run(tasks, tmp_path / "here", jobs=2, limits=QUICK)
    there = {"executor": "ray", "address": cluster.address}
    assert run(tasks, tmp_path / "there", limits=QUICK, **there) == local
    here, there = load_results(tmp_path / "here"), load_results(tmp_path / "there")
    assert len(there) == 20
    measured = [name for name in METRICS if name != "inference_s"]
    same = ["scenario", "agent", "code", "seed", "robot", "outcome", "steps", "error", *measured]
    for name in same:
        assert list(map(repr, here[name])) == list(map(repr, there[name])), name
    assert set(there["outcome"]) == {"timeout", "agent_error"}
    assert set(there["machine"]) == {machine_name()}
    told = [
        json.loads(text) for text in there[there["agent"] == str(planner(fault="none"))].diagnostics
    ]
    assert [one["copied"] for one in told] == [1.0] * 4
    assert "Ray" not in "".join(there["error"])


@pytest.mark.slow
def test_an_agent_that_cannot_be_made_there_is_refused(tmp_path, planner, cluster):
    task = Task(TINY, planner(faults="none"), [0])
    with pytest.raises(AgentError, match="has no option 'faults'; did you mean 'fault'"):
        run([task], tmp_path / "there", executor="ray", address=cluster.address)


@pytest.mark.slow
def test_a_node_that_dies_costs_its_chunk_which_another_one_does_again(tmp_path, planner, cluster):
    (tmp_path / "log").mkdir()
    spec, seen, stored = planner(log=str(tmp_path / "log")), Counter(), []

    def watch(progress):
        for row in progress.rows:
            seen[json.loads(row["diagnostics"])["raylet"]] += 1
            stored.append(row["seed"])
        if len(seen) == 2 and min(seen.values()) >= 2 and len(cluster.nodes) == 2:
            cluster.remove_node(cluster.nodes.pop(), allow_graceful=False)

    tasks = [Task(TINY, spec, range(80))]
    run(tasks, tmp_path / "there", executor="ray", address=cluster.address, on_progress=watch)
    assert len(cluster.nodes) == 1, "the node was killed in the middle"
    assert sorted(stored) == list(range(80)), "every episode was told of once"
    rows = load_results(tmp_path / "there")
    assert list(rows["seed"]) == list(range(80))
    assert set(rows["outcome"]) == {"timeout"}
    runs = Counter(path.name.partition("-")[0] for path in (tmp_path / "log").iterdir())
    again = sum(count - 1 for count in runs.values())
    assert again <= 3, "what was under way is run again, what was answered is not"


@pytest.mark.slow
def test_a_node_that_cannot_be_used_is_told_of_in_a_line(tmp_path, planner, cluster, monkeypatch):
    class Full(Node):
        def __init__(self, limits, folder):
            raise OSError("no space left")

    class Fails(Node):
        def run(self, parcel, messages):
            raise OSError("disk full")
            yield

    def tell(*changes):
        with monkeypatch.context() as patch, pytest.raises((ExecutorError, AgentError)) as caught:
            patch.setattr(*changes)
            task = Task(TINY, planner(), [0])
            run([task], tmp_path / "there", executor="ray", address=cluster.address)
        return str(caught.value)

    place = "crowdbench.evaluation.ray_executor."
    full = "workers cannot be started on the Ray cluster: OSError: no space left"
    assert tell(f"{place}Node", Full) == full
    assert tell(f"{place}Node", Fails).endswith("its Ray worker was lost (OSError: disk full)")
    assert "this machine 99; install the same" in tell(f"{place}version", lambda name: "99")


@pytest.mark.slow
def test_without_processors_a_run_ends_and_what_is_finished_stays(
    tmp_path, planner, cluster, monkeypatch
):
    monkeypatch.setattr("crowdbench.evaluation.ray_executor.WITHOUT_NODES", 0.5)

    def watch(progress):
        while progress.done and cluster.nodes:
            cluster.remove_node(cluster.nodes.pop(), allow_graceful=False)

    (tmp_path / "log").mkdir()
    tasks = [Task(TINY, planner(log=str(tmp_path / "log")), range(80))]
    with pytest.raises(ExecutorError, match=r"has had no processors for 0\.5 s"):
        run(tasks, tmp_path / "there", executor="ray", address=cluster.address, on_progress=watch)
    rows = load_results(tmp_path / "there")
    assert 0 < len(rows) < 80
    assert set(rows["outcome"]) == {"timeout"}


def test_without_ray_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ExecutorError, match=r"pip install 'crowdbench-nav\[ray\]'"):
        RayExecutor(1, Limits())


@pytest.mark.parametrize(
    "address", ["head", "auto", "ray://head:10001", "head:port", "head:6379/x"]
)
def test_what_is_no_address_is_refused(address):
    pytest.importorskip("ray")
    with pytest.raises(ExecutorError, match=r"expected HOST:PORT of the cluster's head"):
        RayExecutor(1, Limits(), address).__enter__()


def test_where_no_cluster_answers_that_is_said(monkeypatch):
    pytest.importorskip("ray")
    monkeypatch.setattr("crowdbench.evaluation.ray_cluster._REACHED_WITHIN", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        silent = f"127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(ExecutorError, match=f"no Ray cluster at {silent}: timed out"):
            RayExecutor(1, Limits(), silent).__enter__()
    with pytest.raises(ExecutorError, match=f"no Ray cluster at {silent}: .*refused"):
        RayExecutor(1, Limits(), silent).__enter__()
    monkeypatch.setenv("RAY_ADDRESS", silent)
    with pytest.raises(ExecutorError, match=f"no Ray cluster at {silent}"):
        RayExecutor(1, Limits()).__enter__()


def test_a_cluster_that_may_want_a_token_is_told_of(monkeypatch):
    ray = pytest.importorskip("ray")

    def refuse(**settings):
        raise ConnectionError("Failed to connect\nto Ray")

    monkeypatch.setattr(ray, "init", refuse)
    monkeypatch.setattr("crowdbench.evaluation.ray_cluster._require_reachable", lambda address: 0)
    monkeypatch.delenv("RAY_AUTH_MODE", raising=False)
    with pytest.raises(
        ExecutorError, match=r"Ray at head:1: Failed to connect to Ray; .*MODE=token"
    ):
        RayExecutor(1, Limits(), "head:1").__enter__()
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    with pytest.raises(ExecutorError, match=r"Failed to connect to Ray$"):
        RayExecutor(1, Limits(), "head:1").__enter__()
