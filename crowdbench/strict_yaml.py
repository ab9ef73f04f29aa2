"""YAML as scenario files, ``--set``, agent options and configuration files use it.

Plain data alone: no tags beyond the core ones, no aliases, no dates (they are text), no key twice.
``1e-3`` is a number, as in YAML 1.2. Whatever is wrong is one short line with its place.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Hashable
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import yaml

from crowdbench.messages import printable, short

MAX_DEPTH = 32
"""Sections within sections, beyond which a document is refused."""
MAX_DIGITS = 4300
"""Of a number; Python itself turns no longer one into text."""
MAX_SIZE = 1_000_000
"""Of a file [characters]."""

_CORE = ("null", "bool", "int", "float", "str", "seq", "map")
_PLAIN = frozenset(f"tag:yaml.org,2002:{kind}" for kind in _CORE)
_FLOAT = "tag:yaml.org,2002:float"
_FLOATS = re.compile(r"^[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$|^[-+]\.[0-9]+$")
"""Numbers of YAML 1.2 that PyYAML takes for text: ``1e-3``, ``-.5``."""


class YamlError(ValueError):
    """Text that is not the YAML allowed here; the message is one line and names the place."""


def load_yaml(text: str) -> Any:
    """Read one document: None, bool, int, float, str, and lists and dictionaries of them.

    Raises:
        YamlError: no YAML, a key twice, an alias, a tag, too deep, or a number too long.
    """
    loader = None
    try:
        loader = _Loader(text)
        return loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        problem = f"{error.problem or error.context}"
        raise YamlError(_at(error.problem_mark or error.context_mark, problem)) from error
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise YamlError(f"line {line}: character {error.character:#x} is not allowed") from error
    except Exception as error:
        # PyYAML lets whatever Python raises through: ValueError for an escape that is no
        # character, IndexError for an empty number, KeyError for a truth value that is none.
        mark = None if loader is None else loader.get_mark()
        raise YamlError(_at(mark, f"a value that cannot be read ({error})")) from error


def read_yaml(path: Path | Traversable) -> Any:
    """Read the document in a file.

    Raises:
        YamlError: unreadable, no text, or not the YAML allowed; names the file and the line.
    """
    place = printable(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise YamlError(f"{place}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise YamlError(f"{place}: not a YAML file (no text in UTF-8)") from error
    if len(text) > MAX_SIZE:
        raise YamlError(f"{place}: not read, as it has more than {MAX_SIZE:,} characters")
    try:
        return load_yaml(text)
    except YamlError as error:
        raise YamlError(f"{place}: not a YAML file ({error})") from error


def dump_scalar(value: object) -> str:
    """Text of one value, in one line, that ``load_yaml`` reads as that value.

    Raises:
        YamlError: nothing that YAML can say.
    """
    try:
        text = yaml.dump(
            value, Dumper=_Dumper, default_flow_style=True, allow_unicode=True, width=sys.maxsize
        )
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise YamlError(f"{short(value)} has no text in YAML") from error
    return str(text).removesuffix("\n...\n").strip()


def _at(mark: yaml.Mark | None, problem: str) -> str:
    text = " ".join(problem.split())
    text = text if len(text) <= 120 else f"{text[:117]}..."
    return text if mark is None else f"line {mark.line + 1}: {text}"


class _Loader(yaml.SafeLoader):
    """SafeLoader without what makes documents surprising or endless."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.MarkedYAMLError(
                problem="an alias (*) is not allowed", problem_mark=self.peek_event().start_mark
            )
        if self.depth > MAX_DEPTH:
            raise yaml.MarkedYAMLError(
                problem=f"nested more than {MAX_DEPTH} deep", problem_mark=self.get_mark()
            )
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        if node is not None and node.tag not in _PLAIN:
            raise yaml.MarkedYAMLError(
                problem=f"the tag {short(node.tag)} is not allowed", problem_mark=node.start_mark
            )
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        problem = ""
        if node.tag.endswith((":int", ":float")) and len(node.value) > MAX_DIGITS:
            problem = f"a number of more than {MAX_DIGITS} digits"
        else:
            try:
                value = super().construct_object(node, deep=deep)
                if isinstance(value, int):
                    str(value)  # fails where one in another base has too many digits to be shown
                elif isinstance(value, str):
                    value.encode()  # fails for an escape that is half a character
                return value
            except (ValueError, LookupError, OverflowError) as error:
                problem = f"{short(node.value)} is no value of its type ({error})"
        raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)

    def construct_mapping(self, node: yaml.Node, deep: bool = False) -> dict[Hashable, Any]:
        if not isinstance(node, yaml.MappingNode):
            raise yaml.MarkedYAMLError(
                problem="expected 'key: value' lines", problem_mark=node.start_mark
            )
        mapping: dict[Hashable, Any] = {}
        lines: dict[Hashable, int] = {}
        for key_node, value_node in node.value:
            key = self.construct_object(key_node, deep=True)
            problem = ""
            if not isinstance(key, Hashable):
                problem = "a key that is a list or a section"
            elif key in lines:
                problem = f"the key {short(key)} stands twice, first in line {lines[key]}"
            if problem:
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key_node.start_mark)
            lines[key] = key_node.start_mark.line + 1
            mapping[key] = self.construct_object(value_node, deep=deep)
        return mapping


class _Dumper(yaml.SafeDumper):
    """SafeDumper that quotes text which ``_Loader`` would take for a number."""


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag in _PLAIN]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _class in (_Loader, _Dumper):
    _class.add_implicit_resolver(_FLOAT, _FLOATS, list("-+.0123456789"))
