"""What a scenario says about its place has to hold together: walls, regions, start and goal."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench.messages import nearest, quoted, short
from crowdbench.scenario.images import read_map
from crowdbench.scenario.places import MOST_EDGES, Place, corners, outside
from crowdbench.scenario.room import ends_gap, rounded_up

if TYPE_CHECKING:
    from crowdbench.scenario.model import Scenario
    from crowdbench.scenario.sections import Arena


def with_image(arena: dict[str, Any]) -> dict[str, Any]:
    """The same section with what its image shows in the image's place.

    Raises:
        ValueError: the image cannot be used; the message names it and what is allowed.
    """
    image = arena.get("image")
    if not isinstance(image, str):
        return arena
    if arena.get("kind") != "map":
        raise ValueError(f"arena.image: {quoted(image)}; allowed: with arena.kind map")
    try:
        found = read_map(Path(image))
    except ValueError as error:
        raise ValueError(f"arena.image: {error}") from error
    own = arena.get("polygons", ())
    shown = found.pop("polygons")
    both = [*own, *shown] if isinstance(own, (list, tuple)) else own
    return {**arena, **found, "polygons": both, "image": None}


def misplaced(scenario: Scenario) -> str:
    """Which field does not fit the others, with what is allowed; empty where all do."""
    arena, robots = scenario.arena, scenario.robots
    return (
        _foreign(arena)
        or _regions_outside(arena)
        or _unknown_end(scenario, "start", robots.start)
        or _unknown_end(scenario, "goal", robots.goal)
        or _ends_together(scenario)
    )


def unknown_region(name: str, arena: Arena) -> str:
    """What is wrong with a name that should be a region's; empty where nothing is."""
    if name in arena.regions:
        return ""
    known = nearest(name, list(arena.regions)) if arena.regions else "; arena.regions has none"
    return f"unknown region {short(name)}{known}"


def _foreign(arena: Arena) -> str:
    for field in ("walls", "polygons", "centre"):
        if arena.kind != "map" and getattr(arena, field) != type(arena).model_fields[field].default:
            return f"arena.{field}: arena.kind is {arena.kind!r}; allowed: with arena.kind map"
    edges = len(arena.walls) + sum(map(len, arena.polygons))
    if edges > MOST_EDGES:
        return (
            f"arena.polygons: {edges:,} edges with arena.walls; allowed: {MOST_EDGES:,} (an image "
            "without specks and of a coarser resolution has fewer)"
        )
    return ""


def _regions_outside(arena: Arena) -> str:
    for name, region in arena.regions.items():
        if problem := outside(corners(region), arena.bounds):
            return f"arena.regions.{name}: {problem}"
    return ""


def _unknown_end(scenario: Scenario, field: str, place: Place) -> str:
    problem = ""
    if isinstance(place, str):
        problem = unknown_region(place, scenario.arena)
    elif place is not None:
        problem = outside([place], scenario.arena.bounds)
        if not problem and scenario.robots.count > 1:
            problem = (
                f"a point for {scenario.robots.count} robots; allowed: a region of arena.regions"
            )
    elif scenario.arena.kind == "map" and not scenario.pedestrians.recording.file:
        problem = "null; allowed on a map: a region of arena.regions or a point [x, y] (m)"
    return f"robots.{field}: {problem}" if problem else ""


def _ends_together(scenario: Scenario) -> str:
    robots = scenario.robots
    start, goal = robots.start, robots.goal
    if (start is None) != (goal is None):
        missing = "start" if start is None else "goal"
        return f"robots.{missing}: null; allowed: robots.start and robots.goal, or neither"
    if start is not None and start == goal:
        return f"robots.goal: {short(goal)} is robots.start too; allowed: another region or point"
    if isinstance(start, tuple) and isinstance(goal, tuple):
        apart, gap = math.dist(start, goal), ends_gap(robots)
        if apart <= gap:
            return (
                f"robots.goal: ({goal[0]:g}, {goal[1]:g}) is {apart:.4g} m from robots.start; "
                f"allowed: more than {rounded_up(gap):g} m (by robots.length, robots.width and "
                "robots.goal_tolerance)"
            )
    return ""
