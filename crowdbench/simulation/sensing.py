"""What robots see: scans, odometry and goals in one row of numbers for each."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.robot import RobotSpec
from crowdbench.scenario import Scenario
from crowdbench.simulation import streams
from crowdbench.simulation.draws import LOST_BEAMS, SCAN_NOISE, gap, normal, sequence
from crowdbench.simulation.kinematics import make_drive, poses_ahead
from crowdbench.simulation.lanes import PROPRIOCEPTION
from crowdbench.simulation.lidar import cast_rays, footprint_segments
from crowdbench.simulation.obstacle_map import MapGeometry, ObstacleMaps
from crowdbench.simulation.rounding import sum_of_products


@compiled()
def observe(
    lanes: NDArray[np.int64],
    worlds: NDArray[np.void],
    robots: NDArray[np.void],
    people: NDArray[np.void],
    obstacles: NDArray[np.float64],
    walls: NDArray[np.float64],
    beams: NDArray[np.float64],
    seen: NDArray[np.float32],
) -> None:
    """Write what the active robots observe, and their least LiDAR distances, without noise.

    Args:
        lanes: (M,) which.
        worlds, robots, people, obstacles, walls: of all lanes as they are now, see ``State``.
        beams: (beams, 3) from ``beam_table``.
        seen: written.
    """
    discs = np.empty((people.shape[1], 3))
    sensor = np.empty(3)
    segments = np.empty((walls.shape[1] + 4 * robots.shape[1], 4))
    for i in range(len(lanes)):
        lane = lanes[i]
        world = worlds[lane]
        for p in range(world.people):
            person = people[lane, p]
            discs[p, 0], discs[p, 1] = person.position[0], person.position[1]
            discs[p, 2] = person.radius
        for s in range(world.walls):
            for column in range(4):
                segments[s, column] = walls[lane, s, column]
        for r in range(robots.shape[1]):
            robot = robots[lane, r]
            if not robot.active:
                continue
            filled = _add_outlines(segments, world.walls, robots[lane], r)
            _mounted(robot.pose, world.mount, sensor)
            robot.nearest = cast_rays(
                sensor,
                beams,
                discs[: world.people],
                obstacles[lane, : world.obstacles],
                segments[:filled],
                world.range,
                seen[lane, r, PROPRIOCEPTION:],
            )
            _proprioception(robot.pose, robot.velocity, robot.goal, robot.origin, seen[lane, r])


@compiled()
def _mounted(
    pose: NDArray[np.float64], mount: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Write the pose (3,) of what is mounted on a robot at ``pose``: exactly that if at zero."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    out[0] = pose[0] + sum_of_products(cosine, mount[0], -sine, mount[1])
    out[1] = pose[1] + sum_of_products(sine, mount[0], cosine, mount[1])
    out[2] = pose[2] + mount[2]


@compiled()
def outline(lanes: NDArray[np.int64], worlds: NDArray[np.void], robots: NDArray[np.void]) -> None:
    """Write the robots' footprints into ``robots.outline``, so that they can see each other."""
    for i in range(len(lanes)):
        world = worlds[lanes[i]]
        for r in range(robots.shape[1]):
            robot = robots[lanes[i], r]
            edges = footprint_segments(robot.pose, world.robot_length, world.robot_width)
            for s in range(4):
                for column in range(4):
                    robot.outline[s, column] = edges[s, column]


@compiled(inline="always")
def _add_outlines(segments, filled, robots, mine):  # type: ignore[no-untyped-def]
    """Add the edges of the other robots that are there; returns how many segments there are."""
    for r in range(len(robots)):
        if r != mine and robots[r].active:
            for s in range(4):
                for column in range(4):
                    segments[filled, column] = robots[r].outline[s, column]
                filled += 1
    return filled


@compiled(inline="always")
def _proprioception(
    pose: NDArray[np.float64],
    velocity: NDArray[np.float64],
    goal: NDArray[np.float64],
    origin: NDArray[np.float64],
    out: NDArray[np.float32],
) -> None:
    """Write velocity (2), goal in the robot frame (2) and odometry since ``origin`` (3)."""
    out[0], out[1] = velocity[0], velocity[1]
    x, y = goal[0] - pose[0], goal[1] - pose[1]
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    out[2], out[3] = cosine * x + sine * y, cosine * y - sine * x
    x, y = pose[0] - origin[0], pose[1] - origin[1]
    cosine, sine = math.cos(origin[2]), math.sin(origin[2])
    out[4], out[5] = cosine * x + sine * y, cosine * y - sine * x
    out[6] = (pose[2] - origin[2] + math.pi) % (2 * math.pi) - math.pi


class ScanNoise:
    """Noise and dropout of the LiDARs in many lanes, of every robot from draws of its own."""

    def __init__(self, lanes: int, scenario: Scenario) -> None:
        """No lane has any yet; robots and LiDAR are those of the scenario."""
        self._largest = scenario.lidar.range
        self._sizes = np.zeros((lanes, 2))  # noise [m] and dropout
        self._keys = np.zeros((lanes, scenario.robots.count), dtype=np.uint64)
        self._scans = np.zeros(lanes, dtype=np.int64)  # taken in the episode

    def begin(self, lane: int, scenario: Scenario, seed: int) -> None:
        """Begin an episode in a lane."""
        self._sizes[lane] = scenario.lidar.noise, scenario.lidar.dropout
        self._scans[lane] = 0
        if self._sizes[lane].any():
            for r in range(scenario.robots.count):
                self._keys[lane, r] = streams.lidar(seed, r).integers(2**64, dtype=np.uint64)

    def add(
        self, lanes: NDArray[np.int64], robots: NDArray[np.void], seen: NDArray[np.float32]
    ) -> None:
        """Change what active robots in lanes (M,) have seen, see ``State``."""
        _disturb(lanes, robots, self._sizes, self._keys, self._scans, self._largest, seen)


@compiled()
def _disturb(lanes, robots, sizes, keys, scans, largest, seen):  # type: ignore[no-untyped-def]
    """Add noise to what active robots have seen, and lose beams; sizes to scans of all lanes."""
    nothing = np.float32(largest)
    for i in range(len(lanes)):
        lane = lanes[i]
        noise, dropout = sizes[lane, 0], sizes[lane, 1]
        if noise == 0.0 and dropout == 0.0:
            continue
        for r in range(robots.shape[1]):
            if not robots[lane, r].active:
                continue
            scan = seen[lane, r, PROPRIOCEPTION:]
            if noise > 0.0:
                drawn, first = sequence(keys[lane, r], SCAN_NOISE), scans[lane] * len(scan)
                for k in range(len(scan)):
                    # A beam that hits nothing has nothing to be noisy about.
                    if scan[k] < nothing:
                        noisy = scan[k] + noise * normal(drawn, first + k)
                        scan[k] = min(max(noisy, 0.0), largest)
            if dropout > 0.0:
                lost = sequence(sequence(keys[lane, r], LOST_BEAMS), scans[lane])
                number, k = 0, gap(dropout, lost, 0)
                while k < len(scan):
                    scan[int(k)] = nothing
                    number += 1
                    k += 1.0 + gap(dropout, lost, number)
        scans[lane] += 1


class DrawnMaps:
    """The obstacle maps of the robots in many lanes.

    Attributes:
        maps: (L, R, cells, cells) as ``ObstacleMaps`` draws them, around where the robots will be
            when their next commands begin to act.
    """

    def __init__(self, lanes: int, scenario: Scenario, geometry: MapGeometry) -> None:
        """Make room for the robots of a scenario in every lane."""
        self._robots, self._drive = scenario.robots.count, make_drive(scenario)
        count, cells = lanes * self._robots, geometry.cells
        self._histories = ObstacleMaps(count, RobotSpec.from_scenario(scenario), geometry)
        self.maps = np.zeros((lanes, self._robots, cells, cells), np.uint8)

    def reset(self, lane: int) -> None:
        """Forget the scans in a lane."""
        first = lane * self._robots
        self._histories.reset(slice(first, first + self._robots))

    def update(
        self,
        lanes: NDArray[np.int64],
        seen: NDArray[np.float32],
        active: NDArray[np.bool_],
        under_way: NDArray[np.float64],
        period: NDArray[np.float64],
    ) -> None:
        """Add what active robots (L, R) in lanes (M,) have seen (L, R, PROPRIOCEPTION + beams).

        A command acts for a lane's ``period`` (L,) [s].
        """
        rows, robots = np.nonzero(active[lanes])
        which = lanes[rows]
        view = as_observation(seen[which, robots])
        ahead = view["pose"].astype(np.float64)
        for lasts in set(period[which].tolist()) if under_way.shape[2] else ():
            same = period[which] == lasts
            ahead[same] = poses_ahead(
                self._drive,
                lasts,
                ahead[same],
                view["velocity"][same],
                under_way[which, robots][same],
            )
        self.maps[which, robots] = self._histories.update(
            view["lidar"], view["pose"], which * self._robots + robots, ahead
        )


def as_observation(
    seen: NDArray[np.float32], maps: NDArray[np.uint8] | None = None
) -> dict[str, NDArray[Any]]:
    """Parts of what one robot sees, or many (..., PROPRIOCEPTION + beams), by name.

    Args:
        seen: their observations.
        maps: (..., cells, cells) their obstacle maps, where they have some.
    """
    parts: dict[str, NDArray[Any]] = {
        "lidar": seen[..., PROPRIOCEPTION:],
        "velocity": seen[..., 0:2],
        "goal": seen[..., 2:4],
        "pose": seen[..., 4:7],
    }
    return parts if maps is None else parts | {"map": maps}
