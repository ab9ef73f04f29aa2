"""Extension points: found by name, built in or from another package."""

import sys
from importlib.metadata import EntryPoint

import pytest

import crowdbench
from crowdbench import ScenarioError
from crowdbench.extensions import DRIVES, WALKING_MODELS
from crowdbench.registry import Registry, UnknownNameError

PACKAGE = """\
[test.numbers]
seven = numbers_of_others:SEVEN
word = numbers_of_others:WORD
broken = numbers_of_others:MISSING
one = numbers_of_others:SEVEN
"""


@pytest.fixture
def registry(tmp_path, monkeypatch):
    """Two numbers of its own and a package beside it."""
    (tmp_path / "numbers_of_others.py").write_text("SEVEN = 7\nWORD = 'seven'\n")
    info = tmp_path / "numbers_of_others-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: numbers-of-others\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(PACKAGE)
    monkeypatch.syspath_prepend(tmp_path)
    return Registry("number", "test.numbers", {"one": 1, "two": 2}, of=int)


def test_built_in_ones_come_first_and_cannot_be_replaced(registry):
    assert list(registry) == ["one", "two", "broken", "seven", "word"]
    assert (registry["one"], registry["seven"]) == (1, 7)
    assert len(registry) == 5


def test_what_is_unknown_or_broken_is_said(registry):
    with pytest.raises(UnknownNameError, match=r"unknown number 'sevn'; did you mean 'seven'\?"):
        registry["sevn"]
    with pytest.raises(UnknownNameError, match=r"number 'broken' .* cannot be loaded: Attribute"):
        registry["broken"]
    with pytest.raises(UnknownNameError, match=r"number 'word': 'seven' is not a builtins.int"):
        registry["word"]


def test_a_built_in_one_named_by_its_place_loads_when_asked_for(registry, tmp_path):
    (tmp_path / "heavy.py").write_text("NUMBER = 8\n")
    lazy = Registry("number", "test.numbers", {"one": "heavy:NUMBER", "two": 2}, of=int)
    assert list(lazy) == ["one", "two", "broken", "seven", "word"]
    assert "one" in lazy
    assert "heavy" not in sys.modules
    assert lazy["one"] == 8
    assert list(lazy)[:2] == ["one", "two"]
    with pytest.raises(ValueError, match="is there already"):
        lazy.register("one", 4)


def test_registering_for_this_process(registry):
    registry.register("three", 3)
    assert registry["three"] == 3
    for name in ("three", "one", "seven"):
        with pytest.raises(ValueError, match="is there already"):
            registry.register(name, 4)


@pytest.mark.parametrize(
    ("classes", "field", "base"),
    [(DRIVES, "robots.drive", "Drive"), (WALKING_MODELS, "pedestrians.model", "WalkingModel")],
)
@pytest.mark.parametrize("place", ["builtins:int", "math:pi"])
def test_a_class_of_another_kind_is_refused_with_the_field(
    monkeypatch, classes, field, base, place
):
    monkeypatch.setitem(classes._builtin, "test", EntryPoint("test", place, "anywhere"))
    told = rf"{field}: .* 'test': .* is not a subclass of crowdbench\.{base}"
    with pytest.raises(ScenarioError, match=told):
        crowdbench.parallel_env("unimodal_slow", **{field: "test"}).reset(seed=0)
    with pytest.raises(ValueError, match="is not a subclass"):
        classes.register("more", int)
