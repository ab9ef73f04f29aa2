"""A metric is one entry, also from another package; every place prints what follows from it."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from crowdbench.evaluation.publish import publish
from crowdbench.evaluation.record import load_record

PLACES = """\
import json, sys
from pathlib import Path

from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.results import load_results
from crowdbench.site.leaderboard import cell_documents, metric_documents
from crowdbench.study import Cell
from crowdbench.study.measurements import Measurements

folder = Path(sys.argv[1])
rows = load_results(folder)
cells = {cell.agent: document["estimates"] for cell, document in cell_documents(rows)}
measured = Measurements(rows, [Cell("corridor_sparse", agent, 6) for agent in cells])
print(json.dumps({
    "page": metric_documents(),
    "leaderboard": {agent: dict(zip(METRICS, cells[agent])) for agent in cells},
    "tables": {
        agent: {name: measured.mean(agent, ("corridor_sparse",), name) for name in METRICS}
        for agent in cells
    },
    "rows": rows[rows["agent"] == "orca"][["steps", "slow", "half_steps"]].to_dict("list"),
}))
"""


class Outside:
    """A folder with a package of somebody else's, and crowdbench as one uses it beside that."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "places.py").write_text(PLACES)

    def install(self, code: str, points: str) -> None:
        """Write the package: one file and its entry points."""
        (self.folder / "outside.py").write_text(code)
        info = self.folder / "outside-1.0.dist-info"
        info.mkdir(exist_ok=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: outside\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[crowdbench.metrics]\n{points}")

    def python(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run Python where the package is found."""
        environment = os.environ | {"PYTHONPATH": str(self.folder), "COLUMNS": "120"}
        command = [sys.executable, *arguments]
        return subprocess.run(
            command, cwd=self.folder, env=environment, capture_output=True, text=True
        )

    def crowdbench(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        return self.python("-m", "crowdbench.cli", *arguments, "--results", "results")


RUN = ("run", "-s", "corridor_sparse", "-a", "orca", "-a", "straight_line", "-n", "6", "-j", "1")


@pytest.fixture(scope="module")
def outside(tmp_path_factory):
    """A package with two metrics beside six episodes of two agents that were run with them."""
    outside = Outside(tmp_path_factory.mktemp("outside"))
    outside.install(
        """
from crowdbench import Episode, Metric


def slow(episode: Episode) -> float:
    return episode.steps > 55


SLOW = Metric(slow, "", "lower", "took longer than 11 s", "proportion", main=True, digits=2)
HALF = Metric(
    lambda episode: episode.steps / 2, "s", "lower", "half of the steps", "mean",
    label="Half", printed_unit="min", scale=1 / 60, digits=4,
)
""",
        "slow = outside:SLOW\nhalf_steps = outside:HALF\n",
    )
    done = outside.crowdbench(*RUN, "--json")
    assert done.returncode == 0, done.stderr
    outside.document = json.loads(done.stdout)
    done = outside.python("places.py", "results")
    assert done.returncode == 0, done.stderr
    outside.places = json.loads(done.stdout)
    return outside


def test_metrics_of_another_package_are_measured_and_stored(outside):
    rows = outside.places["rows"]
    assert len(rows["steps"]) == 6
    assert rows["slow"] == [float(steps > 55) for steps in rows["steps"]]
    assert rows["half_steps"] == [steps / 2 for steps in rows["steps"]]


def test_the_interval_follows_from_the_entry(outside):
    rows = outside.places["rows"]
    found = {cell["agent"]: cell["metrics"] for cell in outside.document["cells"]}["orca"]
    share = stats.binomtest(int(sum(rows["slow"])), 6).proportion_ci(method="wilson")
    assert found["slow"] == pytest.approx(
        {"mean": np.mean(rows["slow"]), "low": share.low, "high": share.high, "n": 6}
    )
    assert found["half_steps"]["mean"] == pytest.approx(np.mean(rows["half_steps"]))
    assert found["half_steps"]["low"] < found["half_steps"]["mean"] < found["half_steps"]["high"]


def test_run_tables_and_leaderboard_have_the_same_intervals(outside):
    for cell in outside.document["cells"]:
        for name, found in cell["metrics"].items():
            expected = [found[key] for key in ("mean", "low", "high", "n")]
            for place in ("tables", "leaderboard"):
                numbers = outside.places[place][cell["agent"]][name]
                plain = [None if np.isnan(number) else number for number in numbers]
                assert plain == expected, (cell["agent"], name, place)


def test_the_page_knows_them_after_crowdbenchs_own(outside):
    *_, half, slow = outside.places["page"]
    assert half == {
        "name": "half_steps", "label": "Half", "unit": "min", "scale": 1 / 60, "digits": 4,
        "better": "lower", "definition": "half of the steps", "main": False,
    }  # fmt: skip
    assert (slow["name"], slow["label"], slow["main"]) == ("slow", "slow", True)


def test_the_command_line_prints_and_compares_them(outside):
    text = outside.crowdbench(*RUN).stdout
    assert "slow ↓ " in text and "half_steps" not in text, "only main ones are shown"
    compare = ("compare", "orca", "straight_line", "-s", "corridor_sparse")
    done = outside.crowdbench(*compare, "-m", "half_steps", "-m", "slow")
    assert done.returncode == 0, done.stderr
    mean = np.mean(outside.places["rows"]["half_steps"]) / 60
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("half_steps ↓ [min]")]
    assert line.split()[3] == f"{mean:.4f}"


@pytest.mark.parametrize(
    ("code", "told"),
    [
        ("import nothing_there", "metric 'late' (outside:LATE) cannot be loaded: ModuleNotFound"),
        ("LATE = len", "metric 'late': <built-in function len> is not a crowdbench"),
        (
            "import crowdbench\nLATE = crowdbench.Metric(len, '', 'up', '', 'mean')",
            "expected higher or lower, got 'up'",
        ),
    ],
)
def test_a_metric_that_is_none_is_said_in_one_line_before_anything_is_run(tmp_path, code, told):
    outside = Outside(tmp_path)
    outside.install(code, "late = outside:LATE\n")
    done = outside.crowdbench(*RUN)
    assert (done.returncode, done.stdout) == (2, "")
    assert told in done.stderr and done.stderr.count("\n") == 1
    assert not (tmp_path / "results").exists()


def test_episodes_older_than_a_metric_lack_it_and_say_so(outside, tmp_path):
    later = Outside(tmp_path)
    later.install(
        "import crowdbench\nLATE = crowdbench.Metric(len, '', 'lower', '', 'mean', main=True)\n",
        "late = outside:LATE\n",
    )
    (tmp_path / "results").symlink_to(outside.folder / "results")
    compare = ("compare", "orca", "straight_line", "-s", "corridor_sparse")
    done = later.crowdbench(*compare)
    assert done.returncode == 0, done.stderr
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("late ↓")]
    assert line.split()[2:] == ["-", "-", "-", "-", "-", "0"]
    told = r"^orca: late is not computed in (\d+) of \1 rows, which are older; crowdbench recompute"
    assert re.search(told, done.stdout, flags=re.MULTILINE)
    done = later.crowdbench(*RUN)
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("late ↓")]
    assert line.split()[2:] == ["not", "computed"] * 4, "of two agents, here and published"
    document = json.loads(later.crowdbench(*RUN, "--json").stdout)
    assert [cell["not_computed"]["late"] for cell in document["cells"]] == [6, 6]
    assert document["cells"][0]["metrics"]["late"]["mean"] is None
    done = later.crowdbench(*compare, "-m", "late")
    assert done.returncode == 2
    assert done.stderr == "results: the episodes of orca are older than metric 'late'\n"


def test_published_episodes_get_a_new_one_without_running_an_agent(tmp_path, make_whole):
    whole = make_whole(tmp_path / "mine")
    steps = [whole.run("corridor_sparse", "straight_line", seed).steps for seed in range(3)]
    publish([("corridor_sparse", "straight_line", 3)], whole.folder, tmp_path / "kept")
    later = Outside(tmp_path)
    later.install(
        "import crowdbench\n"
        "HALF = crowdbench.Metric(lambda e: e.steps / 2, '', 'lower', 'half the steps', 'mean')\n",
        "half_steps = outside:HALF\n",
    )
    command = ("-m", "crowdbench.cli", "recompute", "--record", "kept", "--jobs", "1")
    done = later.python(*command)
    assert done.returncode == 0, done.stderr
    told = "3 episodes simulated again; filled in: half_steps in 3 rows; everything else came"
    assert done.stdout.startswith(told)
    rows = load_record(folder=tmp_path / "kept")
    assert rows["half_steps"].tolist() == [number / 2 for number in steps]
    assert "filled in: nothing" in later.python(*command).stdout
