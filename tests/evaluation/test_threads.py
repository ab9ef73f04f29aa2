from __future__ import annotations

import json

import pytest

from crowdbench import AgentSpec, load_scenario
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.results import load_driven, load_results
from crowdbench.evaluation.runner import Task, run

SHORT = load_scenario("multimodal_fast", time_limit=1.6)
AGENTS = ("neupan", "sac", "latent_planner")
VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def test_rows_are_the_same_for_any_number_of_jobs_and_threads(tmp_path, monkeypatch):
    """To the last bit, and so are the commands."""
    # One episode each: with more jobs, agents compute side by side and not in more processes.
    tasks = [Task(SHORT, AgentSpec(name, {}), [0]) for name in AGENTS]
    found = []
    for jobs, threads in ((1, None), (2, "2"), (2, "1")):
        for name in VARIABLES:
            monkeypatch.delenv(name, raising=False)
            if threads:
                monkeypatch.setenv(name, threads)
        folder = tmp_path / f"{jobs}-{threads}"
        cells = run(tasks, folder, jobs=jobs)
        rows = load_results(folder)
        commands = [load_driven(folder, cell, 0)[0] for cell in cells]
        found.append((rows, [one.commands.tobytes() for one in commands]))
    (first, asked), *others = found
    assert len(first) == 3
    assert set(first["outcome"]) <= {"timeout", "collision"}
    measured = [name for name in METRICS if name != "inference_s"]
    for rows, commands in others:
        assert commands == asked
        for name in ("agent", "seed", "outcome", "steps", *measured):
            assert rows[name].equals(first[name]), name


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_agent_has_one_thread_whatever_the_environment_says(tmp_path, monkeypatch, jobs):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    path = tmp_path / "counts.py"
    path.write_text(
        "import crowdbench, numpy, torch\n"
        "class Counts(crowdbench.Agent):\n"
        "    def reset(self, robot, seed):\n"
        "        pass\n"
        "    def act(self, observation):\n"
        "        return 0.0, 0.0\n"
        "    def diagnostics(self):\n"
        "        return {'threads': torch.get_num_threads()}\n"
    )
    run([Task(SHORT, AgentSpec(f"{path}:Counts", {}), [0])], tmp_path / "results", jobs=jobs)
    (row,) = load_results(tmp_path / "results").to_dict("records")
    assert json.loads(row["diagnostics"])["threads"] == 1.0
