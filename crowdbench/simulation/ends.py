"""Ends of robots' ways: whether the places that a scenario names for them can be used at all."""

from __future__ import annotations

import math

import numpy as np

from crowdbench.scenario import Scenario, ScenarioError
from crowdbench.scenario.places import Point
from crowdbench.scenario.room import ends_gap, queue_gap, rounded_up
from crowdbench.simulation.ground import HALF_DIAGONAL, Spots
from crowdbench.simulation.traits import places_in_line


def require_off_queues(scenario: Scenario, field: str, place: str | Point, spots: Spots) -> None:
    """Refuse a start or goal of which no part is far enough from people in line.

    Raises:
        ScenarioError: it is one.
    """
    gap = queue_gap(scenario)
    middle = spots.corner + spots.side / 2
    near = np.zeros(len(middle), dtype=np.bool_)
    for x, y in places_in_line(scenario.pedestrians).tolist():
        dx, dy = (middle - (x, y)).T
        near |= np.sqrt(dx * dx + dy * dy) + HALF_DIAGONAL * spots.side <= gap
    if near.all():
        raise ScenarioError(
            f"scenario {scenario.name!r}: robots.{field}: {named(place)} has no room for a robot "
            "away from people in line (pedestrians.queues); allowed: somewhere in it more than "
            f"{rounded_up(gap):g} m from their places (by pedestrians.spawn_clearance)"
        )


def require_apart(scenario: Scenario, starts: Spots, goals: Spots) -> None:
    """Refuse a goal of which every part is too near to every start.

    Raises:
        ScenarioError: it is one.
    """
    robots, gap = scenario.robots, ends_gap(scenario.robots)
    low, high = (
        np.array([pick(spots.corner, axis=0) for spots in (starts, goals)])
        for pick in (np.min, np.max)
    )
    high += [[starts.side], [goals.side]]
    dx, dy = np.maximum(high[0] - low[1], high[1] - low[0]).tolist()
    if math.hypot(dx, dy) <= gap:
        assert robots.start is not None and robots.goal is not None
        raise ScenarioError(
            f"scenario {scenario.name!r}: robots.goal: all of {named(robots.goal)} is within "
            f"{math.hypot(dx, dy):.2f} m of {named(robots.start)} (robots.start); allowed: places "
            f"more than {rounded_up(gap):g} m apart (by robots.goal_tolerance)"
        )


def named(place: str | Point) -> str:
    """A place as messages say it."""
    return f"region {place!r}" if isinstance(place, str) else f"({place[0]:g}, {place[1]:g})"
