"""The benchmark names no agent: one more or less changes nothing in it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import crowdbench
from crowdbench.agent import agent_names

PACKAGE = Path(crowdbench.__file__).parent
DEFAULT = ("cli/common.py", "DEFAULT_AGENT")
NAMED_AFTER = {
    "orca": ("simulation/", "scenario", "extensions.py", "__init__.py"),
    "onnx": ("cli/export_onnx.py",),
}
"""Agents that have their names from a walking model and a file format, and who may name those."""

FILES = sorted(path for path in PACKAGE.rglob("*") if path.suffix in (".py", ".js", ".html"))


def strings(path):
    """Every string in a file, docstrings included; of other languages the whole text."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return [text]
    tree, place = ast.parse(text), path.relative_to(PACKAGE).as_posix()
    default = [
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and (place, getattr(node.targets[0], "id", "")) == DEFAULT
    ]
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in default
    ]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_no_string_names_an_agent(path):
    names = set(agent_names())
    assert len(names) > 5
    place = path.relative_to(PACKAGE).as_posix()
    names -= {name for name, places in NAMED_AFTER.items() if place.startswith(places)}
    word = re.compile(rf"\b({'|'.join(map(re.escape, sorted(names)))})\b", re.IGNORECASE)
    found = [match[0] for text in strings(path) for match in word.finditer(text)]
    assert found == []


def test_the_default_agent_is_installed():
    from crowdbench.cli.common import DEFAULT_AGENT

    assert DEFAULT_AGENT in agent_names()
