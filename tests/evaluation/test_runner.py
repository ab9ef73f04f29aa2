from __future__ import annotations

import json
import platform
import random
import signal
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import pytest
from crossings import crossing, walking

from crowdbench import AgentSpec, ScenarioError, load_scenario
from crowdbench.agent import AgentError
from crowdbench.evaluation.machine import machine_name
from crowdbench.evaluation.metrics import METRICS, metrics
from crowdbench.evaluation.pool import Limits
from crowdbench.evaluation.results import ResultsError, load_commands, load_results
from crowdbench.evaluation.rollout import run_episode
from crowdbench.evaluation.runner import IncompleteError, Task, run
from crowdbench.evaluation.stored import load_episodes

TINY = load_scenario(
    "multimodal_fast",
    name="tiny",
    time_limit=2,
    arena={"length": 6, "width": 6},
    robots={"travel": 4},
    pedestrians={"count": 2, "leg": 2},
)
SEEDS = (0, 1)
"""The first makes the planner's seed even, so that it fails; the second does not."""
QUICK = Limits(step=0.5, first=0.5, making=5)
PLANNER = '''
import os, re, signal, time
import crowdbench

class Planner(crowdbench.Agent):
    """Drives ahead, and does one thing wrong at its third step when its seed is even."""

    def __init__(self, fault="none", dies=False):
        self.fault = fault
        if dies:
            os._exit(3)

    def reset(self, robot, seed):
        self.even, self.steps = seed % 2 == 0, 0

    def act(self, observation):
        self.steps += 1
        if self.steps == 3 and self.even:
            getattr(self, self.fault)()
        return 0.5, 0.1

    def none(self):
        pass

    def raises(self):
        raise KeyError("no plan")

    def sleeps(self):
        time.sleep(60)

    def hangs_in_c(self):
        re.match(r"(a+)+$", "a" * 64 + "b")

    def exits(self):
        os._exit(7)

    def crashes(self):
        signal.raise_signal(signal.SIGSEGV)

    def prints(self):
        print("planning ...")

    def diagnostics(self):
        return {"threads": float(os.environ.get("OMP_NUM_THREADS", "nan"))}
'''
MEASURED = [name for name in METRICS if name != "inference_s"]
VARY = ("inference_s", "timestamp", "diagnostics", "machine")


@pytest.fixture
def planner(tmp_path):
    """Spec of the planner above with a fault, by default none."""
    path = tmp_path / "planner.py"
    path.write_text(PLANNER)

    def spec(fault="none"):
        return AgentSpec.parse(f"{path}:Planner:fault={fault}")

    return spec


def test_what_agents_warn_of_in_their_processes_is_told_once_in_a_run(tmp_path):
    path = tmp_path / "warner.py"
    path.write_text(
        "import warnings, crowdbench\n"
        "class Warner(crowdbench.Agent):\n"
        "    def __init__(self, of='the robot'): self.of = of\n"
        "    def reset(self, robot, seed): warnings.warn(f'mind\\n{self.of}')\n"
        "    def act(self, observation): return 0.5, 0.0\n"
    )
    names = [f"{path}:Warner", f"{path}:Warner:of=people"]
    tasks = [Task(TINY, AgentSpec.parse(name), range(4)) for name in names]
    with pytest.warns(UserWarning, match="mind") as caught:
        run(tasks, tmp_path / "results", jobs=2)
    told = sorted(str(item.message) for item in caught if item.category is UserWarning)
    assert told == [f"agent {names[0]!r}: mind the robot", f"agent {names[1]!r}: mind people"]


def test_the_same_rows_come_out_alone_and_in_parallel(tmp_path, planner):
    tasks = [Task(TINY, planner(), range(4)), Task(TINY, AgentSpec("straight_line", {}), range(3))]
    alone, parallel = tmp_path / "alone", tmp_path / "parallel"
    cells = run(tasks, alone, jobs=1)
    assert run(tasks, parallel, jobs=2) == cells
    one, two = load_results(alone), load_results(parallel)
    assert len(one) == 7
    columns = [name for name in one.columns if name not in VARY]
    assert one[columns].equals(two[columns])
    diagnostics = [json.loads(text) for text in two[two["agent"] == str(planner())]["diagnostics"]]
    assert [one["threads"] for one in diagnostics] == [1.0] * 4
    assert set(two["machine"]) == {machine_name()}
    for _, stored in two[two["agent"] == "straight_line"].iterrows():
        (episode,) = run_episode(TINY, "straight_line", stored["seed"])
        values = metrics(episode)
        assert [repr(values[name]) for name in MEASURED] == [repr(stored[n]) for n in MEASURED]


def test_a_second_run_does_only_what_is_missing(tmp_path, planner):
    pair, seen = TINY.override({"robots.count": 2}), []
    run([Task(pair, planner(), [0, 2])], tmp_path, jobs=1)
    run([Task(pair, planner(), range(4))], tmp_path, jobs=1, on_progress=seen.append)
    counts = [(item.total, item.stored, item.done) for item in seen]
    assert counts == [(4, 2, 0), (4, 2, 1), (4, 2, 2)]
    assert [[row["seed"] for row in item.rows] for item in seen] == [[], [1, 1], [3, 3]]
    rows = load_results(tmp_path)
    expected = [(seed, f"robot_{r}") for seed in range(4) for r in range(2)]
    assert list(zip(rows["seed"], rows["robot"], strict=True)) == expected


def test_a_planner_that_was_edited_is_measured_anew(tmp_path, planner):
    spec = planner()
    run([Task(TINY, spec, range(2))], tmp_path, jobs=1)
    path = Path(spec.name.partition(":")[0])
    path.write_text(PLANNER.replace("0.5, 0.1", "0.0, 0.0"))
    run([Task(TINY, spec, range(2))], tmp_path, jobs=1)
    rows = load_results(tmp_path)
    assert list(rows["seed"]) == [0, 1]
    assert (rows["path_length"] == 0).all()


FAULTS = {
    "raises": "KeyError: 'no plan' (PLANNER:",
    "sleeps": "act at step 2 did not return within the limit of 0.5 s without computing (PLANNER:",
    "hangs_in_c": "act at step 2 did not return within the limit of 0.5 s ",
    "exits": "its process ended with exit code 7 in act at step 2",
    "crashes": "its process ended with SIGSEGV (PLANNER:",
}


def test_a_planner_that_fails_is_recorded_and_the_run_goes_on(tmp_path, planner):
    run([Task(TINY, planner(fault), SEEDS) for fault in FAULTS], tmp_path, jobs=2, limits=QUICK)
    rows = load_results(tmp_path)
    path = planner().name.partition(":")[0]
    for fault, told in FAULTS.items():
        failed, fine = (
            rows[(rows["agent"] == str(planner(fault))) & (rows["seed"] == seed)].iloc[0]
            for seed in SEEDS
        )
        assert (failed["outcome"], failed["success"]) == ("agent_error", 0)
        assert failed["error"].startswith(told.replace("PLANNER", path))
        assert (fine["outcome"], fine["error"]) == ("timeout", "")


def test_a_planner_that_hangs_from_the_start_is_recorded_too(tmp_path, planner):
    path = Path(planner().name.partition(":")[0])
    path.write_text(PLANNER.replace("self.even, self.steps = ", "self.sleeps()  # "))
    run([Task(TINY, planner(), [0])], tmp_path, jobs=1, limits=QUICK)
    rows = load_results(tmp_path)
    assert list(rows["outcome"]) == ["agent_error"]
    assert rows["error"].str.startswith("the first reset or act did not return within").all()


def test_a_planner_that_cannot_be_made_ends_the_run_before_it_begins(tmp_path, planner):
    good = planner()
    dies = AgentSpec(good.name, {"dies": True})
    for spec, told in [
        (AgentSpec("orcaa", {}), "unknown agent 'orcaa'; did you mean 'orca'?"),
        (AgentSpec(good.name, {"fualt": 1}), "has no option 'fualt'; did you mean 'fault'?"),
        (dies, "its process ended with exit code 3 in __init__"),
    ]:
        with pytest.raises(AgentError) as caught:
            run([Task(TINY, good, [0]), Task(TINY, spec, [0])], tmp_path, jobs=1, limits=QUICK)
        assert told in str(caught.value)
    assert load_results(tmp_path).empty


def test_an_agent_that_people_do_not_suit_ends_the_run_before_it_begins(tmp_path):
    path = tmp_path / "walk.csv"
    path.write_text(walking())
    informed = AgentSpec.parse("informed:intent=sampled")
    with pytest.raises(AgentError) as caught:
        run([Task(TINY, informed, [0]), Task(crossing(path), informed, [0])], tmp_path, jobs=1)
    assert str(caught.value) == (
        "agent 'informed:intent=sampled' cannot drive among the people of scenario "
        "'multimodal_fast', whose pedestrians.model is 'recorded'; allowed: any but recorded"
    )
    assert load_results(tmp_path).empty


def test_a_scenario_without_room_is_refused(tmp_path, planner):
    full = TINY.override({"pedestrians.count": 500})
    with pytest.raises(ScenarioError, match="room"):
        run([Task(full, planner(), [0])], tmp_path, jobs=1)


def test_a_folder_that_cannot_be_written_to_is_refused_before_anything_runs(tmp_path, planner):
    (tmp_path / "results").write_text("in the way")
    with pytest.raises(ResultsError, match="results"):
        run([Task(TINY, planner(), [0])], tmp_path / "results", jobs=1)


def test_stored_commands_give_the_stored_rows(tmp_path, planner):
    tasks = [Task(TINY, planner("raises"), range(3))]
    (cell,) = run(tasks, tmp_path, jobs=1)
    rows = load_results(tmp_path)
    assert list(rows["seed"]) == [0, 1, 2]
    for _, stored in rows.iterrows():
        (episode,) = load_episodes(tmp_path, cell, TINY, stored["seed"])
        assert (episode.outcome, episode.error or "") == (stored["outcome"], stored["error"])
        assert episode.commands.tolist() == [[0.5, 0.1]] * stored["steps"]
        values = metrics(episode)
        assert [repr(values[name]) for name in MEASURED] == [repr(stored[n]) for n in MEASURED]
        if "processor_share" not in stored["diagnostics"]:  # else the machine is busy
            assert values["inference_s"] == pytest.approx(stored["inference_s"], rel=1e-6)


def test_a_row_names_what_its_episode_depends_on(tmp_path, planner):
    run([Task(TINY, planner(), [0])], tmp_path, jobs=1)
    (row,) = load_results(tmp_path).to_dict("records")
    assert (row["version"], row["architecture"]) == (version("crowdbench-nav"), platform.machine())
    for library in ("pymunk", "numpy", "torch"):
        assert row[library] == version(library)


def test_an_agent_that_warns_of_ever_new_things_is_not_listened_to_for_ever(tmp_path):
    path = tmp_path / "talks.py"
    path.write_text(
        "import warnings, crowdbench\n"
        "class Talks(crowdbench.Agent):\n"
        "    def reset(self, robot, seed):\n"
        "        pass\n"
        "    def act(self, observation):\n"
        "        for number in range(1000):\n"
        "            warnings.warn(f'{number} of many')\n"
        "        return 0.0, 0.0\n"
    )
    with pytest.warns(UserWarning) as caught:
        run([Task(TINY, AgentSpec(f"{path}:Talks", {}), SEEDS)], tmp_path / "results", jobs=1)
    told = [str(one.message) for one in caught if "Talks" in str(one.message)]
    assert len(told) == 21
    assert told[0].endswith("0 of many")
    assert told[-1].endswith("further warnings of this run are not shown")


@pytest.mark.parametrize(("cores", "told"), [(1, ", 1 core, 1 thread"), (2, ", 2 cores, 1 thread")])
def test_a_machine_is_named_with_its_cores(monkeypatch, cores, told):
    monkeypatch.setattr("crowdbench.evaluation.machine.core_count", lambda: cores)
    assert told in machine_name()


CHEATS = """
import crowdbench.evaluation.driven as driven
import crowdbench.evaluation.metrics as measured
import crowdbench.evaluation.rollout as rollout
of = driven.Driven.of

def claim(episode):
    import dataclasses
    told = of(episode)
    if episode.seed % 2 == 0:
        changes = {CHANGES}
        told = dataclasses.replace(told, **changes)
    return told

driven.Driven.of = staticmethod(claim)
measured.spl = measured.success = lambda episode: 1.0
"""


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ('{"outcome": "success"}', "said to end with success, but robot_0 ends with timeout"),
        ('{"commands": told.commands[:-2], "inference_s": told.inference_s[:-2]}', "goes on"),
        ('{"commands": told.commands * float("nan")}', "not two finite numbers"),
        ('{"inference_s": told.inference_s - 1}', "times are not one for each step"),
        ('{"robot": "robot_7"}', "robot_7"),
    ],
)
def test_what_an_agents_process_makes_up_is_not_stored_and_the_rest_is(
    tmp_path, planner, changes, told
):
    spec = planner()
    path = Path(spec.name.partition(":")[0])
    path.write_text(PLANNER + CHEATS.replace("{CHANGES}", changes))
    with pytest.raises(IncompleteError) as caught:
        run([Task(TINY, spec, range(4))], tmp_path, jobs=1)
    assert len(caught.value.missing) == 2
    for seed, line in zip((0, 2), map(str, caught.value.missing), strict=True):
        assert str(spec) in line and "tiny@" in line and f"seed {seed}" in line and told in line
    rows = load_results(tmp_path)
    assert list(rows["seed"]) == [1, 3]
    assert set(rows["success"]) == {0.0}, "metrics are computed outside the agent's process"
    (cell,) = caught.value.cells
    assert load_commands(tmp_path, cell, 0) is None


EPISODES = 80
SCRIPT = """
import sys
from crowdbench import AgentSpec, load_scenario
from crowdbench.evaluation.runner import Task, run
from crowdbench.scenario import Scenario
scenario = Scenario.model_validate_json(sys.argv[2])
tasks = [Task(scenario, AgentSpec.parse(sys.argv[3]), range(int(sys.argv[4])))]
def report(progress):
    print(progress.done, flush=True)
    if progress.done == 0:
        sys.stdin.readline()
run(tasks, sys.argv[1], jobs=2, on_progress=report)
"""


def runner(folder, spec):
    """A run in a process of its own, waiting for a line with its plan made."""
    arguments = [str(folder), TINY.model_dump_json(), str(spec), str(EPISODES)]
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "0\n"
    return process


def begin(process):
    process.stdin.write("\n")
    process.stdin.flush()


def children(pid):
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(child) for child in text.split()]


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks up processes in /proc")
def test_a_run_that_is_ended_loses_nothing_and_leaves_no_process(tmp_path, planner):
    rng, kept = random.Random(0), 0
    for how in (signal.SIGINT, signal.SIGKILL):
        process = runner(tmp_path, planner())
        workers = children(process.pid)
        assert len(workers) == 2
        begin(process)
        process.stdout.readline()
        time.sleep(rng.uniform(0, 0.05))
        process.send_signal(how)
        process.communicate()
        wait_until_gone(workers)
        rows = load_results(tmp_path)
        assert rows["seed"].is_unique
        assert kept < len(rows) < EPISODES
        kept = len(rows)
    run([Task(TINY, planner(), range(EPISODES))], tmp_path, jobs=1)
    assert list(load_results(tmp_path)["seed"]) == list(range(EPISODES))


def wait_until_gone(pids):
    deadline = time.monotonic() + 10
    while any(Path(f"/proc/{pid}/exe").exists() for pid in pids):
        assert time.monotonic() < deadline, "workers outlive their parent"
        time.sleep(0.02)


def test_two_runs_at_once_share_the_work_without_mixing_it_up(tmp_path, planner):
    both = [runner(tmp_path, planner("prints")) for _ in range(2)]
    for process in both:
        begin(process)
    for process in both:
        output, errors = process.communicate()
        assert process.returncode == 0, errors
        assert "planning ..." in errors, "what a planner prints stays out of the output"
        assert "planning" not in output
    assert list(load_results(tmp_path)["seed"]) == list(range(EPISODES))
