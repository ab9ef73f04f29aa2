"""Layout: where robots, obstacles and pedestrians begin, never overlapping."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.scenario import NoRoomError, Scenario
from crowdbench.scenario.room import (
    FOOTPRINT_CLEARANCE,
    ends_gap,
    passage,
    queue_gap,
    robot_radius,
)
from crowdbench.simulation import streams
from crowdbench.simulation.group_layout import place_together
from crowdbench.simulation.map_layout import (
    OBSTACLE_FIELDS,
    WALL_CLEARANCE,
    CrowdedError,
    NoPlaceError,
    Places,
    places_of,
    robot_fields,
)
from crowdbench.simulation.routes import Routes
from crowdbench.simulation.spreading import spread
from crowdbench.simulation.traits import Traits, draw_traits, places_in_line
from crowdbench.simulation.vacancy import is_off_discs
from crowdbench.simulation.walls import walls_of

if TYPE_CHECKING:
    from crowdbench.simulation.recorded import Tracks

OBSTACLE_CLEARANCE = 1.0
"""Least gap from static obstacles to a robot's start and goal, surface to centre [m]; where the
robot is large ``FOOTPRINT_CLEARANCE`` decides."""
_BATCH, _BATCHES = 64, 20
_LAYOUTS = 10
_CENTRED, _ANYWHERE, _DENSE = range(3)
"""How hard places are sought, each for several layouts: robots on opposite sides of the centre, as
a single one starts; on any line across the arena; there as near to others as they may be."""


@dataclass(frozen=True)
class Layout:
    """Initial state of an episode in the world frame.

    Attributes:
        robot_pose: (R, 3) x, y [m], heading [rad].
        robot_goal: (R, 2) [m].
        obstacles: (K, 3) x, y, radius [m].
        walls: (S, 4) x1, y1, x2, y2 [m].
        pedestrian_position: (P, 2) [m].
        pedestrian_reactive: (P,) which pedestrians are reactive, so that they see the robots.
        pedestrian_stage: (P,) regions on the way of its stream that each has passed.
        traits: what the pedestrians are like.
        tracks: by which they walk where they do so as recorded.
    """

    robot_pose: NDArray[np.float64]
    robot_goal: NDArray[np.float64]
    obstacles: NDArray[np.float64]
    walls: NDArray[np.float64]
    pedestrian_position: NDArray[np.float64]
    pedestrian_reactive: NDArray[np.bool_]
    pedestrian_stage: NDArray[np.int64]
    traits: Traits
    tracks: Tracks | None = None


def place(
    scenario: Scenario, seed: int, places: Places | None = None, routes: Routes | None = None
) -> Layout:
    """Draw a layout.

    Args:
        scenario: whose.
        seed: of the episode.
        places: of the scenario, where they are known already.
        routes: of the scenario's people, where they have any.

    Raises:
        NoRoomError: there is no room; the message says what was placed and what was not.
        ScenarioError: a region has no room, whatever the seed.
    """
    if scenario.pedestrians.recording.file:
        from crowdbench.simulation.crossing import place_crossing

        return place_crossing(scenario, seed, places or places_of(scenario))
    rng, traits = streams.layout(seed), draw_traits(scenario.pedestrians, seed)
    places = places or places_of(scenario)
    problems: list[NoPlaceError] = []
    for effort in (_CENTRED, _ANYWHERE, _DENSE):
        for _ in range(_LAYOUTS):
            try:
                return _attempt(scenario, places, routes, traits, rng, effort)
            except NoPlaceError as error:
                problems.append(error)
        if all(isinstance(problem, CrowdedError) for problem in problems):
            break  # other places for the robots leave people no more room
    arena = scenario.arena
    raise NoRoomError(
        f"scenario {scenario.name!r} has no room: {problems[-1]} "
        f"in {arena.length:g} x {arena.width:g} m with seed {seed}; "
        f"use fewer or smaller bodies, less clearance or a larger arena ({problems[-1].fields})",
        seed,
    )


def _attempt(
    scenario: Scenario,
    places: Places | None,
    routes: Routes | None,
    traits: Traits,
    rng: np.random.Generator,
    effort: int,
) -> Layout:
    around = max(OBSTACLE_CLEARANCE, robot_radius(scenario.robots) + FOOTPRINT_CLEARANCE)
    people = scenario.pedestrians
    lines = places_in_line(people)
    avoided = np.column_stack([lines, np.full(len(lines), queue_gap(scenario))])
    if places is None:
        pose, goal = _place_robots(scenario, rng, avoided, effort)
        ends = np.vstack([pose[:, :2], goal, lines])
        obstacles = _place_obstacles(scenario, rng, ends, around, effort)
    else:
        pose, goal = places.draw_robots(rng, avoided)
        obstacles = places.draw_obstacles(rng, np.vstack([pose[:, :2], goal, lines]), around)
    clearance = robot_radius(scenario.robots) + people.spawn_clearance
    taken = np.vstack([np.column_stack([pose[:, :2], np.full(len(pose), clearance)]), obstacles])
    if traits.standing.any():  # nobody stands where a robot has to go
        free = robot_radius(scenario.robots) + FOOTPRINT_CLEARANCE
        taken = np.vstack([taken, np.column_stack([goal, np.full(len(goal), free)])])
    taken = np.vstack([taken, np.column_stack([lines, traits.radius[: len(lines)]])])
    fixed = len(taken)
    order = np.arange(len(lines), people.count)
    stage = np.zeros(people.count, dtype=np.int64)
    grouped = bool((traits.group >= 0).any())
    if routes is not None and not grouped:  # those in streams first
        order = order[np.argsort(routes.member[order] < 0, kind="stable")]
    taken = np.vstack([taken, np.repeat(traits.radius[order, None], 3, axis=1)])
    half = np.array([scenario.arena.length, scenario.arena.width]) / 2 - people.radii[1]

    def place_anywhere(discs: NDArray[np.float64], first: int) -> int:
        if places is None:
            return _place_discs(rng, half, discs, first)
        return places.place_people(rng, discs, first)

    def place_one(discs: NDArray[np.float64], first: int) -> int:
        who = order[first - fixed : first - fixed + 1]
        if routes is None or routes.member[who[0]] < 0:
            return place_anywhere(discs, first)
        return spread(rng, routes, who, discs, first, stage)

    if grouped:
        is_free = places.are_beside if places else partial(_are_within, half)
        placed = place_together(rng, traits.group[order], taken, fixed, place_one, is_free)
        stage = stage[traits.first]
    else:
        placed = 0 if routes is None else spread(rng, routes, order, taken, fixed, stage)
        placed += place_anywhere(taken, fixed + placed)
    placed += len(lines)
    if placed < people.count:
        raise CrowdedError(
            f"pedestrian {placed + 1} of {people.count} found no place",
            "pedestrians.count, pedestrians.radius or pedestrians.spawn_clearance",
        )
    position = np.empty((people.count, 2))
    position[: len(lines)], position[order] = lines, taken[fixed:, :2]
    if places is not None and traits.standing.any():
        standing = np.column_stack([position, traits.radius])[traits.standing]
        places.check_ways(pose, goal, standing)
    reactive = np.zeros(people.count, dtype=np.bool_)
    reactive[rng.permutation(people.count)[: round(people.reactive * people.count)]] = True
    walls = walls_of(scenario) if places is None else places.walls
    return Layout(pose, goal, obstacles, walls, position, reactive, stage, traits)


def _are_within(
    half: NDArray[np.float64], _place: NDArray[np.float64], others: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """(K,) whether places (K, 2) lie within +/- half (2,) [m]."""
    return np.asarray((np.abs(others) <= half).all(axis=1))


def _place_robots(
    scenario: Scenario, rng: np.random.Generator, avoided: NDArray[np.float64], effort: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Starts and goals ``travel`` apart on opposite sides, headings roughly towards the goal.

    None of them lies within a disc of ``avoided`` (N, 3).
    """
    robots = scenario.robots
    gap = ends_gap(robots)
    poses, goals = np.empty((robots.count, 3)), np.empty((robots.count, 2))
    for r in range(robots.count):
        for _ in range(_BATCH if effort == _CENTRED else _BATCHES):
            ends = (
                _line(scenario, rng)[None]
                if effort == _CENTRED
                else np.array([_other_line(scenario, rng) for _ in range(_BATCH)])
            )
            nearest = np.full(len(ends), np.inf)
            if r:
                others = np.vstack([poses[:r, :2], goals[:r]])
                gaps = np.linalg.norm(ends[:, :, None] - others[None, None], axis=3)
                nearest = gaps.min(axis=(1, 2))
            free = nearest > gap
            if len(avoided):
                off = np.linalg.norm(ends[:, :, None] - avoided[:, :2], axis=3)
                free &= (off > avoided[:, 2]).all(axis=(1, 2))
            if free.any():
                break
        else:
            raise NoPlaceError(
                f"robot {r + 1} of {robots.count} found no place",
                robot_fields(scenario, "robots.travel"),
            )
        chosen = np.argmin(np.where(free, nearest, np.inf)) if effort == _DENSE else np.argmax(free)
        start, goal = ends[chosen]
        ahead = goal - start
        heading = math.atan2(ahead[1], ahead[0]) + rng.uniform(-np.pi / 6, np.pi / 6)
        poses[r], goals[r] = [*start, heading], goal
    return poses, goals


def _line(scenario: Scenario, rng: np.random.Generator) -> NDArray[np.float64]:
    """(2, 2) start and goal [m] on opposite sides of the arena's centre."""
    robots, arena = scenario.robots, scenario.arena
    radius, reach = robot_radius(robots), robots.travel / 2
    if arena.kind == "corridor":
        side = max(0.0, arena.width / 2 - 2 * radius)
        end = rng.choice([-1.0, 1.0])
        return np.array(
            [[end * reach, rng.uniform(-side, side)], [-end * reach, rng.uniform(-side, side)]]
        )
    # Directions from x towards y in which both ends lie within the arena.
    least = math.acos(min(1.0, (arena.length / 2 - radius) / reach))
    most = math.asin(min(1.0, (arena.width / 2 - radius) / reach))
    if least <= 0.0 and most >= np.pi / 2:
        angle = rng.uniform(-np.pi, np.pi)
    else:
        angle = rng.uniform(least, max(least, most)) * rng.choice([-1.0, 1.0])
    start = reach * np.array([math.cos(angle), math.sin(angle)])
    if least > 0.0 or most < np.pi / 2:
        start *= rng.choice([-1.0, 1.0])
    return np.array([start, -start])


def _other_line(scenario: Scenario, rng: np.random.Generator) -> NDArray[np.float64]:
    """(2, 2) start and goal [m] as of ``_line``, moved to anywhere in the arena."""
    arena, radius = scenario.arena, robot_radius(scenario.robots)
    line = _line(scenario, rng)
    half = np.array([arena.length, arena.width]) / 2 - radius
    if arena.kind == "open":
        return line + rng.uniform(-1.0, 1.0, 2) * np.maximum(0.0, half - np.abs(line[0]))
    along = rng.uniform(-1.0, 1.0) * max(0.0, half[0] - abs(line[0, 0]))
    side = max(0.0, half[1] - WALL_CLEARANCE)
    return np.column_stack([line[:, 0] + along, rng.uniform(-side, side, 2)])


def _place_obstacles(
    scenario: Scenario,
    rng: np.random.Generator,
    keep_free: NDArray[np.float64],
    clearance: float,
    effort: int,
) -> NDArray[np.float64]:
    """Round obstacles between which and past which everybody can walk."""
    settings, arena = scenario.obstacles, scenario.arena
    gap = passage(scenario.robots)
    obstacles = np.empty((0, 3))
    half = np.array([arena.length, arena.width]) / 2
    for k in range(settings.count):
        radius = rng.uniform(*settings.radius)
        keep = np.column_stack([keep_free, np.full(len(keep_free), clearance)])
        apart = obstacles + np.array([0.0, 0.0, gap])
        for _ in range(1 if effort == _CENTRED else _BATCHES):
            spot = _fit(rng, half - radius, np.vstack([keep, apart]), radius)
            if spot is None:
                raise NoPlaceError(
                    f"obstacle {k + 1} of {settings.count} found no place", OBSTACLE_FIELDS
                )
            if arena.kind == "open" or arena.width / 2 + abs(spot[1]) - radius >= gap:
                break
        else:
            raise NoPlaceError(
                f"obstacle {k + 1} of {settings.count} blocks the corridor", OBSTACLE_FIELDS
            )
        obstacles = np.vstack([obstacles, [*spot, radius]])
    return obstacles


def _fit(
    rng: np.random.Generator, half: NDArray[np.float64], taken: NDArray[np.float64], radius: float
) -> NDArray[np.float64] | None:
    """A centre within +/- half (2,) [m] for a disc that overlaps none of ``taken`` (N, 3)."""
    disc = np.array([[0.0, 0.0, radius]])
    found = _place_discs(rng, half, discs := np.vstack([taken, disc]), len(taken))
    return discs[-1, :2] if found else None


def _place_discs(
    rng: np.random.Generator, half: NDArray[np.float64], discs: NDArray[np.float64], fixed: int
) -> int:
    """Place all but the first ``fixed`` of ``discs`` (N, 3), one after another, without overlap.

    Each takes the first free place of a batch drawn within +/- half (2,) [m], or of up to as many
    batches as are tried. No batch is drawn that one disc at a time would not have drawn.

    Returns:
        How many have their place; x and y are written.
    """
    placed, failures, count = 0, 0, len(discs) - fixed
    while placed < count and failures < _BATCHES and not (half < 0).any():
        batches = min(count - placed, _BATCHES - failures)
        draws = rng.random((batches, 2 * _BATCH))
        placed, failures = _fill(draws, half, discs, fixed, placed, failures)
    return placed


@compiled()
def _fill(
    draws: NDArray[np.float64],
    half: NDArray[np.float64],
    discs: NDArray[np.float64],
    fixed: int,
    placed: int,
    failures: int,
) -> tuple[int, int]:
    """Place discs by batches of draws in [0, 1); returns ``placed`` and ``failures`` after them."""
    for batch in range(len(draws)):
        last = fixed + placed
        failures += 1
        for k in range(draws.shape[1] // 2):
            x = 2.0 * half[0] * draws[batch, 2 * k] - half[0]
            y = 2.0 * half[1] * draws[batch, 2 * k + 1] - half[1]
            if is_off_discs(x, y, discs, last):
                discs[last, 0], discs[last, 1] = x, y
                placed += 1
                failures = 0
                break
    return placed, failures
