"""The dynamic window approach, with a LiDAR among people.

Fox, Burgard, Thrun, "The dynamic window approach to collision avoidance", IEEE Robotics &
Automation Magazine 4(1), 1997: among the commands that the robot can reach within one control
period and that leave it time to stop, take the one with the best weighted sum of heading towards
the goal, distance from what is in the way, and speed. Distance is measured as the time for which
the arc stays free, because people move: discs are tracked in the scans (``clusters``) and taken to
keep their velocity. The footprint is the robot's rectangle.

What a robot with limits on its acceleration reaches within a period is too little to get out of
anybody's way. So it chooses among all commands, and each is driven as the limits allow (trajectory
rollout; Gerkey, Konolige, "Planning and control in unstructured terrain", ICRA workshop on path
planning on costmaps, 2008).
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from crowdbench_agents.geometry.clusters import Tracker
from crowdbench_agents.geometry.footprint import advance, point_gap, turned
from crowdbench_agents.geometry.scan import ScanGeometry
from crowdbench_agents.geometry.steering import slow_to_react
from crowdbench_agents.geometry.under_way import CommandsUnderWay, into_frame, relative
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
GROWTH = 0.1
"""By how much discs grow in a second, for a robot that cannot evade at once [m/s]."""


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
        # Speeds and turn rates to choose from.
        self._window = (
            np.linspace(max(0.0, robot.speed[0]), robot.speed[1], SPEEDS),
            np.linspace(*robot.turn_rate, TURNS),
        )

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
        best = _best(
            *self._window,
            ahead.velocity.astype(float),
            np.array(robot.acceleration or (np.inf, np.inf)),
            robot.control_period,
            ahead.goal.astype(float),
            robot.speed[1],
            robot.length / 2,
            robot.width / 2,
            into_frame(still, relative(observation.pose.astype(float), ahead.pose.astype(float))),
            discs,
            GROWTH if slow_to_react(robot) else 0.0,
            self._weights,
        )
        return self._under_way.send(best)


@compiled()
def _best(
    speeds, turns, now, limits, period, goal, top, half_length, half_width, points, discs, growth,
    weights,
):  # fmt: skip
    """The admissible (v, w) that scores best; the one that stays free longest if none is."""
    best, best_v, best_w = -np.inf, 0.0, 0.0
    longest, longest_v, longest_w = -np.inf, 0.0, 0.0
    arc = np.empty((round(HORIZON / TICK), 3))
    for v in speeds:
        for w in turns:
            _drive(v, w, now, limits, arc)
            free, gap = _free_time(arc, v, goal, half_length, half_width, points, discs, growth)
            if free + 0.1 * gap > longest:
                longest, longest_v, longest_w = free + 0.1 * gap, v, w
            if free < HORIZON and free < REACTION + v / limits[0]:
                continue
            # Heading as seen from where the robot would be after the period (Fox, section 3.2).
            if np.isinf(limits[0]):
                x, y, heading = advance(0.0, 0.0, 0.0, v, w, 2.0 * period)
            else:
                k = min(max(1, round(2.0 * period / TICK)), len(arc)) - 1
                x, y, heading = arc[k, 0], arc[k, 1], arc[k, 2]
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
def _drive(v, w, now, limits, arc):
    """Write the pose after every tick into (K, 3) ``arc``, from the origin and doing ``now``.

    The command (v, w) is reached as fast as ``limits`` (2,) on the acceleration allow.
    """
    a, b = now[0], now[1]
    x, y, heading = 0.0, 0.0, 0.0
    for i in range(len(arc)):
        # Without limits in one arc from the beginning: tick by tick it would be rounded otherwise.
        if np.isinf(limits[0]):
            x, y, heading = advance(0.0, 0.0, 0.0, v, w, (i + 1) * TICK)
        else:
            a = min(max(v, a - limits[0] * TICK), a + limits[0] * TICK)
            b = min(max(w, b - limits[1] * TICK), b + limits[1] * TICK)
            x, y, heading = advance(x, y, heading, a, b, TICK)
        arc[i, 0], arc[i, 1], arc[i, 2] = x, y, heading


@compiled()
def _free_time(arc, v, goal, half_length, half_width, points, discs, growth):
    """Time until an arc (K, 3) meets something [s], and the least gap on the way [m].

    One that passes the goal, at v, is free from there on. Discs grow by ``growth`` [m/s].
    """
    near = math.hypot(half_length, half_width) + COMFORT
    least = COMFORT
    for i in range(len(arc)):
        t = (i + 1) * TICK
        x, y, heading = arc[i, 0], arc[i, 1], arc[i, 2]
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
            least = min(least, gap - growth * t)
        if least < GAP:
            return t - TICK, least
        if math.hypot(goal[0] - x, goal[1] - y) < v * TICK:
            break
    return HORIZON, least
