"""Scenarios: everything a scenario file may say, with units and ranges.

A scenario file is YAML; ``extends: NAME`` starts from another scenario, and any field can be
overridden (``pedestrians.count=12``) from the command line or from Python. Unknown keys and
values out of range are refused with an error that names the file, the field and what is allowed.
"""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

Signed = Annotated[float, Field(ge=-20, le=20)]
Size = Annotated[float, Field(gt=0, le=20)]
Speed = Annotated[float, Field(ge=0, le=10)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]


_LONGEST_NAME = 200
_OUT_OF_RANGE = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")
_SYMBOLS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


class ScenarioError(ValueError):
    """A scenario that cannot be used; the message names the file or field and what is allowed."""


def later(default: Any, since: str, **declared: Any) -> Any:
    """Declare a field that 0.1.0 did not have; at its default it leaves every digest unchanged.

    Args:
        default: how the world was before; it can never be another one afterwards.
        since: the version that brought the field, e.g. ``"0.2"``.
        declared: as for ``pydantic.Field``.
    """
    return Field(default, json_schema_extra={"since": since}, **declared)


class _Section(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False
    )

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> _Section:
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, tuple) and len(value) == 2 and value[0] > value[1]:
                raise ValueError(f"{name}: the lower bound {value[0]} exceeds the upper {value[1]}")
        return self


class Arena(_Section):
    """Where the scene takes place; the origin is its centre, a corridor runs along x."""

    kind: Literal["open", "corridor"] = Field(
        "open", description="a corridor has walls on its long sides"
    )
    length: Positive = Field(10.0, le=200, description="extent along x [m]")
    width: Positive = Field(10.0, le=200, description="extent along y [m]")


class Robots(_Section):
    """The robots: differential drive, rectangular footprint."""

    count: int = Field(1, ge=1, le=32, description="how many")
    length: Positive = Field(0.4, le=5, description="footprint along the heading [m]")
    width: Positive = Field(0.3, le=5, description="footprint across the heading [m]")
    speed: tuple[Signed, Signed] = Field((0.0, 1.0), description="forward speed v [m/s]")
    turn_rate: tuple[Signed, Signed] = Field(
        (-1.5, 1.5), description="turn rate w [rad/s], left positive"
    )
    acceleration: tuple[Positive, Positive] | None = Field(
        None, description="limits on |dv/dt| [m/s^2] and |dw/dt| [rad/s^2]; none by default"
    )
    travel: Positive = Field(8.0, le=200, description="straight distance from start to goal [m]")
    goal_tolerance: Positive = Field(0.3, le=5, description="arrival distance [m]")


class Lidar(_Section):
    """A planar LiDAR at the robot's centre."""

    beams: int = Field(180, ge=1, le=4096, description="rays per scan, evenly spaced")
    field_of_view: Positive = Field(360.0, le=360, description="centred ahead [deg]")
    range: Positive = Field(6.0, le=100, description="largest distance reported [m]")
    noise: NonNegative = Field(0.0, le=1, description="standard deviation of a distance [m]")
    dropout: Share = Field(0.0, description="share of beams that report the full range")


class Obstacles(_Section):
    """Static round obstacles, placed at random."""

    count: int = Field(0, ge=0, le=200, description="how many")
    radius: tuple[Size, Size] = Field((0.3, 0.5), description="drawn per obstacle [m]")


class Pedestrians(_Section):
    """The people: how many, how they walk, what they want and whom they see."""

    count: int = Field(8, ge=0, le=500, description="how many")
    radius: Positive = Field(0.25, le=2, description="of everybody [m]")
    speed: tuple[Speed, Speed] = Field(
        (0.3, 0.6), description="preferred walking speed, drawn per person [m/s]"
    )
    model: Literal["orca", "social_force", "straight"] = Field(
        "orca", description="how they avoid others; straight: not at all"
    )
    control: Literal["scripted", "agents"] = Field(
        "scripted", description="agents: each pedestrian is a PettingZoo agent too"
    )
    reactive: Share = Field(1.0, description="share of the people who see the robot")
    field_of_view: Positive = Field(
        220.0, le=360, description="within which a reactive pedestrian sees the robot [deg]"
    )
    responsibility: Share = Field(
        0.5, description="share of an evasion that a pedestrian takes on when meeting the robot"
    )
    goals: Literal["unimodal", "multimodal"] = Field(
        "unimodal", description="multimodal: a leg may be interrupted"
    )
    switch_probability: Share = Field(
        0.5, description="multimodal: chance that a leg is interrupted, half of them to return"
    )
    leg: Positive = Field(
        4.0, le=200, description="least distance from a leg's start to its goal [m]"
    )
    on_arrival: Literal["new_goal", "stop"] = Field(
        "new_goal", description="walk on to another goal, or stand still"
    )
    spawn_clearance: NonNegative = Field(
        1.0, description="least gap between a pedestrian and a robot's start, surfaces [m]"
    )


class Reward(_Section):
    """Weights of R = R_goal + R_collision + R_social (paper, section III.B)."""

    arrival: float = Field(20.0, description="on arrival (r_arrival)")
    progress: float = Field(9.0, description="per metre nearer to the goal (w_1)")
    collision: float = Field(-60.0, description="on contact (r_collision)")
    proximity: float = Field(
        -0.4, description="times 1 - d / proximity_range for the nearest surface (w_2)"
    )
    proximity_range: Positive = Field(
        1.25, description="beyond which nothing is near (r + 1 m) [m]"
    )
    social: NonNegative = Field(
        0.2, description="times 1 - d / social_radius (w_3); 0 switches it off"
    )
    social_radius: Positive = Field(
        1.2, description="beyond which nobody is cut in on (r_s), centres [m]"
    )
    social_horizon: Positive = Field(2.0, description="how far the interaction is predicted [s]")


class Scenario(_Section):
    """One world to be crossed, complete and immutable.

    Together with an episode seed it fixes everything that happens except what agents decide.
    """

    name: str = Field(
        min_length=1,
        max_length=100,
        pattern=r"^[A-Za-z0-9_.-]+$",
        description="letters, digits and _.-; by default the file's",
    )
    description: str = Field("", description="what it is like, in a line")
    control_period: Positive = Field(0.2, le=2, description="time between two actions [s]")
    substeps: int = Field(4, ge=1, le=50, description="physics steps per control period")
    time_limit: Positive = Field(40.0, le=3600, description="after which an episode ends [s]")
    arena: Arena = Arena()
    robots: Robots = Robots()
    lidar: Lidar = Lidar()
    obstacles: Obstacles = Obstacles()
    pedestrians: Pedestrians = Pedestrians()
    reward: Reward = Reward()

    @property
    def max_steps(self) -> int:
        """Control steps until the time limit."""
        return max(1, round(self.time_limit / self.control_period))

    @property
    def digest(self) -> str:
        """12 hex digits that change whenever anything about the world changes.

        Name, description and reward weights are left out: they do not change what happens.
        ``later`` fields count only where they differ from their defaults.
        """
        plain = type(self)(name=self.name)
        aside = dict.fromkeys(("name", "description", "reward"), True)
        world = self.model_dump(exclude=_unchanged(self, plain) | aside)
        return hashlib.sha256(json.dumps(world, sort_keys=True).encode()).hexdigest()[:12]

    def override(self, changes: Mapping[str, Any]) -> Scenario:
        """Return a copy with some fields replaced, e.g. ``{"pedestrians.count": 12}``.

        Raises:
            ScenarioError: unknown field or value out of range.
        """
        document = self.model_dump()
        for key, value in _flatten(changes).items():
            _assign(document, key, value)
        return _validate(document, source=self.name)


def _unchanged(section: BaseModel, plain: BaseModel) -> dict[str, Any]:
    """The ``later`` fields that have their defaults, as ``model_dump`` excludes them."""
    found: dict[str, Any] = {}
    for name, field in type(section).model_fields.items():
        value, default = getattr(section, name), getattr(plain, name)
        extra = field.json_schema_extra
        if isinstance(extra, dict) and "since" in extra and value == default:
            found[name] = True
        elif isinstance(value, BaseModel) and (within := _unchanged(value, default)):
            found[name] = within
    return found


def scenario_names() -> list[str]:
    """Names of the scenarios that come with crowdbench, in the order of the paper's tables."""
    documents = {path.name[:-5]: _parse(path) for path in _folder().iterdir() if _is_yaml(path)}
    listed = [name for name, document in documents.items() if not document.get("abstract")]
    return sorted(listed, key=lambda name: (documents[name].get("order", 99), name))


def load_scenario(name: str | Path | Scenario, /, **changes: Any) -> Scenario:
    """Load a scenario by name or from a YAML file, with some fields replaced.

    Args:
        name: a built-in scenario, the path of a ``.yaml`` file, or a Scenario.
        changes: nested sections (``pedestrians={"count": 12}``) or dotted keys.

    Raises:
        ScenarioError: unknown name (the nearest are listed), unknown key or value out of range.
    """
    if isinstance(name, Scenario):
        return name.override(_flatten(changes)) if changes else name
    document = _resolve(str(name), base=None, seen=())
    for key, value in _flatten(changes).items():
        _assign(document, key, value)
    return _validate(document, source=str(name))


def parse_overrides(items: list[str]) -> dict[str, Any]:
    """Read ``["pedestrians.count=12", ...]`` as given on a command line; values are YAML.

    Raises:
        ScenarioError: an item without ``=`` or whose value is not YAML.
    """
    changes: dict[str, Any] = {}
    for item in items:
        key, separator, text = item.partition("=")
        if not separator or not key.strip():
            raise ScenarioError(f"--set {item!r}: expected key=value, e.g. pedestrians.count=12")
        try:
            changes[key.strip()] = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise ScenarioError(f"--set {item!r}: {text!r} is not a YAML value") from error
    return changes


def nearest(word: str, known: list[str]) -> str:
    """Say what may have been meant: ``"; did you mean 'x'?"`` or the list of known words."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else f"; known: {', '.join(known)}"


def _folder() -> Any:
    return resources.files("crowdbench_scenarios")


def _is_yaml(path: Any) -> bool:
    return str(path.name).endswith(".yaml")


def _parse(path: Any) -> dict[str, Any]:
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read ({error.strerror})") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: not a YAML file ({' '.join(str(error).split())})") from error
    if not isinstance(document, dict):
        raise ScenarioError(f"{path}: expected 'key: value' lines, got {type(document).__name__}")
    return document


def _resolve(name: str, base: Path | None, seen: tuple[str, ...]) -> dict[str, Any]:
    """Read a document with everything it extends merged beneath it."""
    is_path = name.endswith((".yaml", ".yml"))
    path: Any = (base / name if base else Path(name)) if is_path else _folder() / f"{name}.yaml"
    if len(Path(name).name) > _LONGEST_NAME or not path.is_file():
        if is_path:
            raise ScenarioError(f"scenario file {str(path)!r} does not exist")
        raise ScenarioError(f"unknown scenario {name!r}{nearest(name, scenario_names())}")
    place = str(path.resolve() if isinstance(path, Path) else path)
    if place in seen:
        raise ScenarioError(f"{path}: extends itself ({' -> '.join((*seen, place))})")
    document = _parse(path)
    parent = document.pop("extends", None)
    document.pop("abstract", None)
    document.pop("order", None)
    document.setdefault("name", Path(name).stem)
    if parent is None:
        return document
    if not isinstance(parent, str):
        raise ScenarioError(f"{path}: extends: expected the name of a scenario, got {parent!r}")
    beneath = _resolve(parent, base=path.parent if is_path else None, seen=(*seen, place))
    return _merge(beneath, document)


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merge(merged[key], value) if both else value
    return merged


def _flatten(changes: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in changes.items():
        if isinstance(value, Mapping):
            flat |= _flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _assign(document: dict[str, Any], key: str, value: Any) -> None:
    *sections, field = key.split(".")
    for section in sections:
        document = document.setdefault(section, {})
        if not isinstance(document, dict):
            raise ScenarioError(f"{key}: {section!r} is a value, not a section")
    document[field] = value


def _validate(document: dict[str, Any], source: str) -> Scenario:
    try:
        return Scenario.model_validate(document)
    except ValidationError as error:
        lines = [_explain(item) for item in error.errors()]
        raise ScenarioError(f"scenario {source!r}: " + "; ".join(lines)) from error


def _explain(item: Any) -> str:
    """One pydantic error as a sentence with the dotted field and, for typos, the nearest name."""
    parts = [part for part in item["loc"] if isinstance(part, str)]
    field = ".".join(parts)
    if item["type"] == "extra_forbidden":
        section: Any = Scenario
        for part in parts[:-1]:
            section = section.model_fields[part].annotation
        return f"unknown key {field!r}{nearest(parts[-1], list(section.model_fields))}"
    allowed = _allowed(item["loc"]) if item["type"] in _OUT_OF_RANGE else ""
    if allowed:
        return f"{field}: {item['input']!r} is out of range; allowed: {allowed}"
    if item["type"] == "value_error":
        text = str(item["ctx"]["error"])
        return f"{field}.{text}" if field else text
    return f"{field}: {item['msg']} (got {item['input']!r})" if field else str(item["msg"])


def _allowed(location: tuple[str | int, ...]) -> str:
    """The range of a field, or of an element of a pair, as declared above: ``>= 0 and <= 500``."""
    section: Any = Scenario
    found: list[Any] = []
    for part in location:
        if isinstance(part, str) and part in getattr(section, "model_fields", {}):
            field = section.model_fields[part]
            section, found = field.annotation, list(field.metadata)
        elif isinstance(part, int):
            pair = next(option for option in (section, *get_args(section)) if _is_pair(option))
            found = get_args(pair)[part].__metadata__[0].metadata
    return " and ".join(
        f"{symbol} {getattr(limit, key)}"
        for key, symbol in _SYMBOLS.items()
        for limit in found
        if hasattr(limit, key)
    )


def _is_pair(annotation: Any) -> bool:
    return get_origin(annotation) is tuple
