"""The code of a page, written where a test can run it, as if its package were installed."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def unpack(page: str, folder: Path) -> Iterator[tuple[str, str]]:
    """Save code that begins with a file's name under it; yields all other code with its language.

    Of a ``pyproject.toml``, what an installation notes of entry points is written as well.
    """
    for language, code in FENCE.findall((ROOT / page).read_text()):
        name = re.match(r"# (\w+\.(?:py|yaml|toml))\n", code)
        if not name:
            yield language, code
            continue
        (folder / name[1]).write_text(code)
        if name[1] == "pyproject.toml":
            _note_entry_points(tomllib.loads(code)["project"], folder)


def _note_entry_points(project: dict, folder: Path) -> None:
    info = folder / f"{project['name']}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    lines = []
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
