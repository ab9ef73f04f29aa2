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


def flatten(changes: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested sections as dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in changes.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def assign(document: dict[str, Any], key: str, value: Any) -> None:
    """Set the field of a dotted key.

    Raises:
        ScenarioError: something on the way is no section.
    """
    *sections, field = key.split(".")
    for section in sections:
        document = document.setdefault(section, {})
        if not isinstance(document, dict):
            raise ScenarioError(f"{_text(key)}: {short(section)} is a value, not a section")
    document[field] = value


def _text(key: str) -> str:
    return short(key)[1:-1]
