"""Pages that come from the code: the command line, the scenarios' fields, and their pictures."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer
from PIL import Image
from typer.cli import get_docs_for_click

import crowdbench
from crowdbench.cli import app

SEED, SECONDS = 0, 3.0
"""Of the pictured episodes, and when the picture is taken [s]."""
SCALE = 0.7
"""Of a picture on the page, which leaves it sharp on dense screens."""


def write(folder: Path) -> None:
    """Write all of it into a folder, from where the committed pages include it."""
    folder.mkdir(exist_ok=True)
    command = typer.main.get_command(app)
    context = typer.Context(command, info_name="crowdbench")
    text = get_docs_for_click(obj=command, ctx=context, name="crowdbench")
    (folder / "command_line.md").write_text(text)
    (folder / "scenario_fields.md").write_text("\n".join(_fields()))
    (folder / "gallery.md").write_text("\n".join(_gallery(folder)))


def _fields() -> Iterator[str]:
    """A table per section of a scenario, and per section within one."""
    schema = crowdbench.Scenario.model_json_schema()
    yield from _tables("", schema, schema["$defs"])


def _tables(name: str, section: dict[str, Any], known: dict[str, Any]) -> Iterator[str]:
    within = {key: _section_of(field) for key, field in section["properties"].items()}
    own = {key: field for key, field in section["properties"].items() if not within[key]}
    about = section.get("description", "") if name else ""
    yield from _table(f"`{name}`" if name else "At the top", about, own)
    for key, title in within.items():
        if title:
            yield from _tables(f"{name}.{key}" if name else key, known[title], known)


def _section_of(field: dict[str, Any]) -> str:
    """The name of the schema of a section, or of a list of such; empty for anything else."""
    reference = field.get("$ref") or field.get("items", {}).get("$ref", "")
    return str(reference.rpartition("/")[2])


def _table(heading: str, about: str, fields: dict[str, Any]) -> Iterator[str]:
    yield f"## {heading}\n"
    yield about + "\n"
    yield "| field | default | allowed | meaning |"
    yield "|---|---|---|---|"
    for key, field in fields.items():
        default = f"`{_text(field['default'])}`" if field.get("default", "") != "" else ""
        meaning = field.get("description", "").replace("|", r"\|")
        yield f"| `{key}` | {default} | {_allowed(field)} | {meaning} |"
    yield ""


def _allowed(field: dict[str, Any]) -> str:
    if "enum" in field:
        return ", ".join(f"`{word}`" for word in field["enum"])
    if options := field.get("anyOf") or field.get("oneOf"):
        return " or ".join(map(_allowed, options))
    if "prefixItems" in field:
        count = {2: "two", 3: "three", 4: "four"}[len(field["prefixItems"])]
        return f"{count} numbers, {_allowed(field['prefixItems'][0])}".removesuffix(", any number")
    if "minimum" in field and "maximum" in field:
        return f"{field['minimum']:g} to {field['maximum']:g}"
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "maximum": "≤"}
    limits = [f"{sign} {field[key]:g}" for key, sign in signs.items() if key in field]
    kinds = {"null": "`null`", "string": "text", "number": "any number"}
    kinds |= {"array": "a list", "object": "a section"}
    return ", ".join(limits) or kinds[field["type"]]


def _text(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    return "null" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _gallery(folder: Path) -> Iterator[str]:
    """A heading, the description and a picture of every scenario."""
    for name in crowdbench.scenario_names():
        picture = _picture(name)
        picture.save(folder / f"{name}.png", optimize=True)
        width = round(SCALE * picture.width)
        yield f"## {name}\n"
        yield f"{crowdbench.load_scenario(name).description}.\n"
        yield f"![{name}, {SECONDS:g} s after its start]({name}.png){{width={width}px}}\n"


def _picture(name: str) -> Image.Image:
    """What a scenario looks like a few seconds in, with ``orca`` driving."""
    env = crowdbench.parallel_env(name, render_mode="rgb_array")
    agent = crowdbench.AgentSpec.parse("orca").make()
    observations, _ = env.reset(seed=SEED)
    agent.reset(env.robot_spec(), seed=SEED)
    while env.agents and env.state()["time"] < SECONDS:
        env.render()  # trails are made of what was drawn before
        seen = crowdbench.Observation(**observations["robot_0"])
        observations, *_ = env.step({"robot_0": agent.act(seen)})
    return Image.fromarray(env.render())
