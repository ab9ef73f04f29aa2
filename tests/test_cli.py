from __future__ import annotations

import contextlib
import importlib.metadata
import io
import json
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from rich.console import Console

from crowdbench.agent import agent_names
from crowdbench.cli import main
from crowdbench.cli.printing import print_comparison, print_tables
from crowdbench.evaluation.results import ResultsStore, load_results
from crowdbench.evaluation.rollout import run_episode
from crowdbench.evaluation.stored import find_cells, find_scenario
from crowdbench.scenario import scenario_names, scenario_tiers

TINY = """
extends: multimodal_fast
time_limit: 6
arena: {length: 6, width: 6}
robots: {travel: 4}
pedestrians: {count: 2, leg: 2}
"""
PLANNER = """
import time
import crowdbench

class Planner(crowdbench.Agent):
    '''Drives ahead.'''
    def __init__(self, speed=0.5, fails=False, wait=0.0):
        self.speed, self.fails, self.wait = speed, fails, wait
    def reset(self, robot, seed):
        self.seed = seed
    def act(self, observation):
        time.sleep(self.wait)
        if self.fails and self.seed % 2 == 0:
            raise RuntimeError("no idea")
        return self.speed, 0.0
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a scenario, a planner, and what a run of two agents has stored and printed."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "tiny.yaml").write_text(TINY)
    (folder / "planner.py").write_text(PLANNER)
    with contextlib.redirect_stdout(io.StringIO()) as output:
        assert run(folder, *both(folder), "--json") == 0
    (folder / "output.json").write_text(output.getvalue())
    return folder


def both(place):
    """Options for a planner that ignores everybody, and one that fails now and then."""
    return "-a", "straight_line", "-a", f"{place}/planner.py:Planner:fails=true", "-n", 4


def run(place, *arguments):
    standard = ["--scenario", f"{place}/tiny.yaml", "--results", f"{place}/results", "-j", "1"]
    return main(["run", *standard, *map(str, arguments)])


def complaint(capsys, *arguments) -> str:
    """The one line that a mistake of the user's is answered with."""
    assert main([str(argument) for argument in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err.strip()


def test_what_was_stored_before_is_said_to_be(place, tmp_path, capsys):
    options = ["--scenario", f"{place}/tiny.yaml", "--results", str(tmp_path), "-j", "1"]
    command = ["run", *options, "-a", "straight_line", "-n"]
    assert main([*command, "4"]) == 0
    assert "not run again" not in capsys.readouterr().err
    assert main([*command, "6"]) == 0
    assert "4 of 6 episodes were in" in " ".join(capsys.readouterr().err.split())


def test_help_names_every_command(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    told = "run compare agents scenarios show record train tables report replay play recompute"
    for command in [*told.split(), "export", "import", "merge", "publish"]:
        assert re.search(rf"^\W+{command} ", text, re.MULTILINE)


@pytest.mark.parametrize("option", ["--set", "--step-limit", "--json"])
def test_help_of_run_names_its_options(capsys, option):
    assert main(["run", "--help"]) == 0
    assert option in capsys.readouterr().out


def test_nothing_heavy_is_loaded_before_a_command_needs_it():
    heavy = ["torch", "numba", "pandas", "scipy", "pymunk", "matplotlib", "pygame", "PIL"]
    script = f"import sys, crowdbench.cli; print([m for m in {heavy} if m in sys.modules])"
    process = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert process.stdout == "[]\n", process.stderr


def test_the_version_is_the_distributions(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"crowdbench {importlib.metadata.version('crowdbench-nav')}\n"


def test_scenarios_are_listed_with_their_numbers(capsys):
    assert main(["scenarios"]) == 0
    lines = capsys.readouterr().out.splitlines()
    first = [line.split()[0] for line in lines if line]
    assert [word for word in first if word in scenario_names()] == scenario_names()
    assert [word for word in first if word in scenario_tiers()] == scenario_tiers()
    dense = next(line.split() for line in lines if line.startswith("corridor_very_dense"))
    assert dense[1:4] == ["12", "x", "4"] and dense[5:7] == ["4", "6"]


def test_agents_are_listed_with_their_options(capsys):
    assert main(["agents"]) == 0
    text = capsys.readouterr().out
    for name in agent_names():
        assert re.search(rf"^{name} ", text, re.MULTILINE)
    assert "Turns towards the goal" in text


def test_a_run_ends_with_a_table_and_says_where_the_rows_are(place, capsys):
    assert run(place, *both(place)) == 0
    text = capsys.readouterr().out
    rows = load_results(place / "results", agent="straight_line")
    assert len(rows) == 4, "a second run finds them stored"
    assert re.search(r"success ↑ +\S+ \[\S+, \S+\]", text)
    assert re.search(rf"min_dist ↑ \[m\] +{rows['min_dist'].mean():.3f} \[\S+, \S+\]", text)
    assert re.search(r"episodes +4", text)
    assert re.findall(r"rows: (.*)", text) == [str(place / "results" / "results.sqlite")]
    assert re.search(r"\d agent_error", text)
    assert "of 4 episodes ended by an agent error, first with seed" in text
    assert "RuntimeError: no idea (" in text


def test_a_run_in_which_an_agent_does_nothing_but_fail_ends_with_1(place, tmp_path, capsys):
    failing, own = tmp_path / "failing.py", ["--results", tmp_path]
    failing.write_text(PLANNER.replace("self.seed % 2 == 0", "True"))
    agents = ["-a", f"{failing}:Planner:fails=true", "-a", "straight_line"]
    assert run(place, *own, *agents, "-n", 2) == 1
    assert re.search(r"ended by +2 agent_error", capsys.readouterr().out)
    assert run(place, *own, "-a", f"{failing}:Planner", "-n", 2) == 0


def test_json_is_one_document_and_nothing_else(place):
    text = (place / "output.json").read_text()
    document = json.loads(text)
    assert text.count("\n") == 1
    first, second = document["cells"]
    assert (first["agent"], first["episodes"]) == ("straight_line", 4)
    assert first["scenario"].startswith("tiny@")
    assert sum(first["outcomes"].values()) == 4
    values = load_results(place / "results", agent="straight_line")["path_length"]
    assert first["metrics"]["path_length"]["mean"] == pytest.approx(values.mean())
    assert first["metrics"]["path_length"]["low"] <= values.mean()
    assert second["metrics"]["time_to_goal"] == {"mean": None, "low": None, "high": None, "n": 0}
    assert len(second["errors"]) == second["outcomes"]["agent_error"] > 0
    for error in second["errors"]:
        assert error["error"].startswith("RuntimeError: no idea (")


def test_an_overridden_scenario_has_rows_of_its_own(place, capsys):
    arguments = ["--agent", "straight_line", "--episodes", 1, "--json"]
    assert run(place, *arguments, "--set", "pedestrians.count=1") == 0
    (cell,) = json.loads(capsys.readouterr().out)["cells"]
    assert cell["episodes"] == 1
    assert cell["file"] == str(place / "results" / "results.sqlite")
    stored = next(
        found
        for found in find_cells(place / "results", cell["scenario"])
        if found.scenario_digest == cell["scenario_digest"]
    )
    assert find_scenario(place / "results", stored).pedestrians.count == 1
    plain = json.loads((place / "output.json").read_text())["cells"][0]
    assert (cell["agent"], cell["scenario"]) != (plain["agent"], plain["scenario"])
    assert len(load_results(place / "results", scenario=plain["scenario"])) == 8


def test_agents_are_compared_on_the_episodes_both_ran(place, capsys):
    other = f"{place}/planner.py:Planner:fails=true"
    results = ["--results", f"{place}/results"]
    metrics = ["--metric", "path_length", "--metric", "success"]
    assert main(["compare", "straight_line", other, *results, *metrics]) == 0
    text = capsys.readouterr().out
    rows = load_results(place / "results")
    tiny = rows[rows["scenario"] == rows[rows["agent"] == other]["scenario"].iloc[0]]
    paths = tiny.pivot(index="seed", columns="agent", values="path_length")
    difference = (paths["straight_line"] - paths[other]).mean()
    line = next(line for line in text.splitlines() if line.startswith("path_length"))
    assert f" {difference:z.2f} [" in line
    assert line.split()[-1] == "4"
    assert f"B: {other}" in text.replace("\n", "")


def test_a_narrow_terminal_cuts_no_number_off():
    line = {
        "scenario": "open", "metric": "inference_s", "mean_a": 0.00023, "mean_b": 0.00028,
        "difference": -4.4e-5, "low": -9.2e-5, "high": -4.4e-6, "p": 2e-4, "p_holm": 6e-4, "n": 100,
    }  # fmt: skip
    console = Console(width=80, file=io.StringIO())
    print_comparison(console, pd.DataFrame([line]), "a", "b")
    words = console.file.getvalue().split()
    assert words.count("0.001") == 2
    assert {"100", "pairs", "[ms]", "0.23", "0.28", "-0.044", "[-0.092,", "-0.004]"} <= set(words)


def times_left_out(folder):
    """Whose times are left out, of all that is stored in a folder, as it is printed."""
    stored = load_results(folder)
    rows = {
        cell: stored[(stored["agent"] == cell.agent) & (stored["scenario"] == cell.scenario)]
        for cell in find_cells(folder)
    }
    console = Console(width=200, file=io.StringIO())
    print_tables(console, ResultsStore(folder), rows, {}, {})
    said = [line for line in console.file.getvalue().splitlines() if "leaves" in line]
    assert len(said) == 1
    return said[0].rpartition(": ")[2]


def test_whose_times_are_left_out_is_said_in_one_line(episodes):
    waited = {"diagnostics": {"crowdbench.processor_share": 0.5}}
    episodes.add("orca", success=[1, 1], fixed=waited)
    episodes.add("orca", first=2, success=[1])
    episodes.add("straight_line", success=[1])
    episodes.add("dynamic_window", success=[1], fixed=waited)
    assert sorted(times_left_out(episodes.folder).split(", ")) == [
        "dynamic_window in unimodal_slow 1 of 1",
        "orca in unimodal_slow 2 of 3",
    ]


def test_of_many_cells_it_is_said_how_many_times_are_left_out(episodes):
    waited = {"diagnostics": {"crowdbench.processor_share": 0.5}}
    scenarios = scenario_names("paper")[:8]
    for name in scenarios[:7]:
        episodes.add("orca", name, success=[1, 1], fixed=waited)
    episodes.add("orca", scenarios[7], success=[1, 1])
    assert times_left_out(episodes.folder) == "14 of 16, in 7 of 8 cells"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["run", "-s", "multimodal_fst"], "unknown scenario 'multimodal_fst'; did you mean"),
        (["run", "-a", "orcaa"], "unknown agent 'orcaa'; did you mean 'orca'?"),
        (["run", "-a", "straight_line:x=1"], "agent 'straight_line' has no option 'x'"),
        (["run", "-a", "straight_line:x"], "expected option=value, got 'x'"),
        (["run", "-a", "none.py:A"], "agent file 'none.py' does not exist"),
        (["run", "--set", "pedestrians.cout=1"], "did you mean 'count'?"),
        (["run", "--set", "pedestrians.count=-1"], "-1 is out of range; allowed: >= 0 and <= 500"),
        (["run", "--set", "pedestrians.count"], "expected key=value"),
        (
            ["run", "-a", "latent_planner", "--set", "robots.drive=omnidirectional"],
            "agent 'latent_planner' drives differential robots only",
        ),
        (["run", "--set", "robots.drive=hover"], "unknown drive 'hover'; known: differential, "),
        (["run", "--set", "pedestrians.model=walk"], "known: orca, recorded, social_force, "),
        (["show", "open_x"], "unknown scenario 'open_x'"),
        (["record", "open", "-o", "x.avi"], "expected a name that ends in .gif or .mp4"),
        (["train", "latent_planer"], "'latent_planer'; did you mean 'latent_planner'?"),
        (["compare", "straight_line", "orca", "-m", "succes"], "did you mean 'success'?"),
        (["compare", "a", "b"], "crowdbench-results: no episodes of agent 'a'"),
    ],
)
def test_a_mistake_is_answered_in_one_line(tmp_path, monkeypatch, capsys, arguments, told):
    monkeypatch.chdir(tmp_path)
    assert told in complaint(capsys, *arguments)
    assert not any(tmp_path.iterdir())


def test_a_run_that_stores_nothing_leaves_no_folder(place, tmp_path, capsys):
    crowded = ["-n", 1, "--set", "pedestrians.count=500", "--results", tmp_path / "new" / "results"]
    told = complaint(capsys, "run", "-s", place / "tiny.yaml", "-a", "straight_line", *crowded)
    assert "'tiny' has no room: pedestrian" in told and not any(tmp_path.iterdir())


CHEAT = """
import crowdbench.evaluation.driven as driven
of = driven.Driven.of

def claim(episode):
    import dataclasses
    return dataclasses.replace(of(episode), outcome="success")

driven.Driven.of = staticmethod(claim)
"""


def test_episodes_that_are_not_what_was_told_of_them_are_named_at_the_end(place, tmp_path, capsys):
    (tmp_path / "cheat.py").write_text(PLANNER + CHEAT)
    agent = f"{tmp_path}/cheat.py:Planner"
    arguments = ["run", "-s", f"{place}/tiny.yaml", "-a", agent, "--results", str(tmp_path)]
    assert main([*arguments, "-a", "straight_line", "-j", "1", "-n", "2", "--seed", "7"]) == 1
    captured = capsys.readouterr()
    assert re.search(r"episodes +2 +0, incomplete: 2", captured.out), "the complete one first"
    for seed in (7, 8):
        told = (
            rf"not stored: {re.escape(agent)} in tiny@\w+, seed {seed}: .*robot_0: said to end wit"
        )
        assert re.search(told, captured.err)
    assert "2 episodes are missing" in captured.err
    assert main([*arguments, "-j", "1", "-n", "2", "--seed", "7", "--json"]) == 1
    (cell,) = json.loads(capsys.readouterr().out)["cells"]
    assert (cell["complete"], [one["seed"] for one in cell["missing"]]) == (False, [7, 8])
    assert set(load_results(tmp_path)["agent"]) == {"straight_line"}


@pytest.mark.usefixtures("place")
def test_the_first_command_runs_and_stores_in_a_folder_of_its_own(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.yaml").write_text(TINY)
    assert main(["run", "-s", "tiny.yaml", "-a", "straight_line", "-n", "1", "-j", "1"]) == 0
    assert "rows: crowdbench-results/results.sqlite" in capsys.readouterr().out
    assert [path.name for path in (tmp_path / "crowdbench-results").iterdir()] == ["results.sqlite"]


def test_a_results_folder_that_is_none_is_found_out_at_once(place, tmp_path, capsys):
    (tmp_path / "results").write_text("in the way")
    arguments = ["run", "-s", place / "tiny.yaml", "-a", "straight_line"]
    text = complaint(capsys, *arguments, "--results", tmp_path / "results")
    assert text.startswith(f"{tmp_path / 'results'}: results cannot be written here")


def test_what_was_never_run_together_is_not_compared(place, capsys):
    arguments = ["compare", "straight_line", "orca", "--results", place / "results"]
    assert "no episodes of agent 'orca'" in complaint(capsys, *arguments)
    arguments = ["compare", "straight_line", "straight_line", "--results", place / "results"]
    assert "in scenario 'open'" in complaint(capsys, *arguments, "-s", "open")


def test_show_draws_the_beginning(place, tmp_path, capsys):
    output = tmp_path / "new" / "scene.png"
    arguments = ["show", f"{place}/tiny.yaml", "--seed", "3", "-o", str(output)]
    assert main([*arguments, "--set", "pedestrians.count=1"]) == 0
    assert str(output) in capsys.readouterr().out.replace("\n", "")
    assert np.asarray(Image.open(output)).std() > 0


def test_record_shows_every_state_of_the_episode(place, tmp_path, capsys):
    output = tmp_path / "episode.gif"
    arguments = ["record", f"{place}/tiny.yaml", "-a", "straight_line", "--seed", "1"]
    assert main([*arguments, "-o", str(output)]) == 0
    (episode,) = run_episode(f"{place}/tiny.yaml", "straight_line", seed=1)
    assert f"robot_0: {episode.outcome}" in capsys.readouterr().out
    assert Image.open(output).n_frames == episode.steps + 1


def test_ctrl_c_keeps_what_is_finished_and_says_how_to_go_on(place, tmp_path):
    agent = f"{place}/planner.py:Planner:wait=0.02"
    arguments = ["run", "-s", f"{place}/tiny.yaml", "-a", agent, "-n", "500", "-j", "2"]
    process = subprocess.Popen(
        [sys.executable, "-m", "crowdbench.cli", *arguments, "--results", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 60
    while load_results(tmp_path).empty:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate()
    assert process.returncode == 130
    assert output == ""
    kept = len(load_results(tmp_path))
    assert 0 < kept < 500
    told = re.fullmatch(
        r"Interrupted: (\d+) of 500 episodes are stored in (.*)\. "
        r"Run the same command again to go on from there\.\n",
        errors,
    )
    assert told, errors
    # A row may reach the file in the moment between the signal and the count.
    assert kept - int(told[1]) in (0, 1)
    assert told[2] == str(tmp_path)


def test_a_goal_that_can_be_passed_is_warned_of_in_one_line(tmp_path, capsys):
    path = str(tmp_path / "scene.png")
    assert main(["show", "corridor_sparse", "--set", "robots.speed=[0, 4]", "-o", path]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("warning: scenario 'corridor_sparse': a robot may pass its goal")
