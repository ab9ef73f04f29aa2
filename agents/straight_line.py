"""Straight line: drives to the goal and ignores everybody. The floor of every table."""

from __future__ import annotations

import math

from crowdbench_agents.geometry.steering import turn_towards
from crowdbench_agents.geometry.under_way import CommandsUnderWay

import crowdbench


class StraightLine(crowdbench.Agent):
    """Turns towards the goal and drives at full speed, blind to people and walls.

    An omnidirectional robot goes to the goal without turning.
    """

    drives = ("differential", "omnidirectional")
    version = "0.2.0"

    def reset(self, robot: crowdbench.RobotSpec, seed: int) -> None:
        """Remember the robot's limits."""
        self._robot = robot
        self._under_way = CommandsUnderWay(robot)

    def act(self, observation: crowdbench.Observation) -> crowdbench.Action:
        """Return full speed towards the goal, slower while turning to it."""
        goal = self._under_way.foresee(observation).goal
        x, y = goal.tolist()
        if self._robot.drive == "omnidirectional":
            return self._under_way.send(goal * (self._robot.speed[1] / max(math.hypot(x, y), 1e-6)))
        bearing = math.atan2(y, x)
        turn = turn_towards(self._robot, bearing)
        return self._under_way.send((self._robot.speed[1] * max(0.0, math.cos(bearing)), turn))
