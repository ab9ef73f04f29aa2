"""Layouts where regions and walls say who begins where: on maps, and with ``robots.start``."""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.scenario import Scenario, ScenarioError
from crowdbench.scenario.places import Point
from crowdbench.scenario.room import ends_gap, passage, robot_radius
from crowdbench.simulation.ends import named, require_apart, require_off_queues
from crowdbench.simulation.ground import Ground, Mask, Spots
from crowdbench.simulation.vacancy import is_off_discs
from crowdbench.simulation.walls import walls_of
from crowdbench.simulation.ways import Ways

WALL_CLEARANCE = 0.1
"""Least gap from the circle around a robot's footprint to a wall, on its route and at its ends
[m]."""
OBSTACLE_FIELDS = "obstacles.count or obstacles.radius"
"""What decides whether obstacles find a place."""
_BATCH, _BATCHES = 64, 20


class NoPlaceError(Exception):
    """A robot, an obstacle or a pedestrian found no place this time.

    Attributes:
        fields: of the scenario that decide it.
    """

    def __init__(self, message: str, fields: str) -> None:
        """Say who, and what decides it."""
        super().__init__(message)
        self.fields = fields


class CrowdedError(NoPlaceError):
    """Of a pedestrian, once robots and obstacles had theirs."""


@dataclass(frozen=True)
class Places:
    """What all episodes of such a scenario share.

    Attributes:
        scenario: whose.
        ground: where there is room.
        walls: (S, 4) x1, y1, x2, y2 [m].
        ways: of a robot among the walls, at a distance of ``robot_clearance``.
        starts, goals, people, obstacles: where each may be.
        room: cells in which people have room.
    """

    scenario: Scenario
    ground: Ground
    walls: NDArray[np.float64]
    ways: Ways
    starts: Spots
    goals: Spots
    people: Spots
    obstacles: Spots
    room: Mask

    def draw_robots(
        self, rng: np.random.Generator, avoided: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Poses (R, 3) and goals (R, 2), a robot's diameter and tolerance apart; faces roughly
        along the way. None of them lies within a disc of ``avoided`` (N, 3).

        Raises:
            NoPlaceError: one found no place.
        """
        robots = self.scenario.robots
        gap = ends_gap(robots)
        ends = np.empty((0, 2))
        poses, goals = np.empty((robots.count, 3)), np.empty((robots.count, 2))
        for r in range(robots.count):
            for _ in range(_BATCH):
                start, goal = self.starts.draw(rng, 1)[0], self.goals.draw(rng, 1)[0]
                turn = rng.uniform(-math.pi / 6, math.pi / 6)
                if not (_is_clear(start, avoided) and _is_clear(goal, avoided)):
                    continue
                if _apart(start, np.vstack([ends, goal]), gap) and _apart(goal, ends, gap):
                    way = self.ways.path(start, goal)
                    if len(way):
                        break
            else:
                raise NoPlaceError(
                    f"robot {r + 1} of {robots.count} found no place",
                    robot_fields(self.scenario, "robots.start, robots.goal"),
                )
            x, y = (way[1] - start).tolist()
            poses[r], goals[r] = [*start, math.atan2(y, x) + turn], goal
            ends = np.vstack([ends, start, goal])
        return poses, goals

    def draw_obstacles(
        self, rng: np.random.Generator, keep_free: NDArray[np.float64], clearance: float
    ) -> NDArray[np.float64]:
        """(K, 3) round obstacles past which everybody can walk on either side.

        Args:
            rng: where draws come from.
            keep_free: (N, 2) places [m] from which all stay ``clearance`` [m] away.
            clearance: surface to place [m].

        Raises:
            NoPlaceError: one found no place.
        """
        settings, gap = self.scenario.obstacles, passage(self.scenario.robots)
        obstacles = np.empty((0, 3))
        kept = np.column_stack([keep_free, np.full(len(keep_free), clearance)])
        for k in range(settings.count):
            radius = rng.uniform(*settings.radius)
            taken = np.vstack([kept, obstacles + np.array([0.0, 0.0, gap]), [0.0, 0.0, radius]])
            if not _place_discs(rng, self.obstacles, taken, len(taken) - 1):
                raise NoPlaceError(
                    f"obstacle {k + 1} of {settings.count} found no place", OBSTACLE_FIELDS
                )
            obstacles = np.vstack([obstacles, taken[-1]])
        return obstacles

    def place_people(self, rng: np.random.Generator, discs: NDArray[np.float64], fixed: int) -> int:
        """Place all but the first ``fixed`` of ``discs`` (N, 3), one after another.

        Returns:
            How many have their place; x and y are written.
        """
        return _place_discs(rng, self.people, discs, fixed)

    def check_ways(
        self,
        poses: NDArray[np.float64],
        goals: NDArray[np.float64],
        standing: NDArray[np.float64],
    ) -> None:
        """See that robots and streams get past people who stand.

        Args:
            poses, goals: of the robots, (R, 3) and (R, 2) [m, rad].
            standing: (N, 3) x, y, radius [m].

        Raises:
            NoPlaceError: somebody shuts one of them in.
        """
        areas = self.ground.connected(robot_clearance(self.scenario), standing)
        for start, goal in zip(poses[:, :2].tolist(), goals.tolist(), strict=True):
            if not _are_joined(areas, self.ground.at(tuple(start)), self.ground.at(tuple(goal))):
                raise NoPlaceError("standing people shut a robot in", "pedestrians.standing")
        areas = self.ground.connected(self.scenario.pedestrians.radii[1], standing)
        for stops in self._stops:
            if not all(_are_joined(areas, *ends) for ends in itertools.pairwise(stops)):
                raise NoPlaceError("standing people shut a stream in", "pedestrians.standing")

    @cached_property
    def _stops(self) -> list[list[Mask]]:
        """Cells of the regions on the way of each stream."""
        regions = self.scenario.arena.regions
        return [
            [self.ground.within(regions[name]) for name in (one.start, *one.via, one.goal)]
            for one in self.scenario.pedestrians.streams
        ]

    def are_beside(
        self, place: NDArray[np.float64], others: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """(K,) whether people have room at places (K, 2), with no wall between these and one (2,).

        All in [m].
        """
        free = self.ground.holds(self.room, others)
        first, last = self.walls[:, :2] - place, self.walls[:, 2:] - place
        to = (others - place)[:, None]
        side = _cross(to, first) * _cross(to, last)
        along = _cross(last - first, -first) * _cross(last - first, to - first)
        return free & ~((side <= 0) & (along <= 0)).any(axis=1)


def _are_joined(areas: NDArray[np.int32], some: Mask, others: Mask) -> bool:
    """Whether a way leads from one of some cells to one of others."""
    shared = np.intersect1d(areas[some], areas[others])
    return bool((shared > 0).any())


def robot_fields(scenario: Scenario, where: str) -> str:
    """What decides whether robots find a place, beside the fields that say where."""
    fields = [where, "robots.goal_tolerance"]
    if scenario.robots.count > 1:
        fields.append("robots.count")
    if scenario.pedestrians.queues:
        fields += ["pedestrians.queues", "pedestrians.spawn_clearance"]
    return f"{', '.join(fields[:-1])} or {fields[-1]}"


def robot_clearance(scenario: Scenario) -> float:
    """Least distance of a robot's centre from walls on its route [m]."""
    return robot_radius(scenario.robots) + WALL_CLEARANCE


_recent: deque[Places] = deque(maxlen=4)
"""Places found last: who has checked a scenario begins an episode of it next."""


def places_of(scenario: Scenario) -> Places | None:
    """Where everybody may begin; None where no region says so.

    Raises:
        ScenarioError: a region has no room, or no way leads from start to goal; the message names
            the field and what is allowed.
    """
    robots, people = scenario.robots, scenario.pedestrians
    if robots.start is None or robots.goal is None:
        return None
    for known in _recent:
        if known.scenario is scenario:
            return known
    clearance = robot_clearance(scenario)
    at_goal = max(clearance, robots.goal_tolerance)  # so that no goal is reached through a wall
    beside = scenario.obstacles.radius[1] + passage(robots)
    walls = walls_of(scenario)
    ground = Ground(scenario.arena, walls, max(at_goal, people.radii[1], beside))
    narrowest = min(robots.length, robots.width)
    ways = Ways(walls, np.empty((0, 3)), clearance, scenario.arena.bounds, narrowest)
    starts = _room_for(scenario, ground, ways, "start", robots.start, clearance)
    goals = _room_for(scenario, ground, ways, "goal", robots.goal, at_goal)
    areas = ground.connected(clearance)
    shared = np.intersect1d(areas[starts], areas[goals])
    shared = shared[shared > 0]
    reachable = np.isin(areas, shared)
    starts, goals = starts & reachable, goals & reachable
    first = _spots(ground, robots.start, starts)
    last = _spots(ground, robots.goal, goals)
    if not (starts.any() and goals.any() and _has_way(ways, first, last)):
        raise ScenarioError(
            f"scenario {scenario.name!r}: robots.goal: no way leads to {named(robots.goal)} from "
            f"{named(robots.start)} (robots.start); allowed: passages at least "
            f"{ground.joining(clearance):.2f} m wide, for the circle around the robot"
        )
    require_off_queues(scenario, "start", robots.start, first)
    require_off_queues(scenario, "goal", robots.goal, last)
    require_apart(scenario, first, last)
    walkable = ground.connected(people.radii[1])
    met = np.unique(walkable[starts | goals])
    room = ground.free(people.radii[1]) & np.isin(walkable, met[met > 0])
    if people.count and not room.any():
        raise ScenarioError(
            f"scenario {scenario.name!r}: pedestrians.radius: {people.radii[1]:g} m leaves no room "
            "where robots drive; allowed: less, or more room between walls"
        )
    places = Places(
        scenario=scenario,
        ground=ground,
        walls=walls,
        ways=ways,
        starts=first,
        goals=last,
        people=ground.spots(room),
        obstacles=ground.spots(ground.free(beside)),
        room=room,
    )
    _recent.append(places)
    return places


def _room_for(
    scenario: Scenario, ground: Ground, ways: Ways, field: str, place: str | Point, clearance: float
) -> Mask:
    """Cells in which a robot may begin or end; those around it for a point.

    Raises:
        ScenarioError: there are none.
    """
    where = f"scenario {scenario.name!r}: robots.{field}"
    if not isinstance(place, str):
        cells = ground.at(place)
        widest = ground.gap[cells].max(initial=0.0)
        if widest < clearance - ground.side or not ways.is_free(np.array(place)):
            raise ScenarioError(
                f"{where}: {named(place)} is too near to a wall, a polygon or the border; "
                f"allowed: at least {clearance:.2f} m away"
            )
        return cells
    region = scenario.arena.regions[place]
    cells = ground.within(region) & ground.free(clearance)
    if not cells.any():
        raise ScenarioError(
            f"{where}: the region {place!r} has no room for a robot; allowed: with a place in it, "
            f"{ground.holding:.2f} m wide, at least {clearance:.2f} m from walls, polygons and the "
            "border"
        )
    return cells


def _spots(ground: Ground, place: str | Point, cells: Mask) -> Spots:
    return ground.spots(cells) if isinstance(place, str) else Spots(np.array([place]), 0.0)


def _has_way(ways: Ways, starts: Spots, goals: Spots) -> bool:
    """Whether a way leads from one of some starts to one of some goals."""
    rng = np.random.default_rng(0)
    pairs = zip(starts.draw(rng, _BATCH), goals.draw(rng, _BATCH), strict=True)
    return any(len(ways.path(start, goal)) for start, goal in pairs)


def _apart(place: NDArray[np.float64], others: NDArray[np.float64], gap: float) -> bool:
    """Whether a place (2,) is at least ``gap`` [m] from all others (N, 2)."""
    dx, dy = (others - place).T
    return bool((np.sqrt(dx * dx + dy * dy) > gap).all())


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _is_clear(place: NDArray[np.float64], discs: NDArray[np.float64]) -> bool:
    """Whether a place (2,) lies within none of some discs (N, 3)."""
    dx, dy = (discs[:, :2] - place).T
    return bool((np.sqrt(dx * dx + dy * dy) > discs[:, 2]).all())


def _place_discs(
    rng: np.random.Generator, spots: Spots, discs: NDArray[np.float64], fixed: int
) -> int:
    """Place all but the first ``fixed`` of ``discs`` (N, 3) in spots, without overlap.

    Each takes the first free place of a batch, or of up to as many batches as are tried.

    Returns:
        How many have their place; x and y are written.
    """
    placed, failures, count = 0, 0, len(discs) - fixed
    while placed < count and failures < _BATCHES and len(spots.corner):
        draws = rng.random((min(count - placed, _BATCHES - failures), 3 * _BATCH))
        placed, failures = _fill(draws, spots.corner, spots.side, discs, fixed, placed, failures)
    return placed


@compiled()
def _fill(
    draws: NDArray[np.float64],
    corner: NDArray[np.float64],
    side: float,
    discs: NDArray[np.float64],
    fixed: int,
    placed: int,
    failures: int,
) -> tuple[int, int]:
    """Place discs by batches of draws in [0, 1); returns ``placed`` and ``failures`` after them."""
    for batch in range(len(draws)):
        last = fixed + placed
        failures += 1
        for k in range(draws.shape[1] // 3):
            which = int(draws[batch, 3 * k] * len(corner))
            x = corner[which, 0] + side * draws[batch, 3 * k + 1]
            y = corner[which, 1] + side * draws[batch, 3 * k + 2]
            if is_off_discs(x, y, discs, last):
                discs[last, 0], discs[last, 1] = x, y
                placed += 1
                failures = 0
                break
    return placed, failures
