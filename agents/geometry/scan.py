"""Scans as points around the robot, wherever on it the LiDAR is."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

import crowdbench

Array = NDArray[np.float64]

NOTHING = 1e-3
"""A beam that comes this near to the LiDAR's range has hit nothing [m]."""
BRIDGED = 0.15
"""Ranges on both sides of an empty beam that differ by less are from one surface [m]."""


class ScanGeometry:
    """Where the beams of a robot begin and where they go.

    Attributes:
        directions: (beams, 2) unit vectors in the robot frame.
        offset: (2,) where the beams begin in the robot frame [m].
        step: angle between two beams [rad].
        circle: whether the last beam is a neighbour of the first.
    """

    def __init__(self, robot: crowdbench.RobotSpec) -> None:
        """Take the geometry of a robot's LiDAR."""
        angles = robot.lidar_angles
        self.directions = np.column_stack([np.cos(angles), np.sin(angles)])
        self.offset = np.array(robot.lidar_mount[:2])
        self._range = robot.lidar_range
        self.step = float(abs(angles[1] - angles[0])) if len(angles) > 1 else 2 * np.pi
        self.circle = len(angles) * self.step > 2 * np.pi - 1e-6

    def points(self, lidar: Array) -> Array:
        """(N, 2) where the beams of a scan (beams,) that hit something end, robot frame [m]."""
        hit = lidar < self._range - NOTHING
        return lidar[hit, None] * self.directions[hit] + self.offset

    def origin(self, pose: Array) -> Array:
        """(3,) where the beams of a robot at ``pose`` begin, and the robot's heading."""
        cosine, sine = math.cos(pose[2]), math.sin(pose[2])
        x, y = self.offset.tolist()
        return np.array([pose[0] + cosine * x - sine * y, pose[1] + sine * x + cosine * y, pose[2]])

    def bridged(self, lidar: Array) -> Array:
        """(beams,) a scan in which single empty beams lie on the surface between their neighbours.

        Where a beam is lost, a person would be two things otherwise.
        """
        before, after = np.roll(lidar, 1), np.roll(lidar, -1)
        if not self.circle:
            before[0] = after[-1] = self._range
        hit = [ranges < self._range - NOTHING for ranges in (before, lidar, after)]
        lost = hit[0] & ~hit[1] & hit[2] & (np.abs(after - before) < BRIDGED)
        return np.where(lost, (before + after) / 2, lidar)
