"""A study of one's own: one file outside the package, from nothing to tables, verdicts and page."""

from __future__ import annotations

import csv
import re

import pytest

from crowdbench.cli import main
from crowdbench.evaluation.results import load_results
from crowdbench.registry import Registry
from crowdbench.study import Block, Method, Quantity, Study, StudyError, Table, library
from crowdbench.study.library import STUDIES, load_study

PLANNER = """
import crowdbench


class Timid(crowdbench.Agent):
    def reset(self, robot, seed):
        pass

    def act(self, observation):
        return 0.0, 0.0
"""
SCENARIO = """
extends: unimodal_slow
time_limit: 3
pedestrians: {count: 1}
"""
STUDY = """
from crowdbench.study import Block, Claim, Method, Quantity, Study, Table

METHODS = (Method("planner.py:Timid", episodes=2), Method("straight_line", "Blind", 2))
TABLE = Table(
    "1",
    "Who gets ahead",
    (Block(("short.yaml",)),),
    (Quantity("path_length"), Quantity("success", "Success")),
    METHODS,
)
STUDY = Study(
    name="ahead",
    title="Getting ahead",
    tables=(TABLE,),
    claims=(
        Claim("Blind goes further", "1", "straight_line", "planner.py:Timid", ("short.yaml",),
              "path_length"),
    ),
)
"""


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with a planner, a scenario and a study, where the command is called."""
    for name, text in (
        ("planner.py", PLANNER), ("short.yaml", SCENARIO), ("my_study.py", STUDY),
    ):  # fmt: skip
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def complaint(capsys, *arguments):
    """The one line that a mistake is answered with; nothing was run."""
    assert main(["tables", *arguments]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    assert load_results("crowdbench-results").empty
    return text.strip()


def test_a_file_is_enough(place, capsys, monkeypatch):
    monkeypatch.setattr("crowdbench.evaluation.runner.was_run", lambda name: False)
    assert main(["tables", "my_study.py", "--run", "--jobs", "1"]) == 0
    printed, told = capsys.readouterr()
    assert told.startswith("compiling for crowdbench, straight_line (once per machine) ...\n")
    assert "Table 1: Who gets ahead" in printed
    assert "4 of 4 planned episodes" in printed
    folder = place / "crowdbench-results" / "studies" / "ahead"
    assert {path.name for path in folder.iterdir()} == {"README.md", "tables"}  # no figures
    names = {path.name for path in (folder / "tables").iterdir()}
    assert names == {"table_1.csv", "table_1.md", "table_1.tex", "claims.csv"}
    rows = list(csv.DictReader((folder / "tables" / "table_1.csv").open()))
    assert [row["method"] for row in rows] == [*["planner.py:Timid"] * 2, *["Blind"] * 2]
    lengths = {row["method"]: float(row["value"]) for row in rows if row["metric"] != "success"}
    assert lengths["planner.py:Timid"] == 0 < lengths["Blind"]
    (claim,) = csv.DictReader((folder / "tables" / "claims.csv").open())
    assert (claim["pairs"], claim["verdict"]) == ("2", "undecided")
    page = (folder / "README.md").read_text()
    assert page.startswith("# Getting ahead\n")
    assert "| 1 |  |  | Blind goes further |" in page
    assert "| planner.py:Timid |" in page
    assert r"Value \[95 % interval\]." in page
    assert "paper" not in page and "reference" not in page and "Where we differ" not in page
    assert "(0." not in page and "(1." not in page, "no brackets without reference values"
    assert "| Method | path length [m] ↓ | Success ↑ |" in page
    for name in re.findall(r"\]\(([^)]+)\)", page):
        assert (folder / name).is_file(), name
    rows = load_results(place / "crowdbench-results")
    assert main(["tables", "my_study.py", "--run", "--jobs", "1"]) == 0
    assert load_results(place / "crowdbench-results").equals(rows), "nothing was left to run"


def test_reference_values_of_one_s_own_are_shown_and_judged(place, capsys):
    study = STUDY.replace(
        "    METHODS,\n", '    METHODS,\n    reference={("", "Blind", "success"): 0.25},\n', 1
    )
    study = study.replace('name="ahead",', 'name="ahead",\n    source="the thesis",')
    (place / "my_study.py").write_text(study)
    assert main(["tables", "my_study.py", "--run", "--jobs", "1"]) == 0
    folder = place / "crowdbench-results" / "studies" / "ahead"
    page = (folder / "README.md").read_text()
    assert "## Where we differ from the thesis" in page
    assert "(the thesis's value)" in page and "(0.250)" in page
    (row,) = csv.DictReader((folder / "tables" / "differences.csv").open())
    assert (row["method"], row["reference"]) == ("Blind", "0.25")
    assert (folder / "tables" / "orders.csv").is_file()
    (place / "my_study.py").write_text(STUDY)
    assert main(["tables", "my_study.py"]) == 0
    assert not (folder / "tables" / "differences.csv").exists(), "not of this study any more"


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("straight_line", "strait_line", "unknown agent 'strait_line'; did you mean 'straight_l"),
        ("planner.py:Timid", "nobody.py:Timid", "agent file 'nobody.py' does not exist"),
        ("planner.py:Timid", "planner.py:Bold", "agent classes found: Timid"),
        ("straight_line", "orca:x", "expected option=value, got 'x'"),
        ("short.yaml", "unimodal_slaw", "'unimodal_slaw'; did you mean 'unimodal_slow'?"),
        ("path_length", "path_lenght", "metric 'path_lenght'; did you mean 'path_length'?"),
        ('further", "1"', 'further", "2"', "claim 'Blind goes further': no table '2'; known: 1"),
        (
            '("short.yaml",),\n',
            '("unimodal_fast",),\n',
            "no table has agent 'straight_line' in scenario",
        ),
        ("episodes=2", "episodes=0", "agent 'planner.py:Timid': episodes is 0, expected 1 or more"),
        ('"Blind", 2', '"planner.py:Timid", 2', "two methods have the label 'planner.py:Timid'"),
        ('"ahead"', '"../ahead"', "name '../ahead': expected letters, digits, - and _"),
        ('title="', 'shown=("2",),\n    title="', "shown '2': no such table or figure; known: 1"),
        (
            '(Block(("short.yaml",)),)',
            '(Block("short.yaml"),)',
            "table '1', scenarios of a block: expected a tuple of str, got 'short.yaml'",
        ),
        ("tables=(TABLE,)", "tables=(TABLE)", "tables: expected a tuple of Table, got Table("),
        (
            '(Quantity("path_length"), Quantity("success", "Success"))',
            '("success",)',
            "table '1', quantities: expected a tuple of Quantity, got ('success',)",
        ),
        (
            "    METHODS,\n)",
            "    METHODS,\n    reference={('', 'Blimd', 'success'): 1.0},\n)",
            "table '1', reference ('', 'Blimd', 'success'): no such cell",
        ),
        ("STUDY = ", "SECOND = Study('b', 'B', ())\nSTUDY = ", "expected one Study, found SECOND,"),
        ("STUDY = Study(", "dict(", "expected one Study, found none"),
        ("METHODS = (", "METHODS = 1 / 0 + (", "ZeroDivisionError"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_file_before_anything_runs(
    place, capsys, before, after, message
):
    assert before in STUDY
    (place / "my_study.py").write_text(STUDY.replace(before, after))
    text = complaint(capsys, "my_study.py", "--run")
    assert "my_study.py" in text and message in text


def test_what_is_no_study_is_said(place, capsys):
    assert "'nothing.py' does not exist" in complaint(capsys, "nothing.py")
    text = complaint(capsys, "papers")
    assert "unknown study 'papers'; did you mean 'paper'?" in text


@pytest.mark.parametrize(
    ("option", "value"),
    [("--jobs", "2"), ("--executor", "'slurm'"), ("--address", "'head:6379'")],
)
def test_options_of_a_run_are_refused_where_nothing_is_run(place, capsys, option, value):
    told = complaint(capsys, "my_study.py", option, value.strip("'"))
    assert told == f"{option} {value}: nothing is run; allowed: with --run"
    assert not (place / "crowdbench-results").exists()


def test_installed_studies_are_found_by_name():
    assert "paper" in STUDIES
    assert load_study("paper") is STUDIES["paper"]


def test_a_package_adds_a_study_by_an_entry_point(place, monkeypatch, capsys):
    info = place / "my_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 1.0\n")
    points = "[crowdbench.studies]\nahead = my_study:STUDY\ntable = my_study:TABLE\n"
    (info / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(place)
    fresh = Registry("study", "crowdbench.studies", {}, of=Study)
    monkeypatch.setattr(library, "STUDIES", fresh)
    assert main(["tables", "ahead"]) == 0
    capsys.readouterr()
    assert (place / "crowdbench-results" / "studies" / "ahead" / "README.md").is_file()
    assert "is not a crowdbench.study.model.Study" in complaint(capsys, "table")


def test_agents_are_named_as_their_episodes_are():
    assert Method("orca:margin=0.10,horizon=2").agent == "orca:horizon=2,margin=0.1"


def test_defaults_fill_labels_and_headings():
    assert Method("orca").label == "orca"
    assert Quantity("path_length").heading == "path length [m]"
    assert Quantity("inference_s").heading == "inference [ms]"
    assert Quantity("success").heading == "success"


def test_one_cell_has_one_number_of_episodes():
    blocks, quantities = (Block(("unimodal_slow",)),), (Quantity("success"),)
    tables = tuple(
        Table(number, "t", blocks, quantities, (Method("orca", episodes=count),))
        for number, count in (("1", 10), ("2", 20))
    )
    with pytest.raises(StudyError, match=r"'orca' in scenario 'unimodal_slow' has 10 .* and 20 in"):
        Study("s", "S", tables).cells()
