from __future__ import annotations

import importlib.metadata
import importlib.util
import sys

import pytest

from crowdbench.site import cards
from crowdbench.site.cards import agent_card, html_from_markdown


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Install agents: files of a package and its entry points, module by name."""

    def install(files, agents):
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        points = [
            importlib.metadata.EntryPoint(name, place, cards.ENTRY_POINT_GROUP)
            for name, place in agents.items()
        ]
        monkeypatch.setattr(cards, "entry_points", lambda group: points)

    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    return install


EXPLODES = 'raise SystemExit("no code of an agent is run")\n'
CLASS = EXPLODES + 'class Mine:\n    """Plans far ahead.\n\n    More.\n    """\n'


def test_the_card_is_the_readme_beside_the_agent_and_no_code_is_run(install):
    install(
        {"pkg_a/mine/agent.py": CLASS, "pkg_a/mine/README.md": "# Mine\n\nIt *plans*."},
        {"mine": "pkg_a.mine.agent:Mine", "other": "pkg_a.other:Other"},
    )
    card = agent_card("mine:horizon=3")
    assert card["summary"] == "Plans far ahead."
    assert card["card"] == "<h1>Mine</h1>\n<p>It <em>plans</em>.</p>\n"
    assert "pkg_a" not in sys.modules


def test_a_readme_that_several_agents_share_is_nobodys_card(install):
    install(
        {"pkg_b/one.py": CLASS, "pkg_b/README.md": "# Both"},
        {"one": "pkg_b.one:Mine", "two": "pkg_b.two:Mine"},
    )
    assert agent_card("one") == {"summary": "Plans far ahead.", "card": ""}


def test_a_package_of_one_agent_has_its_readme_inside(install):
    install({"pkg_c/__init__.py": CLASS, "pkg_c/README.md": "Hello"}, {"lone": "pkg_c:Mine"})
    assert agent_card("lone")["card"] == "<p>Hello</p>\n"


@pytest.mark.parametrize(
    "agent", ["not_installed", "planner.py:Mine", "x:option", "\u2028", "gone", "broken"]
)
def test_an_agent_of_which_nothing_is_known_has_no_card(install, agent):
    install(
        {"pkg_d/broken.py": "class ("}, {"gone": "no.such.place:Mine", "broken": "pkg_d.broken:X"}
    )
    assert agent_card(agent) == {"summary": "", "card": ""}


def test_the_built_in_agents_say_what_they_are():
    assert agent_card("straight_line")["summary"].startswith("Turns towards the goal")
    assert "keyboard" in agent_card("human")["summary"]


@pytest.mark.parametrize(
    "text",
    [
        "<script>alert(1)</script>",
        "<img src=x onerror=alert(1)>",
        "[x](javascript:alert(1))",
        "[x](data:text/html;base64,PHNjcmlwdD4=)",
        "![x](http://example.org/x.png)",
        '[x](http://example.org "\\"><img src=x>")',
        "| a |\n|--:|\n| <b onclick=x> |",
    ],
)
def test_markdown_brings_no_markup_scripts_or_anything_to_load(text):
    from xml.etree import ElementTree

    tree = ElementTree.fromstring(f"<div>{html_from_markdown(text)}</div>")
    for element in tree.iter():
        assert element.tag in ("div", "p", "a", "table", "thead", "tbody", "tr", "th", "td")
        assert set(element.attrib) <= {"href", "title", "class"}
        assert element.get("href", "http:").startswith("http:")
