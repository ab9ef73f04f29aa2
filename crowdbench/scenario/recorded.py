"""Worlds whose people walk as recorded: what the file says goes into the scenario."""

from __future__ import annotations

import hashlib
import math
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from crowdbench.messages import quoted, short
from crowdbench.scenario.digest import later
from crowdbench.scenario.fields import Positive, Section, Text

if TYPE_CHECKING:
    from crowdbench.people import CrowdRecording
    from crowdbench.scenario.model import Scenario
    from crowdbench.scenario.sections import Arena

AHEAD = 10.0
"""How far privileged agents see into the recording [s]."""
MOST = 500
"""People in one world."""
HABITS = ("acceleration", "streams", "stops", "standing", "queues", "groups")
"""Fields that say what people do beside walking to their goals; recorded ones have their own."""
_MARGIN = 1.0
"""Of the arena around everybody's ways, and around a robot's start and goal [m]."""


class Recording(Section):
    """The file that people walk by."""

    file: Text = later(
        "", "0.2", aside=True, description="its path, from the scenario's file on; docs/people.md"
    )
    unit: Literal["m", "cm", "mm"] | None = later(
        None, "0.2", description="of its positions, where it does not say"
    )
    fps: Positive | None = later(
        None, "0.2", le=10_000, description="frames a second, where it does not say"
    )
    route: Literal["across", "along"] = later(
        "across",
        "0.2",
        description="how the robot goes where no robots.start says it: across the main direction "
        "of the people, or along it",
    )
    sha256: Text = later(
        "", "0.2", description="of the file; filled in, and compared where it is given"
    )


def completed(scenario: Scenario) -> dict[str, Any]:
    """What a recording says about sections of a scenario: who walks, and how large it all is.

    Returns:
        Fields of each section; empty where nobody walks as recorded.

    Raises:
        ValueError: the recording cannot be used, or not with the rest of the scenario.
    """
    people, arena, robots = scenario.pedestrians, scenario.arena, scenario.robots
    if people.model != "recorded":
        if people.recording.file:
            raise ValueError(
                f"pedestrians.recording.file: {short(people.recording.file)}; allowed: none with "
                f"pedestrians.model {people.model!r} (pedestrians.recording: null)"
            )
        return {}
    if not people.recording.file:
        raise ValueError("pedestrians.recording: missing; allowed: the path of a recording")
    if people.control != "scripted":
        raise ValueError("pedestrians.control: allowed with pedestrians.model 'recorded': scripted")
    for field in HABITS:
        if getattr(people, field) != type(people).model_fields[field].default:
            raise ValueError(
                f"pedestrians.{field}: allowed with pedestrians.model 'recorded': its default"
            )
    if arena.kind == "corridor":
        raise ValueError("arena.kind: 'corridor'; allowed for recorded people: open or map")
    if scenario.obstacles.count:
        raise ValueError("obstacles.count: allowed with pedestrians.model 'recorded': 0")
    recording, digest = load(people.recording)
    count = most_tracks(recording, scenario.time_limit + AHEAD)
    if count > MOST:
        raise ValueError(
            f"pedestrians.recording: {count} people within time_limit {scenario.time_limit:g} s; "
            f"allowed: {MOST}, with a shorter one"
        )
    fields: dict[str, Any] = {
        "pedestrians": {
            "count": count,
            "recording": people.recording.model_copy(
                update={"sha256": digest, "file": str(Path(people.recording.file).absolute())}
            ),
        }
    }
    if arena.kind == "map":
        _require_on_map(recording, arena)
        return fields
    low, high = _bounds(recording)
    span = max(robots.travel, 2 * robots.length) + 2 * _MARGIN
    length, width = (float(max(side + 2 * _MARGIN, span)) for side in high - low)
    return fields | {"arena": {"length": round(length, 3), "width": round(width, 3)}}


def _require_on_map(recording: CrowdRecording, arena: Arena) -> None:
    """Refuse a map on which nobody ever walks: it has other coordinates than the recording.

    Raises:
        ValueError: it is one.
    """
    low, high = np.array(arena.bounds).reshape(2, 2)
    if ((recording.positions >= low) & (recording.positions <= high)).all(axis=1).any():
        return
    (left, bottom), (right, top) = (end.tolist() for end in recording.extent)
    raise ValueError(
        f"pedestrians.recording: everybody walks outside of the map, within x {left:.4g} to "
        f"{right:.4g} and y {bottom:.4g} to {top:.4g} m; allowed: a map in the coordinates of the "
        f"recording (this one has x {low[0]:g} to {high[0]:g} and y {low[1]:g} to {high[1]:g} m)"
    )


def load(settings: Recording) -> tuple[CrowdRecording, str]:
    """The recording that a scenario names, read once, and the hash of its file.

    Raises:
        ValueError: it cannot be read, or is another one than when its hash was noted.
    """
    from crowdbench.people import RecordingError

    path = Path(settings.file)
    try:
        stamp = path.stat()
        found = _read(path, settings.unit, settings.fps, stamp.st_mtime_ns, stamp.st_size)
    except OSError as error:
        raise ValueError(f"pedestrians.recording: {quoted(str(path))}: {error.strerror}") from error
    except RecordingError as error:
        raise ValueError(f"pedestrians.recording: {error}") from error
    if settings.sha256 not in ("", found[1]):
        raise ValueError(
            f"pedestrians.recording: {quoted(str(path))} is another file than the one noted: its "
            f"hash is {found[1][:12]}..., expected {settings.sha256[:12]}..."
        )
    return found


def origin(recording: CrowdRecording, arena: Arena) -> NDArray[np.float64]:
    """(2,) the point of a recording that is the world's origin [m].

    A map has the recording's coordinates; elsewhere it is the centre of everything recorded.
    """
    if arena.kind == "map":
        return np.zeros(2)
    low, high = _bounds(recording)
    return (low + high) / 2


def doubts(scenario: Scenario) -> list[str]:
    """What about a recording and a scenario may not be meant so, each in words."""
    if not scenario.pedestrians.recording.file:
        return []
    return list(filter(None, (_through_walls(scenario), _beyond_everybody(scenario))))


def _beyond_everybody(scenario: Scenario) -> str:
    """Whether robots have farther to go than there are people; empty if not."""
    robots = scenario.robots
    if robots.start is not None or scenario.arena.kind == "map":
        return ""
    recording, _ = load(scenario.pedestrians.recording)
    length, width = np.subtract(*reversed(recording.extent)).tolist()
    longest = math.hypot(length + 2 * _MARGIN, width + 2 * _MARGIN)
    if robots.travel <= longest:
        return ""
    return (
        f"robots.travel: {robots.travel:g} m lead past everybody, as the recorded people walk "
        f"within {length:.3g} x {width:.3g} m; among them it is {longest:.3g} m at most"
    )


def _through_walls(scenario: Scenario) -> str:
    """Who of the recorded people walks through walls or solids; empty for nobody."""
    import shapely  # here, since few scenarios have recordings

    recording, _ = load(scenario.pedestrians.recording)
    walls = [*recording.walls, *(np.reshape(wall, (2, 2)) for wall in scenario.arena.walls)]
    solids = [shapely.Polygon(polygon) for polygon in scenario.arena.polygons]
    solids += [shapely.LineString(wall) for wall in walls]
    # Only maps have walls of their own, and these are in the recording's coordinates.
    tracks = shapely.linestrings(recording.positions, indices=recording.track_of_row)
    through = np.flatnonzero(shapely.intersects(shapely.union_all(solids), tracks))
    if not len(through):
        return ""
    first = through[np.argmin(recording.begins[through])]
    people, everybody = (np.unique(who) for who in (recording.people[through], recording.people))
    return (
        f"{len(people)} of {len(everybody)} recorded people walk through walls or solids, first "
        f"person {recording.people[first]}, who is there from {recording.begins[first]:.1f} s on"
    )


def _bounds(recording: CrowdRecording) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and largest x and y of people and walls, each (2,) [m]."""
    places = np.concatenate([np.stack(recording.extent), *recording.walls])
    return places.min(axis=0), places.max(axis=0)


def most_tracks(recording: CrowdRecording, window: float) -> int:
    """How many tracks overlap any window of this length at most [s]."""
    # Most are there when one has just begun at the window's end.
    moments = np.maximum(recording.begins - window, 0.0)
    begun = np.searchsorted(np.sort(recording.begins), moments + window, side="right")
    gone = np.searchsorted(np.sort(recording.ends), moments, side="left")
    return int((begun - gone).max())


@lru_cache(maxsize=8)
def _read(
    path: Path, unit: str | None, fps: float | None, _time: int, _size: int
) -> tuple[CrowdRecording, str]:
    from crowdbench.people import read_recording

    recording = read_recording(path, unit, fps)
    with path.open("rb") as file:
        return recording, hashlib.file_digest(file, "sha256").hexdigest()
