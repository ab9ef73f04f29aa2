"""Whether everybody can fit into a scenario at all, in closed form, before anything runs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from crowdbench.scenario.model import Scenario
    from crowdbench.scenario.sections import Arena, Robots

PASSAGE = 0.9
"""Least gap between static obstacles, and on one side of each to a wall, for people [m]."""
PASSING_MARGIN = 0.2
"""By how much that gap exceeds a robot's width at least [m]."""
FOOTPRINT_CLEARANCE = 0.3
"""Least gap from the circle around a robot's footprint to static obstacles and people who stand, at
its start and goal [m]."""
_ROUNDING = 1e-9


def robot_radius(robots: Robots) -> float:
    """Of the circle around the footprint, which a robot sweeps when it turns [m]."""
    return math.hypot(robots.length, robots.width) / 2


def passage(robots: Robots) -> float:
    """Least gap between static obstacles, and on one side of each to a wall [m]."""
    return max(PASSAGE, robots.width + PASSING_MARGIN)


def ends_gap(robots: Robots) -> float:
    """By more than which all starts and goals of robots are apart [m]."""
    return 2 * robot_radius(robots) + robots.goal_tolerance


def queue_gap(scenario: Scenario) -> float:
    """By more than which robots' starts and goals are away from people's places in line [m]."""
    people = scenario.pedestrians
    touching = robot_radius(scenario.robots) + people.radii[1]
    return touching + max(people.spawn_clearance, FOOTPRINT_CLEARANCE)


def longest_travel(arena: Arena, robots: Robots) -> float:
    """The farthest that start and goal can lie apart, each a robot's radius within the arena [m].

    Along the arena in a corridor, over its diagonal in the open; the arena has to be wide enough.
    """
    radius = robot_radius(robots)
    length, width = arena.length - 2 * radius, arena.width - 2 * radius
    return length if arena.kind == "corridor" else math.hypot(length, width)


def misfit(scenario: Scenario) -> str:
    """Which field does not fit the others, whatever the seed, with its bound; empty if none."""
    arena, robots, people = scenario.arena, scenario.robots, scenario.pedestrians
    diameter = 2 * robot_radius(robots)
    needs = [("length", diameter, "for a robot of robots.length x robots.width to turn")]
    needs += [("width", *needs[0][1:])]
    if people.count:
        across = 2 * people.radii[1]
        needs += [(side, across, "for pedestrians.radius") for side in ("length", "width")]
    if scenario.obstacles.count:
        across = 2 * scenario.obstacles.radius[0]
        beside = passage(robots) if arena.kind == "corridor" else 0.0
        needs += [("length", across, "for obstacles.radius")]
        needs += [("width", across + beside, "for obstacles.radius and a way past")]
    for side, needed, purpose in needs:
        extent = getattr(arena, side)
        if extent < needed - _ROUNDING:
            least = rounded_up(needed)
            return f"arena.{side}: {extent:g} m is too little {purpose}; allowed: >= {least:g}"
    if robots.latency >= scenario.max_steps:
        return (
            f"robots.latency: {robots.latency} control periods, and time_limit is over after "
            f"{scenario.max_steps}; allowed: <= {scenario.max_steps - 1}"
        )
    for axis, offset, side in zip("xy", scenario.lidar.mount, ("length", "width"), strict=False):
        half = getattr(robots, side) / 2
        if abs(offset) > half + _ROUNDING:
            return (
                f"lidar.mount: {axis} = {offset:g} m lies outside the footprint (robots.{side} "
                f"{2 * half:g} m); allowed: -{half:g} to {half:g}"
            )
    longest = longest_travel(arena, robots)
    if robots.start is None and robots.travel > longest + _ROUNDING:
        across = 0.0 if arena.kind == "corridor" else arena.width - diameter
        length = diameter + math.sqrt(max(0.0, robots.travel**2 - across**2))
        return (
            f"robots.travel: {robots.travel:g} m from start to goal do not fit into "
            f"{arena.length:g} x {arena.width:g} m; allowed: "
            f"<= {max(0.0, -rounded_up(-longest)):g}, or arena.length >= {rounded_up(length):g}"
        )
    return ""


def rounded_up(metres: float, per_metre: int = 1000) -> float:
    """A bound as people read it, rounded so that it is itself allowed."""
    return math.ceil((metres - _ROUNDING) * per_metre) / per_metre
