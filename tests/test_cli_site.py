"""``crowdbench report``, ``replay`` and ``play`` as a user meets them."""

from __future__ import annotations

import contextlib
import io
import json
import re
import sqlite3
import webbrowser
from collections import defaultdict
from pathlib import Path
from urllib.parse import unquote_plus

import pytest

from crowdbench.cli import main
from crowdbench.evaluation import human
from crowdbench.evaluation.database import FILE
from crowdbench.evaluation.results import load_results
from crowdbench.evaluation.rollout import run_episode
from crowdbench.study import figures

TINY = """
extends: multimodal_fast
time_limit: 2
pedestrians: {count: 2}
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a scenario and results of two agents, and of one without commands."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "tiny.yaml").write_text(TINY)
    common = ["run", "-s", f"{folder}/tiny.yaml", "--results", f"{folder}/results", "-j", "1"]
    common += ["--seed", "900000", "-n", "2"]
    with contextlib.redirect_stdout(io.StringIO()):
        whole = ["-a", "straight_line", "-a", "orca:margin=0.1"]
        assert main([*common, *whole]) == 0
        assert main([*common, "-a", "dynamic_window"]) == 0
    with contextlib.closing(sqlite3.connect(folder / "results" / FILE)) as database, database:
        database.execute("""
            DELETE FROM actions WHERE episode IN (SELECT episodes.id FROM episodes
            JOIN cells ON cell = cells.id WHERE agent = 'dynamic_window')""")
    return folder


@pytest.fixture
def opened(monkeypatch):
    """What was opened in a browser."""
    addresses = []
    monkeypatch.setattr(webbrowser, "open", lambda url: addresses.append(url) or True)
    return addresses


def complaint(capsys, *arguments) -> str:
    """The one line that a mistake of the user's is answered with."""
    assert main([str(argument) for argument in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    return captured.err.strip()


def index(page: Path):
    text = (page.parent / "data" / "index.js").read_text()
    return json.loads(text.removeprefix("crowdbench.index = ").removesuffix(";\n"))


def test_report_writes_a_page_beside_the_results(place, capsys):
    assert main(["report", "--results", f"{place}/results"]) == 0
    printed = capsys.readouterr().out
    page = place / "results" / "report" / "index.html"
    assert printed == f"{page}: 3 leaderboard lines from 6 episodes, 4 replays\n"
    assert page.is_file()
    cells = {cell["agent"]: cell for cell in index(page)["cells"]}
    assert [len(cells[name]["replays"]) for name in sorted(cells)] == [0, 2, 2]


def test_report_shows_the_tables_of_which_a_cell_has_been_run(
    many, episodes, tmp_path, monkeypatch
):
    drawn = []
    monkeypatch.setattr(
        figures, "save_figures", lambda drawings, *_: drawn.append(drawings) or defaultdict(bool)
    )
    for store, name in ((many, "many"), (episodes, "few")):
        if store is episodes:
            store.add("orca", "corridor_dense", success=[1])
        output = tmp_path / name
        assert main(["report", "--results", str(store.folder), "-o", str(output)]) == 0
    tables = index(tmp_path / "many" / "index.html")["tables"]
    numbers = ("I", "II", "III", "IV", "V", "VI", "VII")
    assert [table["title"].split(":")[0] for table in tables] == [f"Table {n}" for n in numbers]
    assert all("<table>" in table["html"] and "style=" not in table["html"] for table in tables)
    assert index(tmp_path / "few" / "index.html")["tables"] == []
    assert len(drawn) == 2


def test_report_of_nothing_says_how_to_begin(tmp_path, capsys):
    text = complaint(capsys, "report", "--results", tmp_path)
    assert text == f"{tmp_path}: no episodes are stored here; crowdbench run stores some"


def test_replay_opens_the_episode_beside_the_other_agents(place, opened, capsys, tmp_path):
    label = load_results(f"{place}/results")["scenario"][0]
    arguments = ["--results", f"{place}/results", "--output", f"{tmp_path}/page"]
    for scenario in (label, f"{place}/tiny.yaml"):
        assert main(["replay", f"{scenario}:orca:margin=0.1:900001", *arguments]) == 0
        assert capsys.readouterr().out == f"{opened[-1]}\n"
        page, _, link = opened[-1].partition("#")
        assert page == (tmp_path / "page" / "index.html").as_uri()
        assert "agent=orca:margin=0.1" in unquote_plus(link) and "seed=900001" in link
        document = index(tmp_path / "page" / "index.html")
        assert [cell["agent"] for cell in document["cells"]] == ["orca:margin=0.1", "straight_line"]
        seeds = {replay["seed"] for cell in document["cells"] for replay in cell["replays"]}
        assert seeds == {900001}
        assert document["start"] == f"#{link}"


def test_without_a_browser_the_address_is_all_there_is(place, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(webbrowser, "open", lambda url: False)
    arguments = ["--results", f"{place}/results", "--output", str(tmp_path / "page")]
    assert main(["replay", f"{place}/tiny.yaml:straight_line:900000", *arguments]) == 0
    hint, address = capsys.readouterr().out.splitlines()
    assert hint == "No browser could be opened; open this in one:"
    assert address.startswith((tmp_path / "page" / "index.html").as_uri())


@pytest.mark.parametrize("agent", ["straight_line", "orca"])
def test_an_episode_that_is_not_stored_comes_with_the_command_that_runs_it(
    place, opened, capsys, agent
):
    scenario, seed = f"{place}/tiny.yaml", 900777
    arguments = ["replay", f"{scenario}:{agent}:{seed}", "--results", f"{place}/results"]
    text = complaint(capsys, *arguments)
    assert f"no commands of {agent!r}" in text and f"with seed {seed} are stored" in text
    command = text.partition("crowdbench run ")[2]
    assert command == (
        f"--scenario {scenario} --agent {agent} --seed {seed} --episodes 1 "
        f"--results {place}/results"
    )
    assert main(["run", *command.split(), "-j", "1"]) == 0
    capsys.readouterr()
    assert main(arguments) == 0
    assert opened


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("multimodal_fast", "expected SCENARIO:AGENT:SEED"),
        ("multimodal_fast:orca", "expected SCENARIO:AGENT:SEED"),
        ("multimodal_fast:orca:last", "expected SCENARIO:AGENT:SEED"),
        ("multimodal_fast::3", "expected SCENARIO:AGENT:SEED"),
        ("x" * 5000, "expected SCENARIO:AGENT:SEED"),
        ("missing.yaml:orca:3", "scenario file 'missing.yaml' does not exist"),
    ],
)
def test_what_names_no_episode_is_refused(text, told, capsys, opened):
    assert told in complaint(capsys, "replay", text)
    assert opened == []


@pytest.fixture
def driven(monkeypatch):
    """A person who drives as the straight line does."""

    def drive(scenario, seed):
        return run_episode(scenario, "straight_line", seed, label="human")[0]

    monkeypatch.setattr(human, "drive", drive)


@pytest.mark.usefixtures("driven")
def test_play_stores_the_drive_and_says_how_to_see_it(place, tmp_path, capsys, opened):
    results = tmp_path / "results"
    for seed in (0, 1):
        assert main(["play", f"{place}/tiny.yaml", "--results", str(results)]) == 0
        printed = capsys.readouterr().out
        assert f"seed {seed}: arrow keys" in printed
    rows = load_results(results)
    assert list(rows["agent"]) == ["human", "human"] and list(rows["seed"]) == [0, 1]
    (command,) = re.findall(r"^crowdbench (replay .*) shows it\.$", printed, re.MULTILINE)
    assert main(command.split()) == 0
    assert "agent=human&robot" in opened[0]


@pytest.mark.usefixtures("driven")
def test_play_drives_no_seed_twice(place, tmp_path, capsys):
    arguments = ["play", f"{place}/tiny.yaml", "--seed", "3", "--results", str(tmp_path)]
    assert main(arguments) == 0
    capsys.readouterr()
    assert "with seed 3 already" in complaint(capsys, *arguments)


def test_leaving_stores_nothing(place, tmp_path, capsys, monkeypatch):
    def leave(scenario, seed):
        raise human.QuitError

    monkeypatch.setattr(human, "drive", leave)
    assert main(["play", f"{place}/tiny.yaml", "--results", str(tmp_path)]) == 0
    assert "nothing is stored" in capsys.readouterr().out
    assert load_results(tmp_path).empty


def test_play_needs_a_display_and_one_robot(tmp_path, capsys, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    common = ["play", "multimodal_fast", "--results", tmp_path]
    assert "a window needs a display" in complaint(capsys, *common)
    text = complaint(capsys, *common, "--set", "robots.count=2")
    assert text.endswith("has 2 robots and a person drives one; add --set robots.count=1")
    assert load_results(tmp_path).empty
