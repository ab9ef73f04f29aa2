from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys

import pytest

START = "import sys; from crowdbench.cli import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture
def run(tmp_path):
    """Run an agent that compiles for seconds, in a world that needs everything that is compiled.

    It has walls, obstacles and people, and nothing is compiled yet.
    """
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    world = ["-s", "corridor_dense", "--set", "time_limit=4", "--results", str(tmp_path)]

    def run(*more):
        return subprocess.run(
            [sys.executable, "-c", START, "run", *world, "-a", "informed", "-n", "2", *more],
            env=environment,
            capture_output=True,
            text=True,
        )

    return run


@contextlib.contextmanager
def busy():
    """Four processes that want the processor for themselves."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(4)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def test_compiling_is_no_part_of_a_step_and_happens_once(run, tmp_path):
    def machine_code():
        return sorted((tmp_path / "cache").rglob("*.nbc"))

    first = run("-j", "2", "--step-limit", "2")
    compiled = machine_code()
    second = run("--seed", "1", "-j", "1", "--json")
    assert [first.returncode, second.returncode] == [0, 0]
    assert "compiling for crowdbench, informed (once per machine)" in first.stderr
    assert "agent_error" not in first.stdout
    assert second.stderr == "", "nothing is left to be compiled"
    assert compiled and machine_code() == compiled
    (cell,) = json.loads(second.stdout)["cells"]
    assert (cell["episodes"], cell["errors"]) == (2, [])


@pytest.mark.slow
def test_on_a_busy_machine_that_has_compiled_nothing_no_episode_is_an_agent_error(run):
    with busy():
        answer = run("-j", "2")
    assert answer.returncode == 0
    assert "agent_error" not in answer.stdout
