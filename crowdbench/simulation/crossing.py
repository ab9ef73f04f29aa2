"""Layout of a crossing: at which moment of a recording, and where the robots go."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Arena, NoRoomError, Scenario
from crowdbench.scenario.recorded import load, origin
from crowdbench.scenario.room import ends_gap, robot_radius
from crowdbench.simulation import streams
from crowdbench.simulation.layout import WALL_CLEARANCE, Layout
from crowdbench.simulation.map_layout import NoPlaceError, Places
from crowdbench.simulation.recorded import Tracks, away, distances
from crowdbench.simulation.traits import draw_traits
from crowdbench.simulation.walls import walls_of

if TYPE_CHECKING:
    from crowdbench.people import CrowdRecording

NEAR = 1.0
"""Somebody has to come this near to a robot's way, or nobody is crossed [m]."""
SHORTEST = 2.5
"""Of a robot's way, where walls leave less than ``robots.travel`` [m]."""
_TURN = math.pi / 12
"""By how much a way differs from the direction asked for, at most [rad]."""
_STEP = 0.02
_FACING = math.pi / 6
_ATTEMPTS = 300
_BLINK = 0.5
"""How often it is asked whether somebody is at a goal [s]."""
_CROWDED = "somebody is within pedestrians.spawn_clearance of every start"


class _Drawn(NamedTuple):
    """The robots' part of a layout.

    Attributes:
        pose: (R, 3).
        ways: of each robot (n, 2), from its start to its goal.
    """

    pose: NDArray[np.float64]
    ways: list[NDArray[np.float64]]


def place_crossing(scenario: Scenario, seed: int, places: Places | None) -> Layout:
    """Draw a moment of the recording, and ways of the robots through the people of that moment.

    The recording goes on for at least twice the time that a robot needs for its way at full speed,
    as far as it is that long.

    Args:
        scenario: whose.
        seed: of the episode.
        places: where the robots begin and end, where the scenario says it.

    Raises:
        NoRoomError: walls leave no way, nobody comes near to one, or somebody is always at its
            ends.
    """
    recording, _ = load(scenario.pedestrians.recording)
    centre, walls = origin(recording, scenario.arena), walls_of(scenario)
    rng = streams.layout(seed)
    count, speed = scenario.pedestrians.count, max(0.1, *map(abs, scenario.robots.speed))
    problem = "no way is wide and long enough among the walls"
    for _ in range(_ATTEMPTS):
        drawn = None if places is None else _given(places, rng)
        lengths = [scenario.robots.travel] if drawn is None else map(_length, drawn.ways)
        needed = min(scenario.time_limit, 2 * max(lengths) / speed)
        latest = rng.uniform(0.0, max(0.0, recording.duration - needed))
        # With a frame: in control periods that are frames people are exactly where they were.
        begin = recording.moments[np.searchsorted(recording.moments, latest, side="right") - 1]
        rows = np.flatnonzero((recording.times >= begin) & (recording.times <= begin + needed))
        if not len(rows):
            continue
        people = recording.positions[rows] - centre
        if places is None:
            drawn = _free(scenario, rng, people, _axis(scenario, recording), walls)
        if drawn is None:
            continue
        moments = np.arange(begin, begin + needed, _BLINK)
        moment, present = recording.at_times(moments)
        ends = np.searchsorted(moment, np.arange(1, len(moments)))
        around = np.split(present.positions - centre, ends)
        if problem := _unfit(drawn, scenario, people, around):
            continue
        tracks = Tracks.of(
            recording, centre, begin, scenario.time_limit, scenario.control_period, count
        )
        there = np.isfinite(tracks.at(0))
        reactive = np.zeros(count, dtype=np.bool_)
        share = round(scenario.pedestrians.reactive * count)
        reactive[rng.permutation(count)[:share]] = True
        return Layout(
            drawn.pose,
            np.array([way[-1] for way in drawn.ways]),
            np.empty((0, 3)),
            walls,
            np.where(there, tracks.at(0), away(count)),
            reactive,
            np.zeros(count, dtype=np.int64),
            draw_traits(scenario.pedestrians, seed),
            tracks,
        )
    how, fields = "from robots.start to robots.goal", "robots.start or robots.goal"
    if places is None:
        route = scenario.pedestrians.recording.route
        how, fields = f"{route} its main direction", "robots.travel or pedestrians.recording.route"
    others = "pedestrians.spawn_clearance, " if problem == _CROWDED else ""
    raise NoRoomError(
        f"scenario {scenario.name!r}: recording {recording.name!r} cannot be crossed {how} with "
        f"seed {seed}: {problem} in {_ATTEMPTS} draws; change {others}pedestrians.recording, "
        f"{fields}",
        seed,
    )


def _unfit(
    drawn: _Drawn,
    scenario: Scenario,
    people: NDArray[np.float64],
    around: list[NDArray[np.float64]],
) -> str:
    """Why a moment is none for these ways; empty where it is one.

    Args:
        drawn: ways of the robots.
        scenario: whose.
        people: (N, 2) where people are in the seconds to come [m].
        around: the same (M, 2) at each of some moments, the first of them the beginning [m].
    """
    touching = robot_radius(scenario.robots) + scenario.pedestrians.radii[1]
    clear = touching + scenario.pedestrians.spawn_clearance
    if (distances(around[0], drawn.pose[:, :2]) <= clear).any():
        return _CROWDED
    if not all(_met(way, people) for way in drawn.ways):
        return f"nobody comes within {NEAR:g} m of the robot's way"
    for way in drawn.ways:
        if all((distances(places, way[-1:]) <= touching).any() for places in around):
            return "somebody stands at every goal all the time"
    return ""


def _axis(scenario: Scenario, recording: CrowdRecording) -> float:
    """Along which robots are to drive, whichever way [rad]."""
    across = scenario.pedestrians.recording.route == "across"
    return main_direction(recording) + (math.pi / 2 if across else 0.0)


def main_direction(recording: CrowdRecording) -> float:
    """The axis along which people walk, whichever way: the mean of doubled angles, halved [rad]."""
    begin, end = recording.starts[:-1], recording.starts[1:] - 1
    x, y = (recording.positions[end] - recording.positions[begin]).T
    # By doubled angles, weighted by the way: x + iy squared, over its length.
    length = np.maximum(np.sqrt(x * x + y * y), 1e-9)
    return (
        math.atan2(float((2 * x * y / length).sum()), float(((x * x - y * y) / length).sum())) / 2
    )


def _given(places: Places, rng: np.random.Generator) -> _Drawn | None:
    """Ways between the places that a scenario says; None where two robots are too near."""
    try:
        pose, goals = places.draw_robots(rng, np.empty((0, 3)))
    except NoPlaceError:
        return None
    return _Drawn(pose, [places.ways.path(*ends) for ends in zip(pose[:, :2], goals, strict=True)])


def _free(
    scenario: Scenario,
    rng: np.random.Generator,
    people: NDArray[np.float64],
    axis: float,
    walls: NDArray[np.float64],
) -> _Drawn | None:
    """Straight ways through places where people walk; None where walls leave none."""
    robots = scenario.robots
    gap = ends_gap(robots)
    ways = np.empty((0, 2, 2))
    if scenario.arena.kind == "map":  # the robot stays on it
        walls = np.concatenate([walls, _border(scenario.arena)])
    for _ in range(robots.count):
        through = people[rng.integers(len(people))]
        angle = axis + rng.uniform(-_TURN, _TURN) + math.pi * rng.integers(2)
        before = robots.travel * rng.uniform(0.35, 0.65)
        if not _is_open(scenario.arena, through):
            return None
        way = _fitted(through, angle, before, scenario, walls)
        if way is None:
            return None
        ends = ways.reshape(-1, 2)
        if len(ends) and distances(ends, way).min() <= gap:
            return None
        ways = np.concatenate([ways, way[None]])
    ahead = ways[:, 1] - ways[:, 0]
    turns = rng.uniform(-_FACING, _FACING, len(ways))
    headings = [math.atan2(y, x) + turn for (x, y), turn in zip(ahead, turns, strict=True)]
    return _Drawn(np.column_stack([ways[:, 0], headings]), list(ways))


def _border(arena: Arena) -> NDArray[np.float64]:
    """(4, 4) the four sides of a map as walls [m]."""
    x_min, y_min, x_max, y_max = arena.bounds
    corners = [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max), (x_min, y_min)]
    return np.array([(*begin, *end) for begin, end in pairwise(corners)])


def _is_open(arena: Arena, place: NDArray[np.float64]) -> bool:
    """Whether a place (2,) lies on the map and in nothing solid; true where there is no map."""
    if arena.kind != "map":
        return True
    import shapely  # here, since few scenarios have maps

    low, high = np.array(arena.bounds).reshape(2, 2)
    solids = [shapely.Polygon(polygon) for polygon in arena.polygons]
    inside = shapely.intersects_xy(solids, *place.tolist())
    return bool(((place >= low) & (place <= high)).all() and not np.any(inside))


def _fitted(
    through: NDArray[np.float64],
    angle: float,
    before: float,
    scenario: Scenario,
    walls: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """(2, 2) a straight way, cut to what walls leave; None where that is too short."""
    robots = scenario.robots
    clear = robot_radius(robots) + WALL_CLEARANCE
    ahead = np.array([math.cos(angle), math.sin(angle)])
    behind, beyond = (
        free_distance(through, sign * ahead, clear, robots.travel, walls) for sign in (-1.0, 1.0)
    )
    travel = min(robots.travel, behind + beyond)
    if travel < min(robots.travel, SHORTEST):
        return None
    back = min(max(before * travel / robots.travel, travel - beyond), behind)
    return np.array([through - back * ahead, through + (travel - back) * ahead])


def free_distance(
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
    clear: float,
    longest: float,
    walls: NDArray[np.float64],
) -> float:
    """How far a disc gets straight on before it touches a wall, to within ``_STEP`` [m].

    Args:
        origin: (2,) of its centre [m].
        direction: (2,) unit vector.
        clear: its radius [m].
        longest: beyond which nobody asks [m].
        walls: (S, 4) [m].

    Returns:
        0 where it touches one at once, infinite where nothing is in the way.
    """
    if not len(walls):
        return math.inf
    begin, along = walls[:, :2], walls[:, 2:] - walls[:, :2]
    square = np.maximum((along * along).sum(axis=1), 1e-12)
    steps = np.arange(0.0, longest + _STEP, _STEP)
    offset = (origin + steps[:, None] * direction)[:, None] - begin
    share = np.clip((offset * along).sum(axis=2) / square, 0.0, 1.0)
    gap = offset - share[..., None] * along
    blocked = ((gap * gap).sum(axis=2) <= clear * clear).any(axis=1)
    free = int(blocked.argmax()) if blocked.any() else len(steps)
    return float(steps[free - 1]) if free else 0.0


def _met(way: NDArray[np.float64], people: NDArray[np.float64]) -> bool:
    """Whether somebody comes near to a way (n, 2)."""
    for start, end in pairwise(way):
        along = end - start
        share = np.clip(((people - start) * along).sum(axis=1) / (along * along).sum(), 0.0, 1.0)
        gap = people - start - share[:, None] * along
        if ((gap * gap).sum(axis=1) <= NEAR * NEAR).any():
            return True
    return False


def _length(way: NDArray[np.float64]) -> float:
    """Of a way (n, 2) [m]."""
    steps = np.diff(way, axis=0)
    return float(np.sqrt((steps * steps).sum(axis=1)).sum())
