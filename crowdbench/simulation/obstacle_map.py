"""The stacked obstacle map: the last eight scans as one small image, what learned agents see.

The scans are moved into the current robot frame with the odometry (translation and rotation) and
drawn into one small grid per scan: what stands still falls into the same cell in every frame, what
moves leaves a trail (paper, section III.A). The frames are stored as the bits of one byte per cell,
so a map of 48 x 48 cells takes 2.3 kB.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.robot import RobotSpec

_FRAMES = 8
_HIT_MARGIN = 1e-3  # a beam that returns the full range hit nothing [m]


@dataclass(frozen=True)
class MapGeometry:
    """Where the map lies in the robot frame (x ahead, y left).

    Attributes:
        cells: cells along each side; cell (i, j) is the i-th from behind, the j-th from the right.
        size: side length [m].
        ahead: distance from the robot to the front edge [m]; left and right are symmetric.
    """

    cells: int = 48
    size: float = 6.0
    ahead: float = 4.0

    @property
    def cell(self) -> float:
        """Side length of a cell [m]."""
        return self.size / self.cells

    @property
    def origin(self) -> tuple[float, float]:
        """Rear right corner of the map in the robot frame [m]."""
        return self.ahead - self.size, -self.size / 2


class ObstacleMaps:
    """The obstacle maps of N robots with equal LiDARs, one history each.

    Args:
        count: N.
        robot: any of them.
        geometry: where the map lies.
    """

    FRAMES: ClassVar[int] = _FRAMES
    """Scans in a map, one bit each; bit 0 is the current scan, bit k the one k steps ago."""

    def __init__(self, count: int, robot: RobotSpec, geometry: MapGeometry | None = None) -> None:
        self.geometry = geometry or MapGeometry()
        angles = robot.lidar_angles
        self._range, self._mount = float(robot.lidar_range), np.array(robot.lidar_mount[:2])
        self._cos = np.cos(angles).astype(np.float64)
        self._sin = np.sin(angles).astype(np.float64)
        self._points = np.zeros((count, _FRAMES, len(angles), 2), np.float64)
        self._hits = np.zeros((count, _FRAMES), np.int64)
        self._head = np.zeros(count, np.int64)

    def reset(self, robots: int | slice) -> None:
        """Forget the scans of some robots; frames not yet seen are empty."""
        self._hits[robots] = 0
        self._head[robots] = 0

    def update(
        self,
        lidar: NDArray[np.floating],
        pose: NDArray[np.floating],
        robots: NDArray[np.integer] | None = None,
        around: NDArray[np.floating] | None = None,
    ) -> NDArray[np.uint8]:
        """Add one scan of each robot and draw the maps.

        Args:
            lidar: (M, beams) distances [m].
            pose: (M, 3) odometry x, y [m], heading [rad].
            robots: (M,) which robots these are; None means all of them.
            around: (M, 3) poses in whose frames the maps are drawn; None means ``pose``.

        Returns:
            (M, cells, cells) bit k of a cell: something was there in the scan k steps ago.
        """
        cells = self.geometry.cells
        which = np.arange(len(self._head)) if robots is None else np.asarray(robots, np.int64)
        maps = np.zeros((len(which), cells, cells), np.uint8)
        x0, y0 = self.geometry.origin
        _update_all(
            maps, which, self._points, self._hits, self._head, np.asarray(lidar, np.float32),
            np.asarray(pose, np.float32),
            np.asarray(pose if around is None else around, np.float32),
            self._cos, self._sin, self._mount,
            self._range - _HIT_MARGIN, x0, y0, 1.0 / self.geometry.cell,
        )  # fmt: skip
        return maps


class ObstacleMap:
    """The obstacle map of one robot; see ObstacleMaps."""

    def __init__(self, robot: RobotSpec, geometry: MapGeometry | None = None) -> None:
        self._maps = ObstacleMaps(1, robot, geometry)

    @property
    def geometry(self) -> MapGeometry:
        """Where the map lies in the robot frame."""
        return self._maps.geometry

    def reset(self) -> None:
        """Forget all scans."""
        self._maps.reset(0)

    def update(
        self,
        lidar: NDArray[np.floating],
        pose: NDArray[np.floating],
        around: NDArray[np.floating] | None = None,
    ) -> NDArray[np.uint8]:
        """Add a scan (beams,) [m] taken at ``pose`` (3,) and return the (cells, cells) map.

        It is drawn in the frame of ``around`` (3,), by default that of ``pose``.
        """
        around = pose if around is None else around
        return self._maps.update(lidar[None], pose[None], around=around[None])[0]


@compiled(fastmath=True)
def _update_all(
    maps: NDArray[np.uint8],
    which: NDArray[np.int64],
    points: NDArray[np.float64],
    hits: NDArray[np.int64],
    head: NDArray[np.int64],
    lidar: NDArray[np.float32],
    pose: NDArray[np.float32],
    around: NDArray[np.float32],
    cos: NDArray[np.float64],
    sin: NDArray[np.float64],
    mount: NDArray[np.float64],
    reach: float,
    x0: float,
    y0: float,
    inverse_cell: float,
) -> None:  # pragma: no cover
    for row in range(len(which)):
        robot = which[row]
        # The scan becomes points in the odometry frame, so moving the robot moves no point.
        head[robot] = (head[robot] + 1) % _FRAMES
        newest = head[robot]
        x, y, heading = pose[row, 0], pose[row, 1], pose[row, 2]
        c, s = math.cos(heading), math.sin(heading)
        # Where the beams begin.
        x_lidar = x + c * mount[0] - s * mount[1]
        y_lidar = y + s * mount[0] + c * mount[1]
        count = 0
        for beam in range(lidar.shape[1]):
            distance = lidar[row, beam]
            if distance < reach:
                dx, dy = distance * cos[beam], distance * sin[beam]
                points[robot, newest, count, 0] = x_lidar + c * dx - s * dy
                points[robot, newest, count, 1] = y_lidar + s * dx + c * dy
                count += 1
        hits[robot, newest] = count
        x, y, heading = around[row, 0], around[row, 1], around[row, 2]
        c, s = math.cos(heading), math.sin(heading)
        for age in range(_FRAMES):
            frame = (newest - age) % _FRAMES
            bit = np.uint8(1 << age)
            for k in range(hits[robot, frame]):
                dx = points[robot, frame, k, 0] - x
                dy = points[robot, frame, k, 1] - y
                i = math.floor((c * dx + s * dy - x0) * inverse_cell)
                j = math.floor((c * dy - s * dx - y0) * inverse_cell)
                if 0 <= i < maps.shape[1] and 0 <= j < maps.shape[2]:
                    maps[row, i, j] |= bit
