"""Guidance: on a map, robots are led along the shortest path, as a route planner would.

The path keeps ``map_layout.robot_clearance`` from the walls; obstacles, which are drawn anew for
every episode, are not on the map. What a robot observes as its goal is a point on the path from
where it is: at most ``robots.look_ahead`` ahead, and no farther than it could go straight, with
the circle around its footprint. Progress is counted along the path.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.scenario import Scenario
from crowdbench.simulation.clearance import sees
from crowdbench.simulation.lanes import SUCCESS
from crowdbench.simulation.map_layout import WALL_CLEARANCE, Places, places_of
from crowdbench.simulation.ways import next_point

_HALVINGS = 6
"""By which the farthest point in sight is found on a straight part of a path."""

Lanes = NDArray[np.int64]


class Guidance:
    """Paths of the robots in many lanes; L lanes, R robots in each.

    Attributes:
        remaining: (L, R) from each robot to its goal along the path [m].
    """

    def __init__(self, lanes: int, scenarios: Sequence[Scenario]) -> None:
        """Make room for the paths of any of the scenarios in every lane.

        Raises:
            ScenarioError: the places of one cannot be; see ``places_of``.
        """
        found = [places_of(scenario) for scenario in scenarios]
        most = max((len(places.ways.network.nodes) for places in found if places), default=0)
        robots = scenarios[0].robots.count
        self._places = [places for places in found if places and _leads(places)]
        self._arrays = [_arrays(places) for places in self._places]
        self._which = np.full(lanes, -1)  # of these, -1 for none
        self._lengths = np.empty((lanes, robots, most))
        self.remaining = np.zeros((lanes, robots))
        self._before = np.zeros((lanes, robots))

    def begin(self, lane: int, places: Places | None, robots: NDArray[np.void]) -> None:
        """Begin an episode in a lane.

        Args:
            lane: which.
            places: of its scenario.
            robots: (L, R) records ROBOT, where the episode begins.
        """
        self._which[lane] = -1
        if places is None or not _leads(places):
            return
        which = [one.scenario is places.scenario for one in self._places].index(True)
        self._which[lane] = which
        for r, goal in enumerate(robots["goal"][lane]):
            lengths = places.ways.remaining(goal)
            self._lengths[lane, r, : len(lengths)] = lengths
        first = np.array([lane])
        _lead(first, robots, self._lengths, self.remaining, _UNSEEN, *self._arrays[which])
        self._before[lane] = self.remaining[lane]

    def observe(self, lanes: Lanes, robots: NDArray[np.void], seen: NDArray[np.float32]) -> None:
        """Write the points ahead into ``seen``, in the place of goals."""
        for arrays, which in self._groups(lanes):
            _lead(which, robots, self._lengths, self.remaining, seen, *arrays)

    def judge(self, lanes: Lanes, worlds: NDArray[np.void], robots: NDArray[np.void]) -> None:
        """Count progress along the path in the reward terms of a step that has been judged."""
        for _, which in self._groups(lanes):
            _count_progress(which, worlds, robots, self.remaining, self._before)

    def _groups(self, lanes: Lanes) -> list[tuple[tuple[Any, ...], Lanes]]:
        """Lanes with paths, by the map that they share: as ``_arrays`` gives it."""
        which = self._which[lanes]
        found = set(which.tolist())
        if len(found) == 1:  # nearly always, and dearer to find out once more with masks
            return [(self._arrays[i], lanes) for i in found if i >= 0]
        return [(self._arrays[i], lanes[which == i]) for i in sorted(found - {-1})]


def _leads(places: Places) -> bool:
    """Whether robots are led along paths, and not only placed by them."""
    return places.scenario.arena.kind == "map"


_UNSEEN = np.empty((0, 0, 0), dtype=np.float32)


def _arrays(places: Places) -> tuple[Any, ...]:
    """Of the ways among a map's walls, as ``_lead`` takes them."""
    network, look_ahead = places.ways.network, places.scenario.robots.look_ahead
    return network, network.reach - WALL_CLEARANCE, look_ahead


@compiled()
def _lead(lanes, robots, lengths, remaining, seen, network, sight, look_ahead):  # type: ignore[no-untyped-def]
    """Write what remains of the active robots' paths, and the points ahead into ``seen``.

    Where no path leads on, since something has pushed the robot, what remains stays as it was, and
    the goal itself is seen.

    Args:
        lanes: (M,) which, all on the same map.
        robots, lengths, remaining: of all lanes.
        seen: of all lanes; with none nothing is seen.
        network: of the ways on the map.
        sight: (M,) distance to keep from each core on the straight way to the point ahead [m].
        look_ahead: [m].
    """
    for i in range(len(lanes)):
        lane = lanes[i]
        for r in range(robots.shape[1]):
            robot, left = robots[lane, r], lengths[lane, r, : len(network.nodes)]
            if not robot.active:
                continue
            x, y = robot.pose[0], robot.pose[1]
            goal_x, goal_y = robot.goal[0], robot.goal[1]
            next_x, next_y, whole = next_point(x, y, goal_x, goal_y, left, network)
            if whole == math.inf:
                continue
            remaining[lane, r] = whole
            if len(seen) == 0:
                continue
            x, y = _point_ahead(
                x, y, next_x, next_y, goal_x, goal_y, left, network, sight, look_ahead
            )
            x, y = x - robot.pose[0], y - robot.pose[1]
            cosine, sine = math.cos(robot.pose[2]), math.sin(robot.pose[2])
            seen[lane, r, 2], seen[lane, r, 3] = cosine * x + sine * y, cosine * y - sine * x


@compiled()
def _point_ahead(  # type: ignore[no-untyped-def]
    x, y, next_x, next_y, goal_x, goal_y, lengths, network, sight, look_ahead
):
    """The farthest point in sight within ``look_ahead`` of a path, whose first turn is known."""
    begin_x, begin_y = x, y
    while True:
        dx, dy = next_x - begin_x, next_y - begin_y
        length = math.sqrt(dx * dx + dy * dy)
        share = 1.0 if length <= look_ahead else look_ahead / length
        end_x, end_y = begin_x + share * dx, begin_y + share * dy
        if (begin_x != x or begin_y != y) and not sees(
            x, y, end_x, end_y, network.cores, sight, 1.0
        ):
            low = 0.0
            for _ in range(_HALVINGS):
                middle = 0.5 * (low + share)
                end_x, end_y = begin_x + middle * dx, begin_y + middle * dy
                if sees(x, y, end_x, end_y, network.cores, sight, 1.0):
                    low = middle
                else:
                    share = middle
            return begin_x + low * dx, begin_y + low * dy
        look_ahead -= length
        if look_ahead <= 0.0 or (next_x == goal_x and next_y == goal_y):
            return end_x, end_y
        begin_x, begin_y = next_x, next_y
        next_x, next_y, whole = next_point(begin_x, begin_y, goal_x, goal_y, lengths, network)
        if whole == math.inf or (next_x == begin_x and next_y == begin_y):
            return begin_x, begin_y


@compiled()
def _count_progress(lanes, worlds, robots, remaining, before):  # type: ignore[no-untyped-def]
    """Replace progress as the crow flies by that along the path; arrivals stay."""
    for i in range(len(lanes)):
        lane = lanes[i]
        for r in range(robots.shape[1]):
            robot = robots[lane, r]
            if robot.active:
                if robot.outcome != SUCCESS:
                    gained = before[lane, r] - remaining[lane, r]
                    robot.terms[0] = worlds[lane].progress * gained
                before[lane, r] = remaining[lane, r]
