"""A cell that is known and has no rows: all of its episodes went missing, or nothing is left."""

import pytest
from stored_episodes import Episodes

from crowdbench import load_scenario
from crowdbench.cli import main
from crowdbench.evaluation.results import Cell, ResultsStore
from crowdbench.simulation import WORLD_VERSION

SCENARIO = "unimodal_slow"
STUDY = f"""
from crowdbench.study import Block, Claim, Method, Quantity, Study, Table

METHODS = (Method("orca", "Evades", 2), Method("straight_line", "Blind", 2))
TABLE = Table("1", "Who gets ahead", (Block(("{SCENARIO}",)),), (Quantity("spl", "SPL"),), METHODS)
CLAIM = Claim("Orca is better", "1", "orca", "straight_line", ("{SCENARIO}",), "spl")
STUDY = Study(name="mine", title="Mine", tables=(TABLE,), claims=(CLAIM,))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where straight_line's cell in a scenario has no rows."""
    monkeypatch.chdir(tmp_path)
    digest = load_scenario(SCENARIO).digest
    cell = Cell(SCENARIO, digest, "straight_line", "{}", WORLD_VERSION, "", "crowdbench-nav 0.1.0")
    ResultsStore(tmp_path / "mine").append(cell, [])
    return tmp_path / "mine"


def told(capsys, *arguments):
    """The one line that a command is refused with."""
    assert main([*arguments, "--results", "mine"]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    return text.strip()


def test_alone_it_is_as_if_nothing_was_stored(folder, capsys):
    nothing = "mine: no episodes are stored here; crowdbench run stores some"
    assert told(capsys, "report") == nothing
    assert told(capsys, "export") == nothing
    assert told(capsys, "compare", "straight_line", "orca") == nothing
    assert told(capsys, "tables", "hard") == nothing
    assert told(capsys, "publish", "hard", "--record", "kept") == nothing
    assert [path.name for path in folder.iterdir()] == ["results.sqlite"]
    assert "crowdbench run --scenario" in told(capsys, "replay", f"{SCENARIO}:straight_line:0")
    assert main(["recompute", "--results", "mine"]) == 0
    assert "no episode could be simulated again" in capsys.readouterr().out


def test_beside_another_cell_it_is_missing(folder, capsys):
    Episodes(folder).add("orca", SCENARIO, spl=[0.5, 0.75])
    assert told(capsys, "compare", "straight_line", "orca") == (
        "mine: no episodes of agent 'straight_line'; known: orca"
    )
    assert main(["export", "--results", "mine"]) == 0
    assert "straight_line" not in capsys.readouterr().out
    (folder.parent / "my_study.py").write_text(STUDY)
    assert main(["tables", "my_study.py", "--results", "mine"]) == 0
    assert "2 of 4 planned episodes" in capsys.readouterr().out
    page = (folder / "studies" / "mine" / "README.md").read_text()
    assert "| Evades | 0.625" in page
    assert "| Blind | — |" in page
