"""An agent and its files on the way to another machine."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from crowdbench import AgentSpec
from crowdbench.agent import AgentError, code_version
from crowdbench.evaluation.driven import Driven
from crowdbench.evaluation.parcel import Parcel, below, without_root
from crowdbench.evaluation.protocol import Broken, Described, Done, Lost, Refused
from crowdbench.scenario import NoRoomError

PLANNER = """
import pathlib, crowdbench

class Planner(crowdbench.Agent):
    def __init__(self, weights="", name="", gain=1.0):
        self.weights_sha256 = pathlib.Path(weights).read_text()

    def reset(self, robot, seed):
        pass

    def act(self, observation):
        return 0.5, 0.0
"""


@pytest.mark.parametrize("absolute", [False, True])
def test_it_is_made_from_copies_where_the_originals_are_not(tmp_path, monkeypatch, absolute):
    here, root = tmp_path / "here" / "work", tmp_path / "there"
    here.mkdir(parents=True)
    monkeypatch.chdir(here)
    (here / "planner.py").write_text(PLANNER)
    (here.parent / "weights.txt").write_text("abc")
    name = str(here / "planner.py") if absolute else "planner.py"
    weights = str(here.parent / "weights.txt") if absolute else "../weights.txt"
    options = {"weights": weights, "name": "nothing.txt", "gain": 2.0}
    spec = AgentSpec(f"{name}:Planner", options)
    version, parcel = code_version(spec.name), Parcel.of(spec)
    monkeypatch.chdir(tmp_path)
    shutil.rmtree(tmp_path / "here")
    moved = parcel.unpack(root)
    below(root, str(here)).mkdir(parents=True, exist_ok=True)
    monkeypatch.chdir(below(root, str(here)))
    assert absolute or moved == spec, "names stay as they are, in the copy of the folder"
    assert moved.make().weights_sha256 == "abc"
    assert code_version(moved.name) == version
    assert (moved.options["name"], moved.options["gain"]) == ("nothing.txt", 2.0)
    assert {str(path) for path in root.rglob("*") if path.is_file()} == {
        f"{root}{here}/planner.py",
        f"{root}{here.parent}/weights.txt",
    }


def test_an_installed_agent_travels_by_its_name(tmp_path):
    spec = AgentSpec("straight_line", {})
    parcel = Parcel.of(spec)
    assert parcel.files == {}
    assert parcel.unpack(tmp_path) == spec


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(AgentError, match=r"gone\.py: No such file"):
        Parcel.of(AgentSpec(f"{tmp_path}/gone.py:Planner", {}))


def test_answers_name_files_as_they_are_called_where_the_agent_comes_from(tmp_path):
    def text(place):
        return f"KeyError: 1 ({place}/home/planner.py:3)"

    driven = [
        Driven("robot_0", np.empty((0, 2)), np.empty(0), "agent_error", text(tmp_path)),
        Driven("robot_1", np.empty((0, 2)), np.empty(0), "timeout"),
    ]
    done = without_root(Done(driven, (text(tmp_path),)), tmp_path)
    assert [one.error for one in done.driven] == [text(""), None]
    assert done.warned == (text(""),)
    assert without_root(Lost(text(tmp_path), outside=True), tmp_path) == Lost(text(""), True)
    assert without_root(Broken(text(tmp_path)), tmp_path) == Broken(text(""))
    refused = without_root(Refused(AgentError(text(tmp_path))), tmp_path)
    assert (type(refused.error), str(refused.error)) == (AgentError, text(""))
    no_room, described = Refused(NoRoomError("no room", 3)), Described("a", "b", None)
    assert without_root(no_room, tmp_path) is no_room
    assert without_root(described, tmp_path) is described
