"""The dynamic window approach, with a LiDAR among people.

Fox, Burgard, Thrun, "The dynamic window approach to collision avoidance", IEEE Robotics &
Automation Magazine 4(1), 1997: among the commands that the robot can reach within one control
period and that leave it time to stop, take the one with the best weighted sum of heading towards
the goal, distance from what is in the way, and speed. Distance is measured as the time for which
the arc stays free, because people move: discs are tracked in the scans (``clusters``) and taken to
keep their velocity. The footprint is the robot's rectangle.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from crowdbench_agents.geometry.clusters import Tracker
from crowdbench_agents.geometry.footprint import advance, point_gap, turned
from crowdbench_agents.geometry.scan import ScanGeometry
from crowdbench_agents.geometry.under_way import CommandsUnderWay, into_frame, relative
from numpy.typing import NDArray
from pydantic import Field

import crowdbench
from crowdbench.compiled import compiled

Weight = Annotated[float, Field(ge=0, le=1000)]

SPEEDS, TURNS = 9, 21
"""Samples of v and of w in the window."""
HORIZON = 2.4
"""Time for which an arc is looked at [s]."""
TICK = 0.1
"""Time between two checks along it [s]."""
GAP = 0.06
"""A gap below this is in the way [m]."""
COMFORT = 0.3
"""Gaps above this are as good as any [m]."""
REACTION = 0.4
"""Time for which an arc has to be free beyond the time to stop [s]."""


class DynamicWindow(crowdbench.Agent):
    """The best arc of the next period, judged by heading, free time and speed."""

    version = "0.1.0"

    def __init__(self, heading: Weight = 1.0, clearance: Weight = 1.0, speed: Weight = 1.0) -> None:
        """Set the weights of the three terms (alpha, beta, gamma), each term in [0, 1]."""
        self._weights = np.array([heading, clearance, speed])

    def reset(self, robot: crowdbench.RobotSpec, seed: int) -> None:
        """Forget the last episode; there is no randomness."""
        self._robot = robot
        self._tracker = Tracker(robot)
        self._scan = ScanGeometry(robot)
        self._under_way = CommandsUnderWay(robot)

    def act(self, observation: crowdbench.Observation) -> crowdbench.Action:
        """Return the best (v, w) of the window that opens when the command begins to act."""
        robot, ahead = self._robot, self._under_way.foresee(observation)
        scene = self._tracker.update(observation)
        x, y, heading = ahead.pose.tolist()
        cosine, sine = math.cos(heading), math.sin(heading)
        moving = scene.discs[scene.moving]
        velocity = np.ascontiguousarray(moving[:, 2:4])
        places = moving[:, :2] + self._under_way.time * velocity
        discs = np.column_stack(
            [turned(places - [x, y], cosine, sine), turned(velocity, cosine, sine), moving[:, 4]]
        )
        still = self._scan.points(self._tracker.without_moving(observation, scene))
        limits = robot.acceleration or (np.inf, np.inf)
        best = _best(
            *self._window(ahead, limits),
            limits[0],
            robot.control_period,
            ahead.goal.astype(float),
            robot.speed[1],
            robot.length / 2,
            robot.width / 2,
            into_frame(still, relative(observation.pose.astype(float), ahead.pose.astype(float))),
            discs,
            self._weights,
        )
        return self._under_way.send(best)

    def _window(
        self, observation: crowdbench.Observation, limits: tuple[float, float]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Speeds and turn rates that can be reached within one period."""
        robot = self._robot
        v, w = observation.velocity.astype(float)
        dv, dw = limits[0] * robot.control_period, limits[1] * robot.control_period
        low, high = max(0.0, robot.speed[0], v - dv), min(robot.speed[1], v + dv)
        right, left = max(robot.turn_rate[0], w - dw), min(robot.turn_rate[1], w + dw)
        return np.linspace(low, high, SPEEDS), np.linspace(right, left, TURNS)


@compiled()
def _best(
    speeds, turns, deceleration, period, goal, top, half_length, half_width, points, discs, weights
):
    """The admissible (v, w) that scores best; the one that stays free longest if none is."""
    best, best_v, best_w = -np.inf, 0.0, 0.0
    longest, longest_v, longest_w = -np.inf, 0.0, 0.0
    for v in speeds:
        for w in turns:
            free, gap = _free_time(v, w, goal, half_length, half_width, points, discs)
            if free + 0.1 * gap > longest:
                longest, longest_v, longest_w = free + 0.1 * gap, v, w
            if free < HORIZON and free < REACTION + v / deceleration:
                continue
            # Heading as seen from where the robot would be after the period (Fox, section 3.2).
            x, y, heading = advance(0.0, 0.0, 0.0, v, w, 2.0 * period)
            off = math.atan2(goal[1] - y, goal[0] - x) - heading
            off = abs((off + math.pi) % (2 * math.pi) - math.pi)
            score = weights[0] * (1.0 - off / math.pi) + weights[2] * v / top
            score += weights[1] * 0.5 * (free / HORIZON + min(gap, COMFORT) / COMFORT)
            if score > best:
                best, best_v, best_w = score, v, w
    if best == -np.inf:
        return longest_v, longest_w
    return best_v, best_w


@compiled()
def _free_time(v, w, goal, half_length, half_width, points, discs):
    """Time until the arc (v, w) meets something [s], and the least gap on the way [m].

    An arc that passes the goal is free from there on.
    """
    near = math.hypot(half_length, half_width) + COMFORT
    least = COMFORT
    steps = round(HORIZON / TICK)
    for i in range(1, steps + 1):
        t = i * TICK
        x, y, heading = advance(0.0, 0.0, 0.0, v, w, t)
        cosine, sine = math.cos(heading), math.sin(heading)
        for j in range(len(points)):
            dx, dy = points[j, 0] - x, points[j, 1] - y
            if dx * dx + dy * dy < near * near:
                gap = point_gap(
                    x, y, cosine, sine, half_length, half_width, points[j, 0], points[j, 1]
                )
                least = min(least, gap)
        for d in range(len(discs)):
            px, py = discs[d, 0] + t * discs[d, 2], discs[d, 1] + t * discs[d, 3]
            gap = point_gap(x, y, cosine, sine, half_length, half_width, px, py) - discs[d, 4]
            least = min(least, gap)
        if least < GAP:
            return t - TICK, least
        if math.hypot(goal[0] - x, goal[1] - y) < v * TICK:
            break
    return HORIZON, least
