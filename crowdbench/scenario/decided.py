"""What a recording or the image of a map decides, and a scenario that has one need not say.

Walls and polygons of the map on which an image is set are not decided: who sets it says what stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from crowdbench.messages import quoted, setting
from crowdbench.scenario.changes import change
from crowdbench.scenario.errors import ScenarioError
from crowdbench.scenario.people import Pedestrians
from crowdbench.scenario.recorded import HABITS
from crowdbench.scenario.sections import Arena

_WAYS = (
    "count",
    "speed",
    "speed_mean",
    "speed_deviation",
    "goals",
    "switch_probability",
    "leg",
    "leg_from",
    "on_arrival",
)
_EXTENT = ("length", "width")
_OF_RECORDING = "the recording decides it; allowed with pedestrians.model 'recorded'"
_OF_IMAGE = "the image decides it; allowed with arena.image"


def leave_decided(document: dict[str, Any], own: Mapping[str, Any], source: str) -> None:
    """Refuse settings that would change nothing, since a recording or an image decides them.

    Refused too is an image that would be laid over what the map has that it is set on.

    What is inherited is not refused: it was said of simulated people, or of another place. Of it,
    what people do beside walking to their goals is taken out where they walk as recorded.

    Args:
        document: of a scenario, with everything that it inherits.
        own: what has been set on top of that: one file's document, or changes.
        source: of the scenario.

    Raises:
        ScenarioError: a field is set that the recording or the image decides, or an image without
            what stays of another map.
    """
    people, arena = document.get("pedestrians"), document.get("arena")
    if isinstance(arena, dict) and arena.get("kind") == "map" and arena.get("image"):
        _refuse("arena", Arena, (*_EXTENT, "centre"), own, source, _OF_IMAGE)
        _refuse_over_another(arena, own, source)
    if not isinstance(people, dict) or people.get("model") != "recorded":
        return
    _refuse("pedestrians", Pedestrians, (*_WAYS, *HABITS), own, source, _OF_RECORDING)
    # Walls of a map, or its image, say how large it is.
    if not isinstance(arena, dict) or arena.get("kind") != "map":
        _refuse("arena", Arena, _EXTENT, own, source, _OF_RECORDING)
    for field in HABITS:
        people.pop(field, None)


def _refuse(
    section: str,
    kind: type[BaseModel],
    decided: tuple[str, ...],
    own: Mapping[str, Any],
    source: str,
    reason: str,
) -> None:
    settings = _set_in(section, own)
    # Who gives every field has copied a scenario as it is, and sets none in particular.
    if settings.keys() >= kind.model_fields.keys():
        return
    for field in decided:
        if field in settings:
            raise ScenarioError(
                f"scenario {quoted(source)}: {section}.{field}: {setting(settings[field])}; "
                f"{reason}: to leave it out"
            )


def _refuse_over_another(arena: Mapping[str, Any], own: Mapping[str, Any], source: str) -> None:
    settings = _set_in("arena", own)
    solids = ("polygons", "walls")
    kept = [f"arena.{field}" for field in solids if arena.get(field) and field not in settings]
    if settings.get("image") and kept:
        raise ScenarioError(
            f"scenario {quoted(source)}: arena.image: {setting(settings['image'])} for a map that "
            f"has {' and '.join(kept)} already; allowed: with {' and '.join(kept)}, [] to leave "
            "them out"
        )


def _set_in(section: str, own: Mapping[str, Any]) -> dict[str, Any]:
    """What has been set of a section, by nested sections or by dotted keys."""
    nested: dict[str, Any] = {}
    change(nested, own)
    settings = nested.get(section)
    return settings if isinstance(settings, dict) else {}
