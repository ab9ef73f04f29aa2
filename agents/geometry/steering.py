"""Robots that are slow to react, and commands that they can follow."""

from __future__ import annotations

import math

import crowdbench


def slow_to_react(robot: crowdbench.RobotSpec) -> bool:
    """Whether a robot has limits on its acceleration or latency, like those that can be bought.

    Agents take its LiDAR for one that can be bought, too: noisy, with beams that come back empty.
    """
    return robot.acceleration is not None or robot.latency > 0


def turn_towards(robot: crowdbench.RobotSpec, bearing: float) -> float:
    """The turn rate by which a robot faces a bearing [rad] soonest and stops there [rad/s].

    It may be beyond the robot's limits. With limits on its acceleration the robot turns at w for a
    period T, and in n more ones slower by a T each: by (n + 1) (w T - n a T^2 / 2) in all.
    """
    period = robot.control_period
    if robot.acceleration is None:
        return bearing / period
    step = robot.acceleration[1] * period  # a T
    n = max(0, math.ceil((math.sqrt(1 + 8 * abs(bearing) / (step * period)) - 3) / 2))
    return math.copysign(abs(bearing) / period / (n + 1) + step * n / 2, bearing)


def reachable(
    robot: crowdbench.RobotSpec, action: tuple[float, float], velocity: tuple[float, float]
) -> tuple[float, float]:
    """What a robot that does ``velocity`` does after a control period when told ``action``."""
    if robot.acceleration is None:
        return action
    first, second = (
        min(max(wanted, now - limit * robot.control_period), now + limit * robot.control_period)
        for wanted, now, limit in zip(action, velocity, robot.acceleration, strict=True)
    )
    return first, second
