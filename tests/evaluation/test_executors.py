"""Where agents run is an extension point; what is stored does not depend on it."""

from __future__ import annotations

import pytest

from crowdbench import AgentSpec, load_scenario
from crowdbench.evaluation.executors import EXECUTORS, ExecutorError
from crowdbench.evaluation.local import Local
from crowdbench.evaluation.pool import Limits
from crowdbench.evaluation.results import load_results
from crowdbench.evaluation.runner import Task, run
from crowdbench.registry import UnknownNameError

TINY = load_scenario("multimodal_fast", name="tiny", time_limit=1, pedestrians={"count": 1})
PACKAGE = """
from crowdbench.evaluation.executors import Reply
from crowdbench.evaluation.local import Local
from crowdbench.evaluation.results import Origin

class Backwards(Local):
    '''Takes the last message first, on a machine of another name.'''

    remote = True

    def run(self, queue):
        queue.reverse()
        for message, answer, _ in super().run(queue):
            yield Reply(message, answer, Origin("far away"))
"""


def test_a_package_adds_an_executor_in_one_file(tmp_path, monkeypatch):
    (tmp_path / "backwards.py").write_text(PACKAGE)
    info = tmp_path / "backwards-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: backwards\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[crowdbench.executors]\nbackwards = backwards:Backwards\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(EXECUTORS, "_points", None)
    tasks, seen = [Task(TINY, AgentSpec("straight_line", {}), range(3))], []
    run(tasks, tmp_path / "here", jobs=1)
    run(tasks, tmp_path / "there", jobs=1, executor="backwards", on_progress=seen.append)
    assert [row["seed"] for progress in seen for row in progress.rows] == [2, 1, 0]
    here, there = load_results(tmp_path / "here"), load_results(tmp_path / "there")
    assert set(there["machine"]) == {"far away"}
    same = ["seed", "robot", "outcome", "steps", "path_length", "min_dist", "smoothness"]
    assert here[same].equals(there[same])


def test_an_executor_that_nothing_has_is_named_with_those_there_are(tmp_path):
    task = Task(TINY, AgentSpec("straight_line", {}), [0])
    with pytest.raises(UnknownNameError, match="unknown executor 'lokal'; did you mean 'local'"):
        run([task], tmp_path, executor="lokal")


def test_an_address_is_refused_where_agents_run_on_this_machine():
    with pytest.raises(ExecutorError, match=r"an address \(head:6379\) is for executors on other"):
        Local(1, Limits(), "head:6379")
