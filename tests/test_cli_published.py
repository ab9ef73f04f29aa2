"""The commands know the published record: nothing has to be run to compare with it."""

import pytest
from stored_episodes import Episodes

from crowdbench.cli import main
from crowdbench.evaluation.joined import cells_of
from crowdbench.evaluation.record import write_cell
from crowdbench.evaluation.results import load_results

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
    assert "of scenarios that are defined otherwise by now" in capsys.readouterr().err
    publish("neupan", "unimodal_fast", spl=[0.5])
    assert main(["compare", "neupan", "orca", "--results", "mine", "-s", SCENARIO]) == 2
    assert "of another definition than today's" in capsys.readouterr().err


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
