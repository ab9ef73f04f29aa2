"""Recordings that are text: PeTrack, obsmat of ETH and UCY, TrajNet++ and CSV."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from crowdbench.messages import short
from crowdbench.people.cleaning import UNITS, Rows
from crowdbench.people.errors import RecordingError
from crowdbench.people.stated import Stated, settle
from crowdbench.people.table import is_number, lines, read_numbers, require_whole_end, whole

PETRACK = {"id": 0, "frame": 1, "x": 2, "y": 3}
"""Where the columns of that text are; height or more may follow."""
OBSMAT = ("frame", "id", "x", "z", "y", "vx", "vz", "vy")
"""Columns of that format."""

_UNIT = r"(?:[ _]?[\[(/]?(?P<unit>mm|cm|m)[\])]?)?"
_NAMES = {
    "id": r"(id|(person|ped|pedestrian|agent|track)([ _]?id)?)",
    "frame": r"frame([ _]?(id|number))?",
    "time": r"(time|t|timestamp)([ _]?[\[(/]?s[\])]?)?",
    "x": rf"x{_UNIT}",
    "y": rf"y{_UNIT}",
}
"""What the columns of a CSV may be called, in whatever case."""
_OTHER_UNIT = re.compile(
    r"((?P<place>x|y)|time|t|timestamp)[ _]?[\[(/] *(?P<unit>[^\])]+?)[\])]?", re.IGNORECASE
)
"""A column with a unit that ``_NAMES`` does not know."""


def read_petrack(path: Path, given: Stated) -> Rows:
    """Text with the columns id, frame, x, y, and comments that may say unit and frame rate.

    Raises:
        RecordingError: see ``read_recording``.
    """
    require_whole_end(path)
    unit, fps = settle(path, petrack_header(path), given)
    assert unit is not None and fps is not None
    table = read_numbers(path, PETRACK, None)
    frames = whole(path, table["frame"], "frame")
    return Rows(
        f"PeTrack text in {unit}, {fps:g} frames a second",
        whole(path, table["id"], "id"),
        frames / fps,
        table[["x", "y"]].to_numpy() / UNITS[unit],
        frames,
        unit=unit,
    )


def petrack_header(path: Path) -> Stated:
    """What the comments say that such a text begins with."""
    unit = fps = None
    with path.open(encoding="utf-8-sig") as file:
        for line in file:
            if not line.startswith("#"):
                break
            rate = re.search(r"framerate\D*?(\d+(?:\.\d+)?)", line)
            fps = float(rate[1]) if rate and fps is None else fps
            named = re.search(r"(?:\bx/|\bin )(mm|cm|m)\b", line.lower())
            unit = named[1] if named else unit
    return Stated(unit, fps)


def read_obsmat(path: Path, given: Stated) -> Rows:
    """Annotations in metres with velocities, from which the frame rate follows.

    The source is Pellegrini et al., "You'll Never Walk Alone", ICCV 2009. Velocities are those
    from the annotation before to the one after; frames are numbered in steps.

    Args:
        path: of the file.
        given: by the user; ``fps`` are annotations a second, those of numbers will do.

    Raises:
        RecordingError: see ``read_recording``.
    """
    require_whole_end(path)
    table = read_numbers(path, {name: n for n, name in enumerate(OBSMAT)}, None)
    step, said = _step(table), _annotation_rate(table)
    rate = _settle_annotated(path, said, step, given)
    return _annotated(path, "obsmat", table, rate, step)


def read_trajnet(path: Path, given: Stated) -> Rows:
    """Tracks in metres, and scenes that say how many positions there are a second.

    The source is Kothari et al., "Human Trajectory Forecasting in Crowds", 2021; one JSON object
    a line, frames are numbered in steps.

    Args:
        path: of the file.
        given: by the user; ``fps`` are positions a second, those of numbers will do.

    Raises:
        RecordingError: see ``read_recording``.
    """
    rates: set[float] = set()
    tracks: list[tuple[float, ...]] = []
    for number, line in lines(path):
        try:
            entry: dict[str, Any] = json.loads(line)
            if "track" in entry:
                track = entry["track"]
                tracks.append(tuple(float(track[key]) for key in ("p", "f", "x", "y")))
            elif "fps" in entry["scene"]:
                rates.add(float(entry["scene"]["fps"]))
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise RecordingError(
                f"{path}: line {number}: expected a track with p, f, x, y or a scene, as TrajNet++ "
                f"has them, not {short(line)}"
            ) from error
    if len(rates) > 1:
        told = ", ".join(f"{rate:g}" for rate in sorted(rates))
        raise RecordingError(f"{path}: its scenes have different frame rates: {told}")
    table = pd.DataFrame(tracks, columns=["id", "frame", "x", "y"], dtype="float64")
    step = _step(table)
    rate = _settle_annotated(path, rates.pop() if rates else None, step, given)
    return _annotated(path, "TrajNet++ ndjson", table, rate, step)


def read_csv(path: Path, given: Stated) -> Rows:
    """Columns id, frame or time [s], x and y, named in the first line; others are left out.

    Raises:
        RecordingError: see ``read_recording``.
    """
    header = next(lines(path))[1]
    separator = csv_separator(header)
    assert separator is not None
    places, units = _columns(path, header.split(separator))
    # Times say what a frame rate would, so that none is asked for.
    timed = "time" in places
    if timed and given.fps is not None:
        raise RecordingError(f"{path}: it has times, so no fps can be given")
    fps = 1.0 if timed else None
    unit, fps = settle(path, Stated(units.pop() if units else None, fps), given)
    assert unit is not None and fps is not None
    table = read_numbers(path, places, separator)
    frames = whole(path, table["frame"], "frame") if "frame" in places else None
    if timed:
        times = table["time"].to_numpy()
    else:
        assert frames is not None
        times = frames / fps
    positions = table[["x", "y"]].to_numpy() / UNITS[unit]
    kind = f"CSV in {unit}"
    return Rows(kind, whole(path, table["id"], "id"), times, positions, frames, unit=unit)


def csv_separator(header: str) -> str | None:
    """What is between the names of columns; None if a line does not look like some."""
    found = [mark for mark in ",;\t" if mark in header]
    return found[0] if found and not is_number(header.split(found[0])[0]) else None


def _columns(path: Path, names: list[str]) -> tuple[dict[str, int], set[str]]:
    """Where the columns of a CSV are, and the units that their names have."""
    places: dict[str, int] = {}
    units: set[str] = set()
    for place, name in enumerate(names):
        for key, form in _NAMES.items():
            found = re.fullmatch(form, name.strip().strip('"').lower())
            if found and key in places:
                raise RecordingError(f"{path}: two columns for {key}")
            if found:
                places[key] = place
                units |= {unit for unit in [found.groupdict().get("unit")] if unit}
    lacking = [key for key in ("id", "x", "y") if key not in places]
    lacking += [] if {"time", "frame"} & places.keys() else ["time or frame"]
    for name in names if lacking else ():
        other = _OTHER_UNIT.fullmatch(name.strip().strip('"'))
        if other:
            raise RecordingError(
                f"{path}: column {short(name.strip())}: the unit {short(other['unit'])}; allowed: "
                f"{'m, cm or mm' if other['place'] else 's'}"
            )
    if lacking:
        got = ", ".join(name.strip() for name in names)
        raise RecordingError(f"{path}: no column {' and no '.join(lacking)}; there are: {got}")
    if len(units) > 1:
        raise RecordingError(
            f"{path}: x and y are in different units, {' and '.join(sorted(units))}"
        )
    return places, units


def _step(table: pd.DataFrame) -> float:
    """Between the numbers of two frames in which somebody is seen, as a rule."""
    table = table.sort_values(["id", "frame"])
    steps = np.diff(table["frame"])[np.diff(table["id"]) == 0]
    steps = steps[steps > 0]  # an id that is there twice is refused later, by its frame
    return float(np.median(steps)) if len(steps) else 1.0


def _annotation_rate(table: pd.DataFrame) -> float | None:
    """Annotations a second, by positions and velocities; None if those do not agree."""
    table = table.sort_values(["id", "frame"])
    position, velocity = table[["x", "y"]].to_numpy(), table[["vx", "vy"]].to_numpy()[1:-1]
    regular = (np.diff(table["id"]) == 0) & (np.diff(table["frame"]) == _step(table))
    usable = regular[1:] & regular[:-1] & (np.linalg.norm(velocity, axis=1) > 0.1)
    if not usable.any():
        return None
    way, velocity = (position[2:] - position[:-2])[usable], velocity[usable]
    periods = (way * velocity).sum(axis=1) / (velocity**2).sum(axis=1) / 2
    low, period, high = np.percentile(periods, [25, 50, 75])
    agree = 0 < high - low + 1e-9 < 0.05 * period
    return float(f"{1 / period:.4g}") if agree else None


def _settle_annotated(path: Path, said: float | None, step: float, given: Stated) -> float:
    """Annotations a second."""
    also = () if said is None else (said * step,)
    rate = settle(path, Stated("m", said), given, fps_too=also).fps
    assert rate is not None
    return rate


def _annotated(path: Path, kind: str, table: pd.DataFrame, rate: float, step: float) -> Rows:
    frames = whole(path, table["frame"], "frame")
    return Rows(
        f"{kind}, {rate:g} annotations a second",
        whole(path, table["id"], "person"),
        frames / (rate * step),
        table[["x", "y"]].to_numpy(),
        frames,
    )
