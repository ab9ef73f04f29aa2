from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

START = "import sys; from crowdbench.cli import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture
def busy():
    """Four processes that want the processor for themselves."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(4)]
    yield
    for process in processes:
        process.kill()
        process.wait()


@pytest.mark.usefixtures("busy")
def test_on_a_busy_machine_that_has_compiled_nothing_no_episode_is_an_agent_error(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    worlds = ["-s", "multimodal_fast", "-s", "corridor_dense", "--set", "time_limit=4"]
    arguments = ["run", *worlds, "-a", "informed", "-n", "2", "-j", "2"]
    ran = [
        subprocess.run(
            [sys.executable, "-c", START, *arguments, "--results", str(tmp_path / name), *more],
            env=environment,
            capture_output=True,
            text=True,
        )
        for name, more in (("first", ()), ("second", ("--json",)))
    ]
    assert [one.returncode for one in ran] == [0, 0]
    assert "compiling for crowdbench, informed (once per machine)" in ran[0].stderr
    assert "agent_error" not in ran[0].stdout
    assert ran[1].stderr == "", "nothing is left to be compiled"
    for cell in json.loads(ran[1].stdout)["cells"]:
        assert (cell["episodes"], cell["errors"]) == (2, [])
