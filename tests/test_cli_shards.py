"""A run in parts: ``crowdbench run --shard I/N`` and ``crowdbench merge``."""

from __future__ import annotations

import pytest

from crowdbench.cli import main
from crowdbench.evaluation.results import load_results

TINY = """
extends: multimodal_fast
time_limit: 1
pedestrians: {count: 1}
"""


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run five episodes of an agent in a tiny world, with more options."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.yaml").write_text(TINY)
    plan = ["run", "-s", "tiny.yaml", "-a", "straight_line", "-n", "3", "--seed", "10", "-j", "1"]
    return lambda *options: main([*plan, "--results", "mine", *options])


def test_parts_that_are_run_alone_are_put_together(run, capsys):
    assert run("--shard", "1/2") == 0
    assert "mine/shard-1-of-2/results.sqlite" in capsys.readouterr().out
    assert list(load_results("mine/shard-1-of-2")["seed"]) == [10, 12]
    assert main(["merge", "mine/shard-1-of-2", "--into", "mine"]) == 1
    told = capsys.readouterr()
    assert "mine/results.sqlite: 2 episodes added, 0 were there" in told.out
    assert "1 of 3 seeds are missing: 11" in told.err
    assert run("--shard", "2/2") == 0
    capsys.readouterr()
    assert main(["merge", "mine/shard-1-of-2", "mine/shard-2-of-2", "--into", "mine"]) == 0
    assert "1 episodes added, 2 were there" in capsys.readouterr().out
    assert list(load_results("mine")["seed"]) == [10, 11, 12]
    assert run() == 0
    assert "3 of 3 episodes were in mine before" in capsys.readouterr().err


@pytest.mark.parametrize(
    "text", ["0/3", "4/3", "a/b", "1", "1/2/3", "-1/2", "1/0", " 1/2", "1.0/2"]
)
def test_what_is_no_part_is_refused(run, capsys, text):
    assert run("--shard", text) == 2
    told = capsys.readouterr().err
    assert told == f"--shard {text!r}: expected I/N with whole numbers 1 <= I <= N, e.g. 1/4\n"


def test_more_parts_than_episodes_are_refused(run, capsys):
    assert run("--shard", "4/4") == 2
    assert "3 episodes per cell (--episodes) make at most 3 shards" in capsys.readouterr().err


def test_merging_what_holds_no_results_is_one_line(tmp_path, capsys):
    assert main(["merge", str(tmp_path), "--into", str(tmp_path / "into")]) == 2
    told = capsys.readouterr()
    assert (told.out, told.err.count("\n")) == ("", 1)
    assert "no results here (results.sqlite); merge takes results folders" in told.err
