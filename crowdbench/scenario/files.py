"""Scenarios by name, from a file, and with fields overridden."""

from __future__ import annotations

import math
import warnings
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from crowdbench.messages import nearest, printable, quoted, setting, short
from crowdbench.scenario.changes import change, merge
from crowdbench.scenario.decided import leave_decided
from crowdbench.scenario.errors import ScenarioError
from crowdbench.scenario.model import Scenario, validate
from crowdbench.scenario.recorded import doubts
from crowdbench.strict_yaml import YamlError, load_yaml, read_yaml

_LONGEST_NAME = 200


def scenario_names(tier: str | None = None) -> list[str]:
    """Names of the scenarios that come with crowdbench, tier by tier.

    Args:
        tier: only those of it, e.g. ``paper``, in the order of the paper's tables.
    """
    return [name for name, its in _tiers().items() if tier in (None, its)]


def scenario_tiers() -> list[str]:
    """Kinds of scenarios that come with crowdbench, by how hard they are."""
    return list(dict.fromkeys(_tiers().values()))


@cache
def _tiers() -> dict[str, str]:
    """The tier of each scenario, in their order."""
    found = []
    for path in _folder().iterdir():
        if _is_yaml(path) and not _read(path).get("abstract"):
            document = _resolve(path.name[:-5], base=None, seen=())
            found.append((document["order"], path.name[:-5], document["tier"]))
    return {name: tier for _, name, tier in sorted(found)}


def load_scenario(name: str | Path | Scenario, /, **changes: Any) -> Scenario:
    """Load a scenario by name or from a YAML file, with some fields replaced.

    Warns where a robot may pass its goal between two steps, where recorded people walk through
    walls, and where robots have farther to go than people walk.

    Args:
        name: a built-in scenario, the path of a ``.yaml`` file, or a Scenario.
        changes: nested sections (``pedestrians={"count": 12}``) or dotted keys.

    Raises:
        ScenarioError: unknown name (the nearest are listed), unknown key, value out of range, one
            that a recording or an image decides, or a world in which not everybody fits.
    """
    if isinstance(name, Scenario):
        scenario = name.override(changes) if changes else name
    elif not changes and not _is_path(str(name)):
        scenario = _own(str(name))
    else:
        document = _scenario(str(name))
        change(document, changes)
        leave_decided(document, changes, source=str(name))
        scenario = _complete(document, str(name))
    _warn_of_passed_goals(scenario)
    for problem in doubts(scenario):
        warnings.warn(f"scenario {scenario.name!r}: {problem}", stacklevel=2)
    return scenario


def parse_overrides(items: list[str]) -> dict[str, Any]:
    """Read ``["pedestrians.count=12", ...]`` as given on a command line; values are YAML.

    Raises:
        ScenarioError: an item without ``=`` or whose value is not YAML.
    """
    changes: dict[str, Any] = {}
    for item in items:
        key, separator, text = item.partition("=")
        if not separator or not key.strip():
            raise ScenarioError(
                f"--set {short(item)}: expected key=value, e.g. pedestrians.count=12"
            )
        try:
            changes[key.strip()] = load_yaml(text)
        except YamlError as error:
            raise ScenarioError(f"--set {short(item)}: not a YAML value ({error})") from error
    return changes


@cache
def _own(name: str) -> Scenario:
    """A built-in scenario as it is: parsed once, as rows by the hundred name the same few."""
    return _complete(_scenario(name), name)


def _complete(document: dict[str, Any], name: str) -> Scenario:
    """Make a scenario of its document, or say that it is one of those that others complete."""
    try:
        return validate(document, source=name)
    except ScenarioError as error:
        if _is_path(name) or _is_whole(name):
            raise
        tier = _resolve(name, base=None, seen=())["tier"]
        raise ScenarioError(
            f"{error}; {quoted(name)} alone is no scenario but what those of tier {tier!r} extend; "
            "crowdbench scenarios lists them"
        ) from error


def _is_whole(name: str) -> bool:
    """Whether a built-in document without changes is a scenario."""
    try:
        validate(_scenario(name), source=name)
    except ScenarioError:
        return False
    return True


def _scenario(name: str) -> dict[str, Any]:
    """The document of a scenario, without what says where it stands in lists."""
    document = _resolve(name, base=None, seen=())
    return {key: value for key, value in document.items() if key not in ("order", "tier")}


def _warn_of_passed_goals(scenario: Scenario) -> None:
    robots = scenario.robots
    fastest, bounds = max(map(abs, robots.speed)), "robots.speed"
    if robots.drive == "omnidirectional":
        fastest = math.hypot(fastest, max(map(abs, robots.lateral_speed)))
        bounds += " and robots.lateral_speed"
    step = fastest * scenario.control_period
    if step > 2 * robots.goal_tolerance:
        warnings.warn(
            f"scenario {scenario.name!r}: a robot may pass its goal unseen, as it drives up to "
            f"{step:g} m in a control_period of {scenario.control_period:g} s at {fastest:g} m/s "
            f"({bounds}), more than twice robots.goal_tolerance {robots.goal_tolerance:g} m",
            stacklevel=3,
        )


def _folder() -> Any:
    return resources.files("crowdbench_scenarios")


def _is_path(name: str) -> bool:
    return name.endswith((".yaml", ".yml"))


def _is_yaml(path: Any) -> bool:
    return str(path.name).endswith(".yaml")


def _read(path: Any) -> dict[str, Any]:
    try:
        document = read_yaml(path)
    except YamlError as error:
        raise ScenarioError(str(error)) from error
    if not isinstance(document, dict):
        raise ScenarioError(
            f"{printable(path)}: expected 'key: value' lines, got {type(document).__name__}"
        )
    return document


def _resolve(name: str, base: Path | None, seen: tuple[str, ...]) -> dict[str, Any]:
    """Read a document with everything it extends merged beneath it."""
    is_path = _is_path(name)
    path: Any = (base / name if base else Path(name)) if is_path else _folder() / f"{name}.yaml"
    if not _is_file(path):
        if is_path:
            raise ScenarioError(f"scenario file {quoted(str(path))} does not exist")
        if name in scenario_tiers():
            raise ScenarioError(
                f"{quoted(name)} is a tier, not a scenario; allowed: those that crowdbench "
                "scenarios lists in it"
            )
        raise ScenarioError(f"unknown scenario {quoted(name)}{nearest(name, scenario_names())}")
    place = str(path.resolve() if isinstance(path, Path) else path)
    if place in seen:
        raise ScenarioError(
            f"{printable(path)}: extends itself ({printable(' -> '.join((*seen, place)))})"
        )
    document = _read(path)
    _locate(document, Path(str(path)).parent)
    parent = document.pop("extends", None)
    document.pop("abstract", None)
    document.setdefault("name", Path(name).stem)
    document.setdefault("description", "")  # that of what it extends tells of another world
    if parent is None:
        leave_decided(document, document, source=name)
        return document
    if not isinstance(parent, str):
        raise ScenarioError(
            f"{printable(path)}: extends: expected the name of a scenario, got {setting(parent)}"
        )
    beneath = _resolve(parent, base=path.parent if is_path else None, seen=(*seen, place))
    merged = merge(beneath, document)
    leave_decided(merged, document, source=name)
    return merged


def _locate(document: dict[str, Any], folder: Path) -> None:
    """Make paths in a scenario's file, which start where it is, ones that start anywhere."""
    arena = document.get("arena")
    if isinstance(arena, dict) and isinstance(arena.get("image"), str):
        arena["image"] = str(folder / arena["image"])
    people = document.get("pedestrians")
    if not isinstance(people, dict):
        return
    settings = people.get("recording")
    if settings and isinstance(settings, str):  # as a section, so that more can be said of it
        people["recording"] = {"file": str(folder / settings)}
    elif isinstance(settings, dict) and isinstance(path := settings.get("file"), str):
        settings["file"] = path and str(folder / path)


def _is_file(path: Any) -> bool:
    try:
        return len(path.name) <= _LONGEST_NAME and path.is_file()
    except OSError:  # a path that is too long, or through a folder that nobody may enter
        return False
