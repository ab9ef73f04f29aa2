"""Layout of a crossing: at which moment of a recording, and where the robots go."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.people import CrowdRecording
from crowdbench.scenario import NoRoomError, Scenario
from crowdbench.scenario.recorded import load, origin
from crowdbench.scenario.room import robot_radius
from crowdbench.simulation import streams
from crowdbench.simulation.layout import WALL_CLEARANCE, Layout
from crowdbench.simulation.recorded import Tracks, away, distances
from crowdbench.simulation.traits import draw_traits
from crowdbench.simulation.walls import walls_of

NEAR = 1.0
"""Somebody has to come this near to a robot's way, or nobody is crossed [m]."""
SHORTEST = 2.5
"""Of a robot's way, where walls leave less than ``robots.travel`` [m]."""
_TURN = math.pi / 12
"""By how much a way differs from the direction asked for, at most [rad]."""
_STEP = 0.02
_FACING = math.pi / 6
_ATTEMPTS = 300


def place_crossing(scenario: Scenario, seed: int) -> Layout:
    """Draw a moment of the recording, and ways of the robots through the people of that moment.

    The world's origin is the centre of people and walls. The recording goes on for at least twice
    the time that a robot needs for ``robots.travel`` at full speed, as far as it is that long.

    Raises:
        NoRoomError: walls leave no way, or nobody comes near to one.
    """
    settings = scenario.pedestrians.recording
    recording, _ = load(settings)
    centre, walls = origin(recording), walls_of(scenario)
    rng = streams.layout(seed)
    robots, count = scenario.robots, scenario.pedestrians.count
    speed = max(map(abs, robots.speed))
    needed = min(scenario.time_limit, 2 * robots.travel / max(speed, 0.1))
    axis = main_direction(recording) + (math.pi / 2 if settings.route == "across" else 0.0)
    problem = "no way is wide and long enough among the walls"
    for _ in range(_ATTEMPTS):
        begin = rng.uniform(0.0, max(0.0, recording.duration - needed))
        rows = np.flatnonzero((recording.times >= begin) & (recording.times <= begin + needed))
        if not len(rows):
            continue
        places = recording.positions[rows] - centre
        ways = _ways(scenario, rng, places, axis, walls)
        if ways is None:
            continue
        present = recording.at(begin).positions - centre
        clear = robot_radius(robots) + scenario.pedestrians.radii[1]
        clear += scenario.pedestrians.spawn_clearance
        apart = distances(present, ways[:, 0])
        if (apart <= clear).any():
            problem = "somebody is within pedestrians.spawn_clearance of every start"
            continue
        if not all(_met(way, places) for way in ways):
            problem = f"nobody comes within {NEAR:g} m of the robot's way"
            continue
        tracks = Tracks.of(
            recording, centre, begin, scenario.time_limit, scenario.control_period, count
        )
        there = np.isfinite(tracks.at(0))
        reactive = np.zeros(count, dtype=np.bool_)
        share = round(scenario.pedestrians.reactive * count)
        reactive[rng.permutation(count)[:share]] = True
        turns = rng.uniform(-_FACING, _FACING, len(ways))
        ahead = ways[:, 1] - ways[:, 0]
        headings = [math.atan2(y, x) + turn for (x, y), turn in zip(ahead, turns, strict=True)]
        return Layout(
            np.column_stack([ways[:, 0], headings]),
            ways[:, 1],
            np.empty((0, 3)),
            walls,
            np.where(there, tracks.at(0), away(count)),
            reactive,
            np.zeros(count, dtype=np.int64),
            draw_traits(scenario.pedestrians, seed),
            tracks,
        )
    raise NoRoomError(
        f"scenario {scenario.name!r}: recording {recording.name!r} cannot be crossed "
        f"{settings.route} its main direction with seed {seed}: {problem} in {_ATTEMPTS} draws; "
        "use another recording, robots.travel or pedestrians.recording.route",
        seed,
    )


def main_direction(recording: CrowdRecording) -> float:
    """The axis along which people walk, whichever way: the mean of doubled angles, halved [rad]."""
    begin, end = recording.starts[:-1], recording.starts[1:] - 1
    x, y = (recording.positions[end] - recording.positions[begin]).T
    # By doubled angles, weighted by the way: x + iy squared, over its length.
    length = np.maximum(np.sqrt(x * x + y * y), 1e-9)
    return (
        math.atan2(float((2 * x * y / length).sum()), float(((x * x - y * y) / length).sum())) / 2
    )


def _ways(
    scenario: Scenario,
    rng: np.random.Generator,
    places: NDArray[np.float64],
    axis: float,
    walls: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """(R, 2, 2) start and goal of each robot through places where people walk; None without."""
    robots = scenario.robots
    gap = 2 * robot_radius(robots) + robots.goal_tolerance
    ways = np.empty((0, 2, 2))
    for _ in range(robots.count):
        through = places[rng.integers(len(places))]
        angle = axis + rng.uniform(-_TURN, _TURN) + math.pi * rng.integers(2)
        before = robots.travel * rng.uniform(0.35, 0.65)
        way = _fitted(through, angle, before, scenario, walls)
        if way is None:
            return None
        ends = ways.reshape(-1, 2)
        if len(ends) and distances(ends, way).min() <= gap:
            return None
        ways = np.concatenate([ways, way[None]])
    return ways


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


def _met(way: NDArray[np.float64], places: NDArray[np.float64]) -> bool:
    """Whether somebody comes near to a straight way."""
    start, along = way[0], way[1] - way[0]
    share = np.clip(((places - start) * along).sum(axis=1) / (along * along).sum(), 0.0, 1.0)
    gap = places - start - share[:, None] * along
    return bool(((gap * gap).sum(axis=1) <= NEAR * NEAR).any())
