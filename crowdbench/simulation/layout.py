"""Layout: where robots, obstacles and pedestrians begin, never overlapping."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Scenario, ScenarioError
from crowdbench.simulation import streams

PASSAGE = 0.9
"""Least gap between static obstacles, and on one side of each to a wall: nothing is closed [m]."""
OBSTACLE_CLEARANCE = 1.0
"""Least gap from static obstacles to a robot's start and goal, surface to centre [m]."""
_BATCH, _BATCHES = 64, 20
_LAYOUTS = 10


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
    """

    robot_pose: NDArray[np.float64]
    robot_goal: NDArray[np.float64]
    obstacles: NDArray[np.float64]
    walls: NDArray[np.float64]
    pedestrian_position: NDArray[np.float64]
    pedestrian_reactive: NDArray[np.bool_]


def place(scenario: Scenario, seed: int) -> Layout:
    """Draw a layout.

    Raises:
        ScenarioError: there is no room; the message says what was placed and what was not.
    """
    rng = streams.layout(seed)
    problem = ""
    for _ in range(_LAYOUTS):
        try:
            return _attempt(scenario, rng)
        except _NoRoomError as error:
            problem = str(error)
    arena = scenario.arena
    raise ScenarioError(
        f"scenario {scenario.name!r} has no room: {problem} "
        f"in {arena.length:g} x {arena.width:g} m; "
        "use fewer or smaller bodies, less clearance or a larger arena"
    )


class _NoRoomError(Exception):
    pass


def _attempt(scenario: Scenario, rng: np.random.Generator) -> Layout:
    pose, goal = _place_robots(scenario, rng)
    obstacles = _place_obstacles(scenario, rng, np.vstack([pose[:, :2], goal]))
    people = scenario.pedestrians
    robot_radius = np.hypot(scenario.robots.length, scenario.robots.width) / 2
    taken = np.vstack(
        [
            np.column_stack(
                [pose[:, :2], np.full(len(pose), robot_radius + people.spawn_clearance)]
            ),
            obstacles,
        ]
    )
    position = np.empty((people.count, 2))
    half = np.array([scenario.arena.length, scenario.arena.width]) / 2 - people.radius
    for p in range(people.count):
        spot = _fit(rng, half, taken, people.radius)
        if spot is None:
            raise _NoRoomError(f"pedestrian {p + 1} of {people.count} found no place")
        position[p] = spot
        taken = np.vstack([taken, [*spot, people.radius]])
    reactive = np.zeros(people.count, dtype=np.bool_)
    reactive[rng.permutation(people.count)[: round(people.reactive * people.count)]] = True
    return Layout(pose, goal, obstacles, _walls(scenario), position, reactive)


def _walls(scenario: Scenario) -> NDArray[np.float64]:
    """A corridor has a wall on either long side, reaching beyond it; open arenas have none."""
    if scenario.arena.kind == "open":
        return np.empty((0, 4))
    x, y = scenario.arena.length / 2 + scenario.lidar.range, scenario.arena.width / 2
    return np.array([[-x, -y, x, -y], [-x, y, x, y]])


def _place_robots(
    scenario: Scenario, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Starts and goals ``travel`` apart on opposite sides, headings roughly towards the goal."""
    robots, arena = scenario.robots, scenario.arena
    radius = float(np.hypot(robots.length, robots.width) / 2)
    reach = robots.travel / 2
    if arena.kind == "corridor" and reach + radius > arena.length / 2:
        raise _NoRoomError(f"a robot's way of robots.travel = {robots.travel:g} m does not fit")
    side = max(0.0, arena.width / 2 - 2 * radius)
    poses, goals = np.empty((robots.count, 3)), np.empty((robots.count, 2))
    for r in range(robots.count):
        for _ in range(_BATCH):
            if arena.kind == "open":
                angle = rng.uniform(-np.pi, np.pi)
                start = reach * np.array([np.cos(angle), np.sin(angle)])
                goal = -start
            else:
                end = rng.choice([-1.0, 1.0])
                start = np.array([end * reach, rng.uniform(-side, side)])
                goal = np.array([-end * reach, rng.uniform(-side, side)])
            others = np.vstack([poses[:r, :2], goals[:r]])
            spots = np.vstack([start, goal])
            gaps = np.linalg.norm(spots[:, None] - others[None], axis=2)
            if (gaps > 2 * radius + robots.goal_tolerance).all():
                break
        else:
            raise _NoRoomError(f"robot {r + 1} of {robots.count} found no place")
        ahead = goal - start
        heading = np.arctan2(ahead[1], ahead[0]) + rng.uniform(-np.pi / 6, np.pi / 6)
        poses[r], goals[r] = [*start, heading], goal
    return poses, goals


def _place_obstacles(
    scenario: Scenario, rng: np.random.Generator, keep_free: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Round obstacles between which and past which everybody can walk."""
    settings, arena = scenario.obstacles, scenario.arena
    obstacles = np.empty((0, 3))
    half = np.array([arena.length, arena.width]) / 2
    for k in range(settings.count):
        radius = rng.uniform(*settings.radius)
        keep = np.column_stack([keep_free, np.full(len(keep_free), OBSTACLE_CLEARANCE)])
        apart = obstacles + np.array([0.0, 0.0, PASSAGE])
        spot = _fit(rng, half - radius, np.vstack([keep, apart]), radius)
        if spot is None:
            raise _NoRoomError(f"obstacle {k + 1} of {settings.count} found no place")
        passable = arena.kind == "open" or arena.width / 2 + abs(spot[1]) - radius >= PASSAGE
        if not passable:
            raise _NoRoomError(f"obstacle {k + 1} of {settings.count} blocks the corridor")
        obstacles = np.vstack([obstacles, [*spot, radius]])
    return obstacles


def _fit(
    rng: np.random.Generator, half: NDArray[np.float64], taken: NDArray[np.float64], radius: float
) -> NDArray[np.float64] | None:
    """A centre within +/- half (2,) [m] for a disc that overlaps none of ``taken`` (N, 3)."""
    if (half < 0).any():
        return None
    for _ in range(_BATCHES):
        spots = rng.uniform(-half, half, size=(_BATCH, 2))
        gaps = np.linalg.norm(spots[:, None] - taken[None, :, :2], axis=2)
        free = (gaps > taken[:, 2] + radius).all(axis=1)
        if free.any():
            return spots[np.argmax(free)]
    return None
