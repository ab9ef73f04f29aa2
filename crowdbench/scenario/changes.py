"""Documents of a scenario before they are checked: nested dictionaries, merged and changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crowdbench.messages import short
from crowdbench.scenario.errors import ScenarioError


def merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """One document over another, section by section."""
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = merge(merged[key], value) if both else value
    return merged


def change(document: dict[str, Any], changes: Mapping[str, Any]) -> None:
    """Replace fields of a document, named by nested sections or by dotted keys.

    Raises:
        ScenarioError: something on the way of a dotted key is no section.
    """
    for key, value in changes.items():
        *sections, field = str(key).split(".")
        section = document
        for number, part in enumerate(sections, 1):
            section = section.setdefault(part, {})
            if not isinstance(section, dict):
                kind, whole = "value", "..."
                if isinstance(section, list | tuple):
                    kind, whole = "list", "[...], the whole list"
                raise ScenarioError(
                    f"{_text(str(key))}: {short(part)} is a {kind}, not a section; allowed: "
                    f"{_text('.'.join(sections[:number]))}={whole}"
                )
        if isinstance(value, Mapping):
            below = section.get(field, {})
            # A section in the place of a value is left for the check to complain of.
            replaced = below if isinstance(below, dict) else {}
            change(replaced, value)
            section[field] = replaced
        else:
            section[field] = value


def _text(key: str) -> str:
    return short(key)[1:-1]
