"""The commands know the published record: nothing has to be run to compare with it."""

import json
import shutil
import webbrowser

import pytest
from crowdbench_studies.paper import STUDY as PAPER
from PIL import Image
from stored_episodes import Episodes

from crowdbench.cli import main
from crowdbench.evaluation import rollout
from crowdbench.evaluation.joined import cells_of
from crowdbench.evaluation.publish import publish as publish_plan
from crowdbench.evaluation.record import write_cell
from crowdbench.evaluation.results import load_results
from crowdbench.site.website import Site
from crowdbench.study.sessions import Account

SCENARIO = "unimodal_slow"


@pytest.fixture
def publish(record, tmp_path):
    """Publish episodes of an agent, with values of metrics for each seed."""

    def publish(agent, scenario=SCENARIO, digest=None, **values):
        made = Episodes(tmp_path / f"made-{scenario}-{agent}")
        facts = {"machine": "their machine"} | ({"scenario_digest": digest} if digest else {})
        made.add(agent, scenario, fixed=facts, **values)
        rows = load_results(made.folder)
        write_cell(record, cells_of(rows)[scenario, agent], rows, {})

    return publish


@pytest.fixture
def local(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return Episodes(tmp_path / "mine")


def said(capsys):
    return " ".join(capsys.readouterr().out.split())


def test_a_planner_is_compared_with_one_that_was_never_run_here(publish, local, capsys):
    publish("neupan", spl=[0.1, 0.2, 0.3, 0.4])
    local.add("my_planner.py:Mine", SCENARIO, spl=[0.3, 0.3, 0.6])
    arguments = ["my_planner.py:Mine", "neupan", "--results", "mine", "--metric", "spl"]
    assert main(["compare", *arguments]) == 0
    text = said(capsys)
    assert "0.400 0.200" in text  # means over the three shared seeds
    assert "published: all rows of neupan, run on their machine" in text
    assert "rows of my_planner.py:Mine" not in text


def test_compare_takes_what_was_run_here_before_what_is_published(publish, local, capsys):
    publish("orca", spl=[0.1, 0.1])
    publish("neupan", spl=[0.5, 0.5])
    local.add("orca", SCENARIO, spl=[0.9])
    assert main(["compare", "orca", "neupan", "--results", "mine", "--metric", "spl"]) == 0
    text = said(capsys)
    assert "0.500 0.500 0.000 " in text  # (0.9 + 0.1) / 2 against 0.5
    assert "published: 1 of 2 rows of orca, run on their machine" in text


def test_compare_says_that_the_record_is_of_another_scenario(publish, local, capsys):
    publish("neupan", digest="0123456789ab", spl=[0.5])
    local.add("orca", SCENARIO, spl=[0.9])
    assert main(["compare", "orca", "neupan", "--results", "mine"]) == 2
    assert "neupan' is of a scenario that is defined otherwise by now" in capsys.readouterr().err
    publish("neupan", "unimodal_fast", spl=[0.5])
    assert main(["compare", "neupan", "orca", "--results", "mine", "-s", SCENARIO]) == 2
    assert (
        f"{SCENARIO!r} is of a scenario that is defined otherwise by now" in capsys.readouterr().err
    )


def test_run_shows_the_published_figures_beside_its_own(publish, local, capsys):
    publish("straight_line", success=[0.0, 1.0, 1.0, 1.0], spl=[0.0, 0.75, 0.75, 0.7])
    options = ["-s", SCENARIO, "-a", "straight_line", "-n", "2", "-j", "1", "--results", "new"]
    assert main(["run", *options]) == 0
    text = said(capsys)
    assert "straight_line published" in text
    assert "0.750 [0.301, 0.954]" in text
    assert "episodes 2 4" in text
    assert "published: all rows of straight_line, run on their machine" in text
    assert main(["run", *options, "--set", "pedestrians.count=1"]) == 0
    assert "published" not in said(capsys)


def page(folder):
    text = (folder / "data" / "index.js").read_text()
    return json.loads(text.removeprefix("crowdbench.index = ").removesuffix(";\n"))


@pytest.fixture
def driven(whole, record, local, monkeypatch):
    """A published episode whose commands are known, and no results of one's own."""
    run = whole.run(SCENARIO, "straight_line", 3)
    publish_plan([(SCENARIO, "straight_line", 100)], whole.folder, record)
    monkeypatch.setattr(webbrowser, "open", lambda url: True)
    return run


def test_a_published_episode_is_replayed_without_running_it(driven, tmp_path, capsys):
    assert main(["replay", f"{SCENARIO}:straight_line:3", "-o", "page"]) == 0
    assert "this is its published episode" in said(capsys)
    (cell,) = page(tmp_path / "page")["cells"]
    assert [(one["seed"], one["outcome"]) for one in cell["replays"]] == [(3, driven.outcome)]


def test_a_published_episode_is_recorded_without_running_it(driven, tmp_path, capsys, monkeypatch):
    def run_nobody(*_, **__):
        raise AssertionError

    monkeypatch.setattr(rollout.AgentSpec, "make", run_nobody)
    assert main(["record", SCENARIO, "-a", "straight_line", "--seed", "3", "-o", "a.gif"]) == 0
    assert "(no agent was run: published)" in said(capsys)
    assert Image.open(tmp_path / "a.gif").n_frames == driven.steps + 1


AGENT = """
import crowdbench

class A(crowdbench.Agent):
    def reset(self, robot, seed):
        pass

    def act(self, observation):
        return {}, 0.0
"""


def test_an_agent_whose_file_has_changed_is_recorded_anew(local, tmp_path, capsys):
    (tmp_path / "mine.py").write_text(AGENT.format(0.5))
    options = ["--set", "time_limit=1", "--results", "new"]
    assert main(["run", "-s", SCENARIO, "-a", "mine.py:A", "-n", "1", "-j", "1", *options]) == 0
    command = ["record", SCENARIO, "-a", "mine.py:A", "-o", "a.gif", *options]
    assert main(command) == 0
    assert "no agent was run" in said(capsys)
    (tmp_path / "mine.py").write_text(AGENT.format(0.1))
    assert main(command) == 0
    assert "no agent was run" not in said(capsys)


def test_the_report_shows_published_episodes_beside_ones_own(driven, local, tmp_path, capsys):
    local.folder = tmp_path / "crowdbench-results"
    local.add("mine.py:A", SCENARIO, spl=[0.5])
    assert main(["report", "-o", "both"]) == 0
    cells = {cell["agent"]: cell for cell in page(tmp_path / "both")["cells"]}
    assert set(cells) == {"mine.py:A", "straight_line"}
    assert [one["seed"] for one in cells["straight_line"]["replays"]] == [3]
    assert main(["report", "--results", "crowdbench-results", "-o", "own"]) == 0
    assert {cell["agent"] for cell in page(tmp_path / "own")["cells"]} == {"mine.py:A"}


STUDY = """
from crowdbench.study import Block, Method, Quantity, Study, Table

methods = Method("orca", episodes=2), Method("straight_line", episodes=2)
STUDY = Study(
    "mine",
    "Mine",
    (Table("1", "Two", (Block(("unimodal_slow",)),), (Quantity("spl"),), methods),),
)
"""


def test_tables_are_made_from_the_record_and_ones_own_rows(publish, local, tmp_path, capsys):
    (tmp_path / "mine.py").write_text(STUDY)
    local.folder = tmp_path / "crowdbench-results"
    publish("orca", spl=[0.25, 0.25])
    local.add("orca", SCENARIO, spl=[0.75, 0.75])
    local.add("straight_line", SCENARIO, spl=[0.5, 0.5])
    assert main(["tables", "mine.py"]) == 0
    assert "4 of 4 planned episodes" in said(capsys)
    path = tmp_path / "crowdbench-results" / "studies" / "mine" / "tables" / "table_1.csv"
    assert "0.25" in path.read_text() and "0.75" not in path.read_text()
    assert main(["tables", "mine.py", "--results", "crowdbench-results"]) == 0
    assert "0.75" in path.read_text() and "0.25" not in path.read_text()


def test_a_page_counts_the_runs_of_published_and_of_ones_own_rows(publish, local, tmp_path):
    def run(folder, episodes):
        folder.mkdir(exist_ok=True)
        account = Account(folder, "hard", clock=lambda: 0.0)
        for _ in range(episodes):
            account.count("a machine", 2)
        account.write()

    publish("orca", "hard_station", success=[1, 1])
    run(tmp_path / "results", 2)
    local.folder = tmp_path / "crowdbench-results"
    local.add("orca", "situation_queue", success=[1])
    run(local.folder, 1)
    page = tmp_path / "results" / "studies" / "hard" / "README.md"
    assert main(["tables", "hard"]) == 0
    assert "for 3 episodes" in page.read_text() and "in 2 sessions" in page.read_text()
    # What has been published since still lies beside one's own, and counts once.
    shutil.copytree(
        local.folder / "sessions", tmp_path / "results" / "sessions", dirs_exist_ok=True
    )
    assert main(["tables", "hard"]) == 0
    assert "in 2 sessions" in page.read_text()


def test_a_study_that_comes_along_goes_beside_the_published_ones(publish, local, tmp_path):
    publish("orca", "hard_station", success=[1, 1])
    assert main(["tables", "hard"]) == 0
    folder = tmp_path / "results" / "studies" / "hard"
    assert "2 of 19,200 planned episodes" in (folder / "README.md").read_text()
    local.add("orca", "hard_station", success=[1])
    assert main(["tables", "hard", "--results", "mine"]) == 0
    assert (tmp_path / "mine" / "studies" / "hard" / "README.md").is_file()
    assert not (tmp_path / "crowdbench-results").exists()


@pytest.mark.parametrize(
    "command",
    [
        ["publish", "hard", "--record", "kept"],
        ["tables", "hard"],
        ["compare", "orca", "neupan"],
        ["export"],
        ["report"],
    ],
    ids=lambda command: command[0],
)
@pytest.mark.parametrize("asked", ["nowhere", "README.md"])
def test_results_that_are_asked_for_have_to_be_there(
    publish, local, tmp_path, capsys, command, asked
):
    """Published rows do not stand in for them, and nothing is made."""
    for agent in ("orca", "neupan"):
        publish(agent, spl=[0.5])
    (tmp_path / "README.md").write_text("no results")
    before = sorted(tmp_path.rglob("*"))
    assert main([*command, "--results", asked]) == 2
    printed, told = capsys.readouterr()
    assert (printed, told) == (
        "", f"{asked}: no episodes are stored here; crowdbench run stores some\n"
    )  # fmt: skip
    assert sorted(tmp_path.rglob("*")) == before


def test_the_default_results_may_be_missing_where_published_ones_do(publish, local, tmp_path):
    for agent in ("orca", "neupan"):
        publish(agent, spl=[0.5])
    assert main(["compare", "orca", "neupan"]) == 0
    assert main(["publish", "hard", "--record", "kept"]) == 2
    assert not (tmp_path / "crowdbench-results").exists()


def test_publish_says_what_it_has_changed(local, tmp_path, capsys):
    (tmp_path / "mine.py").write_text(STUDY)
    command = ["publish", "mine.py", "--record", "kept", "--results"]
    local.add("orca", SCENARIO, spl=[0.5, 0.5, 0.5])
    assert main([*command, "mine"]) == 0
    text = said(capsys)
    assert "orca in unimodal_slow: 2 added" in text
    assert "kept: 2 episodes added, 0 replaced" in text
    later = Episodes(tmp_path / "later")
    later.add("orca", SCENARIO, spl=[0.25], fixed={"outcome": "timeout", "timestamp": "later"})
    assert main([*command, "later"]) == 0
    told = "1 replaced (1 outcomes changed); largest relative differences: spl 0.5"
    assert told in said(capsys)
    other = Episodes(tmp_path / "other")
    other.add("orca", SCENARIO, spl=[0.25], fixed={"weights_sha256": "ff"})
    assert main([*command, "other"]) == 1
    assert "not published: orca in unimodal_slow: other weights, code" in said(capsys)
    of_others = Episodes(tmp_path / "others")
    of_others.add("orca", "corridor_dense", spl=[0.25])
    assert main([*command, "others"]) == 2
    assert "others: no episode is stored here that study 'mine.py' asks for" in " ".join(
        capsys.readouterr().err.split()
    )


def test_publish_works_in_a_checkout_only(local, tmp_path, record, capsys):
    (tmp_path / "mine.py").write_text(STUDY)
    local.add("orca", SCENARIO, spl=[0.5])
    assert main(["publish", "mine.py", "--results", "mine"]) == 2
    assert "publish in a checkout of crowdbench" in capsys.readouterr().err
    assert main(["publish", "mine.py", "--results", "mine", "--record", str(record)]) == 2
    assert "installed with crowdbench is read-only" in capsys.readouterr().err
    assert not record.exists()


def test_the_report_misses_the_published_seeds_that_the_study_plans(publish, local, monkeypatch):
    seen = {}

    def written(rows, output, tables, figures, planned):
        seen.update(planned=planned)
        return Site(output, 0, 0, 0)

    monkeypatch.setattr("crowdbench.cli.report._of_study", lambda *given: ([], []))
    monkeypatch.setattr("crowdbench.site.website.write_report_page", written)
    publish("orca", spl=[0.5])
    assert main(["report"]) == 0
    assert seen["planned"] == {(c.scenario, c.agent): c.episodes for c in PAPER.cells()}
    local.add("orca", SCENARIO, spl=[0.9])
    assert main(["report", "--results", "mine"]) == 0
    assert seen["planned"] == {}, "in a folder of one's own nothing is planned"
