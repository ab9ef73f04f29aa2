"""ORCA with nothing but a LiDAR: discs tracked in the scans, one linear programme per step.

Discs and walls come from the scans (``clusters``); optimal reciprocal collision avoidance (van den
Berg et al., "Reciprocal n-Body Collision Avoidance", 2011) finds the velocity nearest to the
straight way to the goal, and the drive follows it. An omnidirectional robot does so as it is. A
differential one turns towards that velocity and drives as much of it as lies ahead and is free. As
it cannot follow exactly, the robot takes itself for a little larger than it is (Alonso-Mora et al.,
"Optimal reciprocal collision avoidance for multiple non-holonomic robots", DARS 2010).

A robot with limits on its acceleration or latency looks farther ahead, as people do who cannot stop
at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Annotated

import numpy as np
from crowdbench_agents.geometry.clusters import Scene, Tracker
from crowdbench_agents.geometry.footprint import arc_gap, line_gap
from crowdbench_agents.geometry.scan import ScanGeometry
from crowdbench_agents.geometry.steering import reachable, slow_to_react, turn_towards
from crowdbench_agents.geometry.under_way import CommandsUnderWay, into_frame, relative
from numpy.typing import NDArray
from pydantic import Field

import crowdbench

STOP = 0.05
"""Least gap to what is seen during the coming step [m]."""
HORIZONS = 3.0, 1.0
"""Times for which a robot that is slow to react avoids people and what stands [s]."""
NEIGHBOUR_DISTANCE = 5.0
"""Distance beyond which it does not consider people [m]."""


class Orca(crowdbench.Agent):
    """Reciprocal avoidance of what the LiDAR shows."""

    drives = ("differential", "omnidirectional")
    version = "0.2.0"

    def __init__(
        self,
        responsibility: Annotated[float, Field(ge=0, le=1)] = 1.0,
        margin: Annotated[float, Field(ge=0, le=1)] = 0.05,
    ) -> None:
        """Choose how to behave.

        Args:
            responsibility: share of every evasion that the robot takes on; people who do not
                see it take on none.
            margin: by how much the robot's radius is enlarged [m].
        """
        self._responsibility = responsibility
        self._margin = margin

    def reset(self, robot: crowdbench.RobotSpec, seed: int) -> None:
        """Forget the last episode; there is no randomness."""
        self._robot = robot
        self._tracker = Tracker(robot)
        self._scan = ScanGeometry(robot)
        self._under_way = CommandsUnderWay(robot)
        self._solve = (
            partial(crowdbench.orca_velocities_with, *HORIZONS, NEIGHBOUR_DISTANCE)
            if slow_to_react(robot)
            else crowdbench.orca_velocities
        )

    def act(self, observation: crowdbench.Observation) -> crowdbench.Action:
        """Return the command that follows the ORCA velocity best."""
        robot, then = self._robot, self._under_way.foresee(observation)
        x, y, heading = then.pose.tolist()
        cosine, sine = math.cos(heading), math.sin(heading)
        ahead, aside = np.array([cosine, sine]), np.array([-sine, cosine])
        goal_x, goal_y = then.goal.tolist()
        distance = max(math.hypot(goal_x, goal_y), 1e-6)
        speed = min(robot.speed[1], distance / robot.control_period)
        preferred = (goal_x * ahead + goal_y * aside) * speed / distance
        scene = self._tracker.update(observation)
        sideways = robot.drive == "omnidirectional"
        moving = then.velocity[0] * ahead
        if sideways:
            moving = moving + then.velocity[1] * aside
        wanted_x, wanted_y = self._avoid(np.array([x, y]), moving, preferred, scene).tolist()
        forward = cosine * wanted_x + sine * wanted_y
        left = cosine * wanted_y - sine * wanted_x
        # Braking is for what stands still: pedestrians are avoided better by moving.
        points = into_frame(
            self._scan.points(self._tracker.without_moving(observation, scene)),
            relative(observation.pose.astype(float), then.pose.astype(float)),
        )
        velocity = then.velocity.astype(float)
        if sideways:
            forward = np.clip(forward, *robot.speed)
            left = np.clip(left, *robot.lateral_speed)
            action = self._brake(line_gap, forward, left, velocity, points)
        else:
            action = self._brake(arc_gap, *self._follow(forward, left), velocity, points)
        return self._under_way.send(action)

    def _avoid(
        self,
        position: NDArray[np.float64],
        velocity: NDArray[np.float64],
        preferred: NDArray[np.float64],
        scene: Scene,
    ) -> NDArray[np.float64]:
        """The ORCA velocity (2,) in the odometry frame [m/s]."""
        robot = self._robot
        moving, still = scene.discs[scene.moving], scene.discs[~scene.moving]
        places = moving[:, :2] + self._under_way.time * moving[:, 2:4]
        out = np.empty((1, 2))
        self._solve(
            position[None],
            velocity[None],
            preferred[None],
            np.array([robot.speed[1]]),
            np.array([robot.radius + self._margin]),
            np.ones((1, len(moving)), dtype=np.bool_),
            places,
            np.ascontiguousarray(moving[:, 2:4]),
            float(moving[:, 4].max(initial=0.0)),
            self._responsibility,
            np.ascontiguousarray(still[:, [0, 1, 4]]),
            scene.segments,
            robot.control_period,
            out,
        )
        return out[0]

    def _follow(self, forward: float, left: float) -> tuple[float, float]:
        """Turn towards a velocity in the robot frame, driving what of it lies ahead."""
        robot = self._robot
        bearing, speed = math.atan2(left, forward), math.hypot(forward, left)
        if speed < 0.02:
            return 0.0, 0.0
        turn = float(np.clip(turn_towards(robot, bearing), *robot.turn_rate))
        # Halfway through the turn the robot faces the mean direction of this step.
        off = bearing - turn * robot.control_period / 2
        return speed * max(0.0, math.cos(off)), turn

    def _brake(
        self,
        gap_of: Callable[..., float],
        first: float,
        second: float,
        velocity: NDArray[np.float64],
        points: NDArray[np.float64],
    ) -> tuple[float, float]:
        """The largest share of an action with which the coming step touches no point.

        Along an arc (``arc_gap``) the turn rate stays; along a line both speeds shrink. With limits
        on its acceleration a robot that does ``velocity`` (2,) now does not do any action at once,
        nor stops at once after the step.
        """
        robot = self._robot
        limits = robot.acceleration or (np.inf, np.inf)
        for share in (1.0, 0.75, 0.5, 0.25, 0.0):
            action = share * first, second if gap_of is arc_gap else share * second
            doing = reachable(robot, action, (velocity[0], velocity[1]))
            braking = [abs(speed) / limit for speed, limit in zip(doing, limits, strict=True)]
            # At this speed for as long as takes it as far as it gets while it brakes.
            more = braking[0] / 2 if gap_of is arc_gap else max(braking) / 2
            duration = robot.control_period + more
            checks = 4 * math.ceil(duration / robot.control_period)
            gap = gap_of(*doing, duration, checks, robot.length / 2, robot.width / 2, points)
            if gap > STOP:
                break
        return action
