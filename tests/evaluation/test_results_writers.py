"""Processes that write the same results, and are killed."""

import contextlib
import json
import random
import signal
import sqlite3
import subprocess
import sys
import time

from short_episodes import CELL

from crowdbench.evaluation.database import FILE
from crowdbench.evaluation.results import load_results

WRITER = """
import json, sys
from pathlib import Path
import numpy as np
from crowdbench.evaluation import metrics
from crowdbench.evaluation.results import Cell, Result, ResultsStore
folder, first, last, cell = sys.argv[1:]
store, cell = ResultsStore(Path(folder)), Cell(**json.loads(cell))
commands, times = np.ones((60, 2)), np.ones(60)
print("ready", flush=True)
sys.stdin.readline()
for seed in range(int(first), int(last)):
    facts = {"outcome": "success", "steps": 60, "metrics": {"success": 1.0}, "error": "e" * 900}
    store.append(cell, [
        Result(seed, robot, commands=commands, inference_s=times, **facts)
        for robot in ("robot_0", "robot_1")
    ])
"""


def writer(folder, first, last):
    """A process that waits for a line and then stores episodes of two robots."""
    numbers = map(str, (first, last))
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(folder), *numbers, json.dumps(vars(CELL))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "ready\n"
    return process


def begin(process):
    process.stdin.write("\n")
    process.stdin.flush()


def assert_whole(folder, seeds):
    """Exactly these episodes, each with both robots and their commands, in a sound file."""
    stored = load_results(folder)
    assert list(stored["seed"]) == [seed for seed in seeds for _ in range(2)]
    with contextlib.closing(sqlite3.connect(folder / FILE)) as database:
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        for table in ("metrics", "actions"):
            found = database.execute(f"SELECT count(*) FROM {table}").fetchone()
            assert found == (len(stored),)


def test_a_writer_killed_at_random_moments_loses_and_doubles_nothing(tmp_path):
    rng, seeds, kept = random.Random(0), 30000, 0
    for _ in range(4):
        process = writer(tmp_path, 0, seeds)
        begin(process)
        deadline = time.monotonic() + 60
        while len(load_results(tmp_path)) // 2 <= kept:
            assert time.monotonic() < deadline, "nothing is stored"
        time.sleep(rng.uniform(0, 0.3))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        count = len(load_results(tmp_path)) // 2
        assert_whole(tmp_path, range(count))
        assert count >= kept
        kept = count
    assert 0 < kept < seeds, "the kills came too late to say anything"
    process = writer(tmp_path, 0, kept + 50)
    process.communicate("\n")
    assert_whole(tmp_path, range(kept + 50))


def test_two_processes_may_write_the_same_results_at_once(tmp_path):
    both = [writer(tmp_path, 0, 300), writer(tmp_path, 100, 400)]
    for process in both:
        begin(process)
    for process in both:
        assert process.communicate()[1] == ""
    assert_whole(tmp_path, range(400))
