"""What a robot believes of its own pose: the true motion, summed up with errors."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Odometry


class DriftingOdometry:
    """The odometry of one robot since the reset.

    After the motion model of Thrun, Burgard, Fox, "Probabilistic Robotics" (2005), section 5.4. A
    period's motion is half its turn, the way straight on, and the other half; each is believed with
    an error of its own. Along an arc that is the model's own decomposition, also backwards; a robot
    that goes sideways does so by its true bearing.

    Attributes:
        believed: (3,) x, y [m], heading [rad] in the frame of the first pose.
    """

    def __init__(
        self, settings: Odometry, pose: NDArray[np.float64], noise: np.random.Generator
    ) -> None:
        """Begin at a true pose (3,) with all errors at zero."""
        self._settings, self._noise = settings, noise
        self._true: list[float] = pose.tolist()
        self.believed = np.zeros(3)

    def wrapped(self) -> NDArray[np.float64]:
        """``believed`` with a heading between -pi and pi."""
        x, y, heading = self.believed.tolist()
        return np.array([x, y, (heading + math.pi) % (2 * math.pi) - math.pi])

    def update(self, pose: NDArray[np.float64]) -> None:
        """Take in where the robot truly is by now, a control period later."""
        x, y, heading = self._true
        self._true = pose.tolist()
        dx, dy, turn = self._true[0] - x, self._true[1] - y, self._true[2] - heading
        way, half = math.hypot(dx, dy), turn / 2
        bearing = math.atan2(dy, dx) - heading - half if way > 0.0 else 0.0
        s, (first, along, last) = self._settings, self._noise.standard_normal(3).tolist()
        off = math.sqrt(s.rotation * half * half + s.rotation_by_translation * way * way)
        longer = s.translation * way * way + s.translation_by_rotation * 2.0 * half * half
        way += math.sqrt(longer) * along
        middle = float(self.believed[2]) + half + off * first
        self.believed[0] += way * math.cos(middle + bearing)
        self.believed[1] += way * math.sin(middle + bearing)
        self.believed[2] = middle + half + off * last
