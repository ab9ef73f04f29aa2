"""The process apart: what it does, how it fails and when it ends."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

from crowdbench.evaluation.apart import apart
from crowdbench.evaluation.database import ResultsError

ALONE = """
import os, signal
from crowdbench.evaluation.apart import apart
print(apart(os.getpid), flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""
LIGHT = """
import sys
import crowdbench_studies.paper, crowdbench.site.website, crowdbench.study.output
print([name for name in ("numba", "pymunk", "scipy.stats", "torch") if name in sys.modules])
"""


def test_one_other_process_answers():
    assert apart(os.getpid) == apart(os.getpid) != os.getpid()


def test_what_a_function_raises_is_raised_here():
    with pytest.raises(ValueError, match="invalid literal"):
        apart(int, "many")
    assert apart(int, "3") == 3


def test_an_end_from_outside_is_told_and_the_next_call_has_a_new_process():
    other = apart(os.getpid)
    os.kill(other, signal.SIGKILL)
    with pytest.raises(ResultsError, match="ended from outside"):
        apart(os.getpid)
    assert apart(os.getpid) != other


def test_it_ends_with_the_process_that_has_started_it():
    ended = subprocess.run([sys.executable, "-c", ALONE], stdout=subprocess.PIPE, text=True)
    assert ended.returncode == -signal.SIGKILL
    until = time.monotonic() + 20
    while psutil.pid_exists(int(ended.stdout)) and time.monotonic() < until:
        time.sleep(0.05)
    assert not psutil.pid_exists(int(ended.stdout))


def test_tables_figures_and_pages_do_not_need_what_simulates():
    imported = subprocess.run(
        [sys.executable, "-c", LIGHT], capture_output=True, text=True, check=True
    )
    assert imported.stdout.strip() == "[]"
