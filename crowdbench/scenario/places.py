"""Points, walls, polygons and regions as a scenario file writes them, checked one by one."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator

from crowdbench.messages import Form, setting

FARTHEST = 10_000
"""Of a coordinate from the origin [m]."""
MOST_EDGES = 2_000
"""Walls and edges of polygons on a map."""
MOST_REGIONS = 100
_NAME = re.compile(r"[A-Za-z0-9_-]{1,100}")

Point = tuple[float, float]
Box = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max [m]"""


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, (str, bytes))


def _is_number(value: Any) -> bool:
    # The bound comes before anything that a number of 400 digits would break.
    return isinstance(value, (int, float)) and not isinstance(value, bool) and _is_near(value)


def _is_near(value: float) -> bool:
    return -FARTHEST <= value <= FARTHEST


def _numbers(value: Any, count: int) -> tuple[float, ...] | None:
    if not (_is_list(value) and len(value) == count and all(map(_is_number, value))):
        return None
    return tuple(map(float, value))


def _point(value: Any) -> Any:
    point = _numbers(value, 2)
    if point is None:
        raise ValueError(f"{setting(value)} is no point; allowed: two numbers [x, y] (m)")
    return point


def _walls(value: Any) -> Any:
    if not _is_list(value):
        raise ValueError(f"{setting(value)}; allowed: a list of walls [x1, y1, x2, y2] (m)")
    walls = []
    for number, item in enumerate(value, 1):
        wall = _numbers(item, 4)
        if wall is None or wall[:2] == wall[2:]:
            raise ValueError(
                f"wall {number} is {setting(item)}; allowed: four numbers [x1, y1, x2, y2] (m), "
                "its two ends apart"
            )
        walls.append(wall)
    return tuple(walls)


def _polygons(value: Any) -> Any:
    if not _is_list(value):
        raise ValueError(f"{setting(value)}; allowed: a list of polygons [[x, y], ...] (m)")
    return tuple(_polygon(item, f"polygon {number}") for number, item in enumerate(value, 1))


def _polygon(value: Any, name: str) -> tuple[Point, ...]:
    """Corners, the first not repeated; neighbours are joined by edges, and the last to the first.

    Raises:
        ValueError: not a list of points, or a line that encloses nothing or crosses itself.
    """
    corners = [_numbers(item, 2) for item in value] if _is_list(value) else [None]
    if None in corners:
        raise ValueError(f"{name} is {setting(value)}; allowed: a list of corners [x, y] (m)")
    ring: list[Point] = [(corner[0], corner[1]) for corner in corners if corner is not None]
    if len(ring) > 1 and ring[0] == ring[-1]:
        ring.pop()
    if len(ring) < 3:
        raise ValueError(
            f"{name} is open, a line of {len(ring)} points; allowed: at least 3 corners that "
            "enclose something (lines are arena.walls)"
        )
    import shapely  # here, since few scenarios have polygons

    outline = shapely.Polygon(ring)
    if not outline.is_valid:
        reason = shapely.is_valid_reason(outline)
        where = re.search(r"\[(\S+) (\S+)\]", reason)
        place = f" at ({float(where[1]):g}, {float(where[2]):g})" if where else ""
        raise ValueError(
            f"{name} crosses or touches itself{place}; allowed: edges that meet at corners only"
        )
    return tuple(ring)


def _regions(value: Any) -> Any:
    if not isinstance(value, dict):
        raise ValueError(
            f"{setting(value)}; allowed: a section of `name: [x_min, y_min, x_max, y_max]` or "
            "`name: [[x, y], ...]` lines (m)"
        )
    if len(value) > MOST_REGIONS:
        raise ValueError(f"{len(value)} regions; allowed: {MOST_REGIONS}")
    regions: dict[str, Any] = {}
    for name, item in value.items():
        if not (isinstance(name, str) and _NAME.fullmatch(name)):
            raise ValueError(
                f"the name {setting(name)}; allowed: 1 to 100 letters, digits, _ and -"
            )
        rectangle = _numbers(item, 4)
        if rectangle is None:
            if not _is_list(item) or not any(map(_is_list, item)):
                raise ValueError(
                    f"{name} is {setting(item)}; allowed: a rectangle [x_min, y_min, x_max, y_max] "
                    "or the corners [[x, y], ...] of a polygon (m)"
                )
            regions[name] = _polygon(item, name)
            continue
        if not (rectangle[0] < rectangle[2] and rectangle[1] < rectangle[3]):
            raise ValueError(
                f"{name} is {setting(item)}; allowed: [x_min, y_min, x_max, y_max] with "
                "x_min < x_max and y_min < y_max (m)"
            )
        regions[name] = rectangle
    return regions


def _place(value: Any) -> Any:
    if value is None or (isinstance(value, str) and _NAME.fullmatch(value)):
        return value
    point = _numbers(value, 2)
    if point is None:
        raise ValueError(
            f"{setting(value)}; allowed: the name of a region of arena.regions, a point [x, y] "
            "(m), or null"
        )
    return point


Centre = Annotated[Point, BeforeValidator(_point), Form("a point [x, y]")]
Walls = Annotated[
    tuple[Box, ...], BeforeValidator(_walls), Form("a list of walls [x1, y1, x2, y2]")
]
Polygons = Annotated[
    tuple[tuple[Point, ...], ...],
    BeforeValidator(_polygons),
    Form("a list of polygons [[x, y], ...]"),
]
Region = Box | tuple[Point, ...]
Regions = Annotated[
    dict[str, Region], BeforeValidator(_regions), Form("a section of `name: region` lines")
]
Place = Annotated[
    str | Point | None, BeforeValidator(_place), Form("the name of a region, or a point [x, y]")
]


def corners(region: Region) -> tuple[Point, ...]:
    """Of a rectangle or a polygon, in order [m]."""
    if isinstance(region[0], tuple):
        return region
    x_min, y_min, x_max, y_max = region
    return ((x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max))


def outside(points: Sequence[Point], bounds: Box) -> str:
    """Which of the points lies outside, and what is allowed; empty where none does."""
    slack = 1e-9 * (1 + max(map(math.fabs, bounds)))
    for x, y in points:
        if not (
            bounds[0] - slack <= x <= bounds[2] + slack
            and bounds[1] - slack <= y <= bounds[3] + slack
        ):
            return (
                f"({x:g}, {y:g}) lies outside the area; allowed: x from {bounds[0]:g} to "
                f"{bounds[2]:g} and y from {bounds[1]:g} to {bounds[3]:g} m"
            )
    return ""
