"""Digests, by which stored episodes are found, and the fields that leave them as they were."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from pydantic import BaseModel, Field

_ASIDE = dict.fromkeys(("name", "description", "reward"), True)


def later(default: Any, since: str, *, aside: bool = False, **declared: Any) -> Any:
    """Declare a field that 0.1.0 did not have; at its default it leaves every digest unchanged.

    Args:
        default: how the world was before; it can never be another one afterwards.
        since: the version that brought the field, e.g. ``"0.2"``.
        aside: it does not change what happens, and no digest depends on it.
        declared: as for ``pydantic.Field``.
    """
    return Field(default, json_schema_extra={"since": since, "aside": aside}, **declared)


def digest(scenario: BaseModel, plain: BaseModel) -> str:
    """12 hex digits of everything that changes what happens.

    Args:
        scenario: whose digest.
        plain: the same kind with all defaults.
    """
    world = scenario.model_dump(exclude=_unchanged(scenario, plain) | _ASIDE)
    return hashlib.sha256(json.dumps(world, sort_keys=True).encode()).hexdigest()[:12]


def _unchanged(section: BaseModel, plain: BaseModel) -> dict[str, Any]:
    """What digests leave out, as ``model_dump`` excludes it.

    ``later`` fields that have their defaults, and those ``aside``.
    """
    found: dict[str, Any] = {}
    for name, field in type(section).model_fields.items():
        value, default = getattr(section, name), getattr(plain, name)
        extra = field.json_schema_extra
        extra = extra if isinstance(extra, dict) else {}
        if extra.get("aside") or ("since" in extra and value == default):
            found[name] = True
        elif isinstance(value, BaseModel) and (within := _unchanged(value, default)):
            found[name] = within
    return found
