"""Agents that do to their process what planners do, run beside one that does nothing of it."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import deque
from pathlib import Path

import psutil
import pytest
from short_episodes import TINY

from crowdbench import AgentSpec
from crowdbench.agent import AgentError
from crowdbench.evaluation.keeper import KEPT
from crowdbench.evaluation.pool import Limits, Pool
from crowdbench.evaluation.protocol import Describe, Described
from crowdbench.evaluation.results import load_results
from crowdbench.evaluation.runner import IncompleteError, Task, run

PLANNERS = '''
import gc, os, pickle, signal, subprocess, sys, time
import crowdbench

class Steady(crowdbench.Agent):
    """Drives ahead; those below do something else as well, at their fourth step."""

    def reset(self, robot, seed):
        self.steps = 0

    def act(self, observation):
        self.steps += 1
        if self.steps == 4:
            self.misbehave()
        return 0.4, 0.2

    def misbehave(self):
        pass

class Moves(Steady):
    def misbehave(self):
        os.chdir("/usr")

class Patches(Steady):
    def misbehave(self):
        import crowdbench.evaluation.driven as driven
        import crowdbench.evaluation.metrics as metrics
        driven.packed = driven.simulate = None
        metrics.metrics = lambda episode: {"success": 1.0}

class Doubles(Steady):
    """Two processes go on from here, and both would answer."""

    def misbehave(self):
        if os.fork() == 0:
            time.sleep(0.05)

class Leaves(Steady):
    """Leaves children behind: in a session of their own, forked and as programs."""

    def misbehave(self):
        if os.fork() == 0:
            os.setsid()
            time.sleep(1000)
        program = [sys.executable, "-c", "import time; time.sleep(1000)", "left behind"]
        for environment in (None, {}):
            subprocess.Popen(program, start_new_session=True, env=environment)
        if sys.platform == "linux" and os.fork() == 0:
            os.setsid()
            if os.fork() == 0:  # nothing leads to it any more
                os.execve(program[0], program, {})
            os._exit(0)

class Anonymous(Steady):
    def misbehave(self):
        exec(compile("raise LookupError('lost')", "", "exec"))

class Odd(Exception):
    def __str__(self):
        raise ValueError("no text")
    __repr__ = __str__

class Unprintable(Steady):
    def misbehave(self):
        raise Odd

class Interrupts(Steady):
    def misbehave(self):
        raise KeyboardInterrupt("enough")

class Stop(BaseException):
    pass

class Stops(Steady):
    def misbehave(self):
        raise Stop("at once")

class Text(str):
    def __reduce__(self):
        raise TypeError("stays here")

class Hashed(Steady):
    weights_sha256 = Text("a\\nb,\\"c")

class Counts(Steady):
    def diagnostics(self):
        return {Text("solved\\n"): Text("1"), 3: True}

class Kills(Steady):
    def misbehave(self):
        os.kill(os.getpid(), signal.SIGKILL)

class Unkept(Steady):
    def misbehave(self):
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(1000)

class Raises(Steady):
    def misbehave(self):
        signal.raise_signal(signal.SIGTERM)

class Numbered(Steady):
    weights_sha256 = 7

class Waits(Steady):
    """Says where it is and waits, as often as there are files to say it in."""

    def __init__(self, folder="."):
        self.folder = folder

    def misbehave(self):
        for name in ("one", "two"):
            try:
                with open(os.path.join(self.folder, name), "x") as file:
                    file.write(str(os.getpid()))
            except FileExistsError:
                continue
            time.sleep(1000)

def write_everywhere(content):
    for descriptor in range(3, 64):
        try:
            os.write(descriptor, content)
        except OSError:
            pass

class Half(Steady):
    """Writes the length of an answer, and half of it."""

    def misbehave(self):
        write_everywhere((1 << 27).to_bytes(4, "big") + b"half")

class Endless(Steady):
    def misbehave(self):
        write_everywhere(b"\\x7f\\xff\\xff\\xff" + b"more than fits")

class Order:
    def __reduce__(self):
        return os.mkdir, (os.path.join(os.path.dirname(__file__), "obeyed"),)

class Orders(Steady):
    """Sends an answer that runs code where it is read."""

    def misbehave(self):
        message = pickle.dumps((2, Order()))
        write_everywhere(len(message).to_bytes(4, "big") + message)

class Mute(Steady):
    """Keeps the worker from its heartbeat and never comes back."""

    def misbehave(self):
        for thing in gc.get_objects():
            if type(thing).__name__ == "Heartbeat":
                thing._memory[:] = bytes(len(thing._memory))
        while True:
            pass

class Fails(Steady):
    def misbehave(self):
        if not os.path.exists(os.path.join(os.path.dirname(__file__), "mended")):
            raise RuntimeError("not yet")
'''


@pytest.fixture
def planners(tmp_path):
    """Spec of a planner above, by its class."""
    path = tmp_path / "planners.py"
    path.write_text(PLANNERS)

    def spec(name, **options):
        return AgentSpec(f"{path}:{name}", options)

    return spec


def test_no_more_processes_are_kept_than_a_pool_may():
    before = {process.pid for process in psutil.Process().children()}
    with Pool(1, Limits(), keep=1) as pool:
        for name in ("straight_line", "dynamic_window"):
            queue = deque([Describe(AgentSpec(name, {}))])
            assert [type(answer) for _, answer in pool.run(queue)] == [Described]
        assert len({process.pid for process in psutil.Process().children()} - before) == 1


def rows_of(folder, spec):
    rows = load_results(folder, agent=str(spec))
    return rows[["seed", "outcome", "steps", "path_length", "error"]].to_dict("records")


def test_what_an_agent_does_to_its_process_changes_no_other_agents_rows(
    tmp_path, planners, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    steady, alone, together = planners("Steady"), tmp_path / "alone", tmp_path / "together"
    relative = AgentSpec("planners.py:Moves", {})
    names = ("Patches", "Doubles", "Leaves", "Anonymous", "Hashed", "Counts", "Unprintable")
    specs = [relative, *map(planners, names)]
    run([Task(TINY, steady, range(2))], alone, jobs=1)
    run([Task(TINY, spec, range(2)) for spec in (*specs, steady)], together, jobs=2)
    expected = rows_of(alone, steady)
    assert [row["outcome"] for row in expected] == ["timeout"] * 2
    for spec in (steady, *specs[:4], *specs[5:7]):
        assert rows_of(together, spec) == expected
    for name, told in (
        ("Anonymous", "LookupError: lost"),
        ("Unprintable", "Odd: <exception str() failed>"),
    ):
        found = rows_of(together, planners(name))
        assert [(row["outcome"], told in row["error"]) for row in found] == [
            ("agent_error", True)
        ] * 2
    (hashed,) = set(load_results(together, agent=str(planners("Hashed")))["weights_sha256"])
    assert hashed.isprintable() and len(hashed) == 64
    assert "left behind" not in [word for one in psutil.process_iter() for word in words(one)]


def words(process):
    try:
        return process.cmdline()
    except psutil.Error:
        return []


def test_an_error_is_the_agents_whatever_its_class_and_however_it_ends_its_process(
    tmp_path, planners
):
    told = {
        "Interrupts": "KeyboardInterrupt: enough (",
        "Stops": "Stop: at once (",
        "Kills": "its process ended with SIGKILL",
        "Raises": "its process ended with SIGTERM",
    }
    if KEPT:  # elsewhere this would be the end of the tests
        told["Unkept"] = "its process ended with SIGKILL"
    run([Task(TINY, planners(name), [0]) for name in told], tmp_path, jobs=2)
    for name, text in told.items():
        (row,) = rows_of(tmp_path, planners(name))
        assert row["outcome"] == "agent_error"
        assert text in row["error"]


@pytest.mark.slow
def test_no_answer_that_an_agent_writes_stops_the_run_or_runs_code(tmp_path, planners):
    names = ("Half", "Endless", "Orders", "Mute")
    limits = Limits(making=12)  # of the machine's time; Half and Mute take all of it
    run([Task(TINY, planners(name), [0]) for name in names], tmp_path, jobs=4, limits=limits)
    told = {
        "Half": "its process did not answer within 12 s without computing",
        "Endless": "its process sent something that is not an answer",
        "Orders": "its process sent something that is not an answer",
        "Mute": "its process did not answer within 12 s of processor time",
    }
    for name, text in told.items():
        (row,) = rows_of(tmp_path, planners(name))
        assert row["outcome"] == "agent_error"
        assert row["error"].startswith(text)
    assert not (tmp_path / "obeyed").exists()


def test_weights_that_are_not_text_are_refused_before_anything_runs(tmp_path, planners):
    with pytest.raises(AgentError, match="weights_sha256 is 7, expected text or None"):
        run([Task(TINY, planners("Numbered"), [0])], tmp_path, jobs=1)


def killed_when_it_waits(folder, name, number):
    """Send a signal to the process that writes its id to a file."""
    deadline = time.monotonic() + 120
    path = Path(folder) / name
    while not (path.exists() and path.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    os.kill(int(path.read_text()), number)


@pytest.mark.parametrize(("times", "missing"), [(1, []), (2, [0])])
def test_an_episode_whose_process_is_killed_from_outside_is_tried_once_more_and_never_stored(
    tmp_path, planners, times, missing
):
    signals = {"one": signal.SIGKILL, "two": signal.SIGTERM}
    if times == 1:
        (tmp_path / "two").write_text("taken")
        del signals["two"]
    killers = [
        threading.Thread(target=killed_when_it_waits, args=(tmp_path, name, number))
        for name, number in signals.items()
    ]
    for killer in killers:
        killer.start()
    spec = planners("Waits", folder=str(tmp_path))
    tasks, results = [Task(TINY, spec, range(2))], tmp_path / "results"
    limits = Limits(step=100)
    if missing:
        with pytest.raises(IncompleteError) as caught:
            run(tasks, results, jobs=1, limits=limits)
        (one,) = caught.value.missing
        assert one.seed == 0
        assert one.reason == (
            "its process was killed from outside (SIGTERM) in act at step 3, twice"
        )
    else:
        run(tasks, results, jobs=1, limits=limits)
    for killer in killers:
        killer.join()
    assert [row["seed"] for row in rows_of(results, spec)] == sorted({0, 1} - set(missing))
    assert [row["outcome"] for row in rows_of(results, spec)] == ["timeout"] * (2 - len(missing))


def test_stored_errors_are_run_again_when_asked_for(tmp_path, planners):
    tasks, results = [Task(TINY, planners("Fails"), range(2))], tmp_path / "results"
    run(tasks, results, jobs=1)
    (tmp_path / "mended").touch()
    for retry, outcome in ((False, "agent_error"), (True, "timeout")):
        run(tasks, results, jobs=1, retry_errors=retry)
        found = rows_of(results, planners("Fails"))
        assert [(row["seed"], row["outcome"]) for row in found] == [(0, outcome), (1, outcome)]
