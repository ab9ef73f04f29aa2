"""Actions among which plans choose: arcs, or lines for an omnidirectional robot."""

from __future__ import annotations

import math

import numpy as np

_COARSE = [(1.0, turn) for turn in (0.0, 0.35, 1.0, -0.35, -1.0)]
_COARSE += [(0.4, turn) for turn in (0.0, 0.7, -0.7)] + [(0.0, turn) for turn in (0.0, 1.0, -1.0)]
_FINE = [(1.0, turn) for turn in (0.12, 0.65, -0.12, -0.65)]
_FINE += [(0.7, turn) for turn in (0.0, 0.5, -0.5)] + [(0.4, turn) for turn in (1.0, -1.0)]
_FINE += [(0.0, turn) for turn in (0.4, -0.4)]
_COARSE_LINES = [(1.0, math.pi / 8 * k) for k in (0, 1, -1, 2, -2, 4, -4, 6, -6, 8)]
_COARSE_LINES += [(0.4, math.pi / 4 * k) for k in (0, 1, -1)] + [(0.0, 0.0)]
_FINE_LINES = [(1.0, math.pi / 16 * k) for k in (1, -1, 3, -3, 6, -6)]
_FINE_LINES += [(0.4, math.pi / 4 * k) for k in (2, -2, 3, -3, 4)]
_FINE_LINES += [(0.7, math.pi / 4 * k) for k in (0, 1, -1)]


def arcs(speed, turn_rate):
    """(A, 2) v [m/s], w [rad/s] to choose from, within a robot's limits; the coarse half first."""
    slow, fast = max(0.0, speed[0]), speed[1]
    right, left = turn_rate
    return np.array(
        [(slow + v * (fast - slow), w * (left if w > 0 else -right)) for v, w in _COARSE + _FINE]
    )


def lines(speed, lateral_speed):
    """The same for an omnidirectional robot: (A, 2) speeds ahead and to the left [m/s]."""
    low, high = np.array([speed, lateral_speed]).T
    chosen = []
    for share, angle in _COARSE_LINES + _FINE_LINES:
        way = np.array([math.cos(angle), math.sin(angle)])
        # The largest speed that way, within both limits.
        bounds = np.where(way > 0, high, -low) / np.maximum(np.abs(way), 1e-9)
        chosen.append(share * max(0.0, bounds.min()) * way)
    return np.array(chosen)
