"""Agents: what a planner implements, and how one is found.

An agent is a class with two methods in one file::

    import crowdbench

    class MyPlanner(crowdbench.Agent):
        def reset(self, robot, seed):
            self.robot = robot

        def act(self, observation):
            return 0.5, 0.0  # v [m/s], w [rad/s]

``crowdbench run --agent my_planner.py:MyPlanner`` runs it. Installed packages add agents through
the entry-point group ``crowdbench.agents``.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import re
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any, ClassVar, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from crowdbench.messages import (
    allowed,
    describe_error,
    describe_text,
    is_interrupt,
    nearest,
    quoted,
    setting,
    short,
)
from crowdbench.robot import Observation, RobotSpec
from crowdbench.scenario import Scenario
from crowdbench.strict_yaml import YamlError, dump_scalar, load_yaml

ENTRY_POINT_GROUP = "crowdbench.agents"

_FILE_NAME = re.compile(r"[^=]*\.[A-Za-z]\w*")
"""An option that is the name of a file and nothing else."""

Action = tuple[float, float] | NDArray[np.floating]
"""Two numbers; for a differential drive v [m/s], w [rad/s], for others see ``RobotSpec.drive``."""


class AgentError(ValueError):
    """An agent that cannot be found or made; the message says what is known."""


class Agent(ABC):
    """A planner. Keyword arguments of ``__init__`` are its options (``name:option=value``).

    An option annotated with a range, ``gain: Annotated[float, pydantic.Field(gt=0, le=5)]``, is
    checked before the agent is made, and whoever gives another value is told the range.
    """

    privileged: ClassVar[bool] = False
    """If true, ``observation.state`` is filled in: for ceilings and tests, never for comparison."""

    drives: tuple[str, ...] | None = ("differential",)
    """Names of the drives that it can act for, see ``RobotSpec.drive``; None for all."""

    unsupported_models: tuple[str, ...] = ()
    """Names of the walking models, see ``pedestrians.model``, among whose people it cannot act."""

    weights_sha256: str | None = None
    """Hash of the weights file in use, stored with every result; None without weights."""

    version: ClassVar[str | None] = None
    """Of what an installed agent does, raised whenever it decides otherwise: stored episodes of
    another version are not its own. None: its distribution's. A subclass states one of its own."""

    @abstractmethod
    def reset(self, robot: RobotSpec, seed: int) -> None:
        """Start an episode. All randomness of the agent comes from ``seed``.

        One agent drives many episodes; nothing of the one before may remain.
        """

    @abstractmethod
    def act(self, observation: Observation) -> Action:
        """Return the action for the next control period; what is out of range is clipped.

        For a differential drive this is (v [m/s], w [rad/s]).
        """

    def diagnostics(self) -> dict[str, float]:
        """Counters of the episode that just ended (e.g. failed solves), stored with its log."""
        return {}


@dataclass(frozen=True)
class AgentSpec:
    """An agent as named on a command line.

    ``name[:option=value,...]`` or ``file.py[:Class][:option=value,...]``. The option ``file`` may
    come first without its name: ``name:weights.bin``.

    Attributes:
        name: of an installed agent, or ``file.py[:Class]``.
        options: keyword arguments of the agent, by name.

    Raises:
        AgentError: a name or option that its own text would not give back.
    """

    name: str
    options: Mapping[str, Any]

    def __post_init__(self) -> None:
        """Make sure that the text, by which results are told apart, says everything."""
        for key, value in self.options.items():
            if not _says_everything(value):
                raise AgentError(
                    f"agent {quoted(self.name)}, option {short(key)}: expected a number, true, "
                    f"false, null or text without commas, got {setting(value)}"
                )
        if not str(self).isprintable():
            raise AgentError(f"agent {quoted(str(self))}: a name must be printable")

    @classmethod
    def parse(cls, text: str) -> AgentSpec:
        """Split a name from its options; values are YAML scalars.

        Raises:
            AgentError: an option without ``=``, or whose value is not YAML.
        """
        name, _, rest = text.partition(":")
        if name.endswith(".py") and "=" not in rest.partition(":")[0]:
            class_name, _, rest = rest.partition(":")
            name = f"{name}:{class_name}" if class_name else name
        options: dict[str, Any] = {}
        items = [item for item in (part.strip() for part in rest.split(",")) if item]
        if items and _FILE_NAME.fullmatch(items[0]):
            options["file"] = items.pop(0)
        for item in items:
            key, separator, value = item.partition("=")
            if not separator or not key.strip():
                raise AgentError(f"agent {quoted(text)}: expected option=value, got {short(item)}")
            try:
                options[key.strip()] = load_yaml(value)
            except YamlError as error:
                raise AgentError(
                    f"agent {quoted(text)}: {short(value)} is not a YAML value ({error})"
                ) from error
        return cls(name, options)

    def __str__(self) -> str:
        options = ",".join(
            f"{key}={dump_scalar(self.options[key])}" for key in sorted(self.options)
        )
        return f"{self.name}:{options}" if options else self.name

    def make(self) -> Agent:
        """Find the class and make the agent.

        Raises:
            AgentError: unknown agent or option (the nearest are listed), an option outside the
                range that the agent declares for it, or a broken file.
        """
        factory = find_agent(self.name)
        lacking = sorted(getattr(factory, "__abstractmethods__", ()))
        if lacking:
            raise AgentError(
                f"agent {quoted(self.name)}: class {factory.__name__!r} has no method "
                f"{' and no method '.join(lacking)}; every agent has reset and act"
            )
        accepted = agent_options(factory)
        for key in self.options:
            if key not in accepted:
                known = nearest(key, list(accepted)) if accepted else "; it takes no options"
                raise AgentError(f"agent {quoted(self.name)} has no option {short(key)}{known}")
        for key, default in accepted.items():
            if default is inspect.Parameter.empty and key not in self.options:
                raise AgentError(f"agent {quoted(self.name)} needs the option {key!r}")
        self._check_ranges(factory)
        try:
            return factory(**self.options)
        except BaseException as error:
            if is_interrupt(error):
                raise
            # The reader of what is wrong with an option is a user, that of a file its author.
            of_option = type(error) is ValueError and not _in_file(self.name)
            told = describe_text(error) if of_option else describe_error(error)
            raise AgentError(f"agent {quoted(str(self))}: {told}") from error

    def _check_ranges(self, factory: type[Agent]) -> None:
        for key, kind in _declared_ranges(factory).items():
            if key not in self.options:
                continue
            value = self.options[key]
            try:
                TypeAdapter(kind).validate_python(value, strict=True)
            except ValidationError as error:
                raise AgentError(
                    f"agent {quoted(self.name)}, option {key!r}: expected {allowed(kind)}, "
                    f"got {setting(value)}"
                ) from error


def require_suited(
    drives: tuple[str, ...] | None,
    unsupported_models: tuple[str, ...],
    label: str,
    scenario: Scenario,
) -> None:
    """Make sure that an agent can act for the robots of a scenario, and among its people.

    Args:
        drives, unsupported_models: as the agent declares them.
        label: its name.
        scenario: where it is to drive.

    Raises:
        AgentError: it declares other drives, or the walking model as one that it cannot act among.
    """
    if scenario.pedestrians.model in unsupported_models:
        raise AgentError(
            f"agent {label!r} cannot drive among the people of scenario {scenario.name!r}, whose "
            f"pedestrians.model is {scenario.pedestrians.model!r}; allowed: any but "
            f"{', '.join(unsupported_models)}"
        )
    if drives is not None and scenario.robots.drive not in drives:
        raise AgentError(
            f"agent {label!r} drives {' or '.join(drives)} robots only, and those of scenario "
            f"{scenario.name!r} are {scenario.robots.drive} (robots.drive)"
        )


def agent_names() -> list[str]:
    """Names of all installed agents."""
    return sorted({point.name for point in entry_points(group=ENTRY_POINT_GROUP)})


def agent_options(factory: type[Agent]) -> dict[str, Any]:
    """Options an agent takes, with their defaults."""
    parameters = list(inspect.signature(factory.__init__).parameters.values())[1:]
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return {p.name: p.default for p in parameters if p.kind in named}


def find_agent(name: str) -> type[Agent]:
    """Return the class of an installed agent, or of ``file.py:Class``.

    Raises:
        AgentError: nothing of that name; the message lists what there is.
    """
    path, _, class_name = name.partition(":")
    if _in_file(name):
        return _from_file(Path(path), class_name)
    for point in entry_points(group=ENTRY_POINT_GROUP):
        if point.name == name:
            try:
                return _checked(point.load(), name)
            except (ImportError, AttributeError) as error:
                raise AgentError(f"agent {name!r}: {describe_error(error)}") from error
    raise AgentError(f"unknown agent {quoted(name)}{nearest(name, agent_names())}")


def code_version(name: str, version: str | None = None) -> str:
    """Hash of the file of a ``file.py:Class`` agent, else the distribution that brings it.

    Args:
        name: of the agent.
        version: in place of that of the distribution.

    Raises:
        AgentError: the file is gone.
    """
    path = name.partition(":")[0]
    if _in_file(name):
        try:
            return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:12]
        except OSError as error:
            raise AgentError(f"agent file {short(path)}: {error.strerror}") from error
    for point in entry_points(group=ENTRY_POINT_GROUP):
        if point.name == name and point.dist is not None:
            return f"{point.dist.name} {version or point.dist.version}"
    return ""


def _in_file(name: str) -> bool:
    """Whether an agent of that name is ``file.py[:Class]``, and no installed one."""
    return name.partition(":")[0].endswith(".py")


def _from_file(path: Path, class_name: str) -> type[Agent]:
    if not _is_file(path):
        raise AgentError(f"agent file {quoted(str(path))} does not exist")
    unique = hashlib.sha256(str(path.resolve()).encode("utf-8", "surrogateescape")).hexdigest()[:8]
    module_name = f"crowdbench_plugin_{path.stem}_{unique}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None:
        raise AgentError(f"agent file {str(path)!r} is not a Python module")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses and pickle look their module up
    try:
        spec.loader.exec_module(module)
    except BaseException as error:
        if is_interrupt(error):
            raise
        raise AgentError(f"agent file {str(path)!r}: {describe_error(error)}") from error
    classes = {
        key: value
        for key, value in vars(module).items()
        if inspect.isclass(value)
        and issubclass(value, Agent)
        and value.__module__ == module.__name__
    }
    if not class_name and len(classes) == 1:
        return next(iter(classes.values()))
    if class_name not in classes:
        if inspect.isclass(vars(module).get(class_name)):
            raise AgentError(
                f"agent file {str(path)!r}: class {class_name!r} is not a subclass of "
                "crowdbench.Agent"
            )
        found = ", ".join(classes) or "none"
        wanted = f"no agent class {class_name!r}" if class_name else "expected file.py:Class"
        raise AgentError(f"agent file {str(path)!r}: {wanted}; agent classes found: {found}")
    return classes[class_name]


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a path that is too long, or through a folder that nobody may enter
        return False


def _checked(value: Any, name: str) -> type[Agent]:
    if not (inspect.isclass(value) and issubclass(value, Agent)):
        raise AgentError(f"agent {name!r}: {value!r} is not a subclass of crowdbench.Agent")
    return value


def _says_everything(value: Any) -> bool:
    """Whether an option's text gives the option back."""
    if isinstance(value, list | dict):
        return False
    try:
        text = dump_scalar(value)
        return "," not in text and bool(load_yaml(text) == value)
    except YamlError:
        return False


def _declared_ranges(factory: type[Agent]) -> dict[str, Any]:
    """Options whose annotation in ``__init__`` is ``Annotated`` with a range."""
    try:
        hints = get_type_hints(factory.__init__, include_extras=True)
    except Exception:  # annotations are the agent's own; they need not mean anything here
        return {}
    return {key: hint for key, hint in hints.items() if get_origin(hint) is Annotated}
