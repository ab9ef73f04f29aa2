from __future__ import annotations

import os
import subprocess
import sys

import pytest

from crowdbench.cli import main
from crowdbench.evaluation.database import ResultsError, require_writable

PRETEND = "import sys; import crowdbench, typer; sys.platform = 'win32'; "


def python(code, *arguments, **environment):
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        env={**os.environ, **environment},
    )


@pytest.mark.parametrize("module", ["crowdbench.cli", "crowdbench.evaluation.runner"])
def test_where_it_cannot_run_it_says_so(module):
    done = python(PRETEND + f"import {module}")
    assert done.returncode == 1
    assert b"on Windows use the Windows Subsystem for Linux" in done.stderr.splitlines()[-1]
    assert module != "crowdbench.cli" or len(done.stderr.splitlines()) == 1


def test_a_terminal_that_knows_only_ascii_gets_tables_too(tmp_path):
    run = "import sys; from crowdbench.cli import main; sys.exit(main(sys.argv[1:]))"
    arguments = ["run", "-a", "straight_line", "-n", "1", "--results", str(tmp_path)]
    done = python(run, *arguments, PYTHONIOENCODING="ascii", LANG="C", LC_ALL="C")
    assert done.returncode == 0, done.stderr
    assert b"success ^" in done.stdout and b"inference_s v" in done.stdout
    assert done.stdout.isascii() and b"?" not in done.stdout


def test_a_name_that_no_folder_can_have_is_told_of(tmp_path):
    with pytest.raises(ResultsError, match="name too long"):
        require_writable(tmp_path / ("x" * 5000))


def test_more_episodes_than_a_run_can_plan_are_refused(capsys):
    assert main(["run", "-n", "1000000000"]) == 2
    words = capsys.readouterr().err.replace("│", " ").split()
    assert "less than or equal to 1000000" in " ".join(words)
