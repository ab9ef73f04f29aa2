"""Whether people fit together: who queues or stands, and whether there is room for it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from crowdbench.scenario.room import queue_gap, rounded_up
from crowdbench.scenario.streams import stream_sizes

if TYPE_CHECKING:
    from crowdbench.scenario.model import Scenario

_ROUNDING = 1e-9


def misfit(scenario: Scenario) -> str:
    """Which field does not fit the others, with what is allowed; empty where all do."""
    return _too_many(scenario) or _queues_without_room(scenario) or _ends_at_queues(scenario)


def _too_many(scenario: Scenario) -> str:
    people = scenario.pedestrians
    queueing = sum(queue.count + 1 for queue in people.queues)
    if queueing > people.count:
        return (
            f"pedestrians.queues: take {queueing} people, one more than stand in each; "
            f"allowed: {people.count} (pedestrians.count)"
        )
    left = people.count - queueing
    if (walking := sum(stream_sizes(people))) > left:
        return (
            f"pedestrians.streams: the shares take {walking} of pedestrians.count {people.count} "
            f"people, but queues leave {left}; allowed: {left / people.count:.3g} in all"
        )
    standing = round(people.standing * people.count)
    for field, share, others, others_leave in (
        ("standing", people.standing, "queues and streams", left - walking),
        ("groups.share", people.groups.share, "queues and standing people", left - standing),
    ):
        taken = round(share * people.count)
        if taken > others_leave:
            return (
                f"pedestrians.{field}: {taken} of pedestrians.count {people.count} people, but "
                f"{others} leave {others_leave}; allowed: <= {others_leave / people.count:.3g}"
            )
    return ""


def _queues_without_room(scenario: Scenario) -> str:
    arena, people = scenario.arena, scenario.pedestrians
    radius, taken = people.radii[1], list[tuple[float, float]]()
    x_min, y_min, x_max, y_max = arena.bounds
    for q, queue in enumerate(people.queues):
        if queue.spacing < 2 * radius - _ROUNDING:
            return (
                f"pedestrians.queues: spacing {queue.spacing:g} m of queue {q + 1} is too little "
                f"for pedestrians.radius {radius:g} m; allowed: >= {2 * radius:g}"
            )
        for k, (x, y) in enumerate(queue.places()):
            where = f"pedestrians.queues: place {k + 1} of queue {q + 1}, ({x:.2f}, {y:.2f}), "
            beyond = max(x_min - x, x - x_max, y_min - y, y - y_max) + radius
            if beyond > _ROUNDING:
                return (
                    f"{where}lies outside the arena; allowed: x from {x_min + radius:g} to "
                    f"{x_max - radius:g}, y from {y_min + radius:g} to {y_max - radius:g}"
                )
            if any(math.dist((x, y), other) < 2 * radius - _ROUNDING for other in taken):
                return f"{where}is taken by another queue; allowed: {2 * radius:g} m away from it"
            if (gap := _wall_gap(scenario, x, y)) < radius:
                return (
                    f"{where}is {gap:.2f} m from a wall or polygon; allowed: >= {radius:g}, "
                    "and outside"
                )
        taken += queue.places()
    return ""


def _ends_at_queues(scenario: Scenario) -> str:
    """Points where a robot should begin or end, too near to people in line."""
    robots, gap = scenario.robots, queue_gap(scenario)
    for field, end in (("start", robots.start), ("goal", robots.goal)):
        if not isinstance(end, tuple):
            continue
        for q, queue in enumerate(scenario.pedestrians.queues):
            for k, place in enumerate(queue.places()):
                if (apart := math.dist(end, place)) <= gap:
                    return (
                        f"robots.{field}: ({end[0]:g}, {end[1]:g}) is {apart:.4g} m from place "
                        f"{k + 1} of queue {q + 1} (pedestrians.queues); allowed: more than "
                        f"{rounded_up(gap):g} m (by pedestrians.spawn_clearance)"
                    )
    return ""


def _wall_gap(scenario: Scenario, x: float, y: float) -> float:
    """From a place to the nearest wall or polygon of a map, 0 inside one [m]."""
    arena = scenario.arena
    if not (arena.walls or arena.polygons):
        return math.inf
    from shapely import LineString, Point, Polygon

    shapes = [LineString([wall[:2], wall[2:]]) for wall in arena.walls]
    shapes += [Polygon(polygon) for polygon in arena.polygons]
    return min(float(shape.distance(Point(x, y))) for shape in shapes)
