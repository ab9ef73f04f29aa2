"""Model cards: what an agent says of itself, found without running any of its code."""

from __future__ import annotations

import ast
import importlib.util
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from markdown_it import MarkdownIt

from crowdbench.agent import ENTRY_POINT_GROUP, AgentError, AgentSpec
from crowdbench.evaluation.human import HUMAN

INIT = "__init__.py"
_LONGEST = 200_000
"""Characters of a card that are shown."""


def agent_card(agent: str) -> dict[str, str]:
    """What a page says of an agent.

    Args:
        agent: with its options, as stored.

    Returns:
        ``summary``, the first line of the class's docstring, and ``card``, the README.md of the
        agent's package as HTML; either is empty where there is none.
    """
    if agent == HUMAN:
        return {"summary": "A person at the keyboard (crowdbench play).", "card": ""}
    point = _entry_point(agent)
    module = None if point is None else _module_file(point.module)
    if point is None or module is None:
        return {"summary": "", "card": ""}
    text = "" if _shares_folder(point) else _read(module.parent / "README.md")
    card = html_from_markdown(text[:_LONGEST])
    return {"summary": _summary(module, point.attr), "card": card}


def html_from_markdown(text: str) -> str:
    """Markdown as HTML without markup of its author's, scripts in links or anything to load.

    HTML in the text is shown as text; pictures are replaced by what they are said to show.
    """
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    parser.add_render_rule("image", _without_picture)
    tokens = parser.parse(text)
    for token in tokens:
        # Alignment as a class: the page allows no styles that are written into elements.
        if token.attrs.pop("style", None) == "text-align:right":
            token.attrs["class"] = "number"
    return str(parser.renderer.render(tokens, parser.options, {}))


def _without_picture(renderer, tokens, index, options, env) -> str:  # type: ignore[no-untyped-def]
    return str(renderer.renderInlineAsText(tokens[index].children or [], options, env))


def _entry_point(agent: str) -> EntryPoint | None:
    """Where an installed agent is; a file of one's own may have changed since it was run."""
    try:
        name = AgentSpec.parse(agent).name
    except AgentError:
        return None
    points = entry_points(group=ENTRY_POINT_GROUP)
    return next((point for point in points if point.name == name), None)


def _shares_folder(point: EntryPoint) -> bool:
    """Whether other agents' modules lie beside this one: a README.md there is nobody's card."""
    package = point.module.rpartition(".")[0]
    neighbours = {
        other.module
        for other in entry_points(group=ENTRY_POINT_GROUP)
        if other.module.rpartition(".")[0] == package
    }
    return bool(package) and len(neighbours) > 1


def _module_file(module: str) -> Path | None:
    """Where a module is, without importing it or what contains it."""
    package, *rest = module.split(".")
    try:
        found = importlib.util.find_spec(package)
    except (ImportError, ValueError):
        return None
    if found is None:
        return None
    if not rest:
        return Path(found.origin) if found.origin else None
    for folder in map(Path, found.submodule_search_locations or []):
        for path in (folder.joinpath(*rest[:-1], f"{rest[-1]}.py"), folder.joinpath(*rest, INIT)):
            if path.is_file():
                return path
    return None


def _summary(module: Path, class_name: str) -> str:
    try:
        tree = ast.parse(_read(module))
    except SyntaxError:
        return ""
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and node.name == class_name:
            return (ast.get_docstring(node) or "").partition("\n")[0]
    return ""


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
