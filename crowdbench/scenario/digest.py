"""Digests, by which stored episodes are found, and the fields that leave them as they were."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from pydantic import BaseModel, Field

_ASIDE = dict.fromkeys(("name", "description", "reward"), True)


def later(default: Any, since: str, **declared: Any) -> Any:
    """Declare a field that 0.1.0 did not have; at its default it leaves every digest unchanged.

    Args:
        default: how the world was before; it can never be another one afterwards.
        since: the version that brought the field, e.g. ``"0.2"``.
        declared: as for ``pydantic.Field``.
    """
    return Field(default, json_schema_extra={"since": since}, **declared)


def digest(scenario: BaseModel, plain: BaseModel) -> str:
    """12 hex digits of everything that changes what happens.

    Args:
        scenario: whose digest.
        plain: the same kind with all defaults.
    """
    world = scenario.model_dump(exclude=_unchanged(scenario, plain) | _ASIDE)
    return hashlib.sha256(json.dumps(world, sort_keys=True).encode()).hexdigest()[:12]


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
