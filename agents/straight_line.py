"""Straight line: drives to the goal and ignores everybody. The floor of every table."""

from __future__ import annotations

import math

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

    def act(self, observation: crowdbench.Observation) -> crowdbench.Action:
        """Return full speed towards the goal, slower while turning to it."""
        x, y = observation.goal.tolist()
        if self._robot.drive == "omnidirectional":
            return observation.goal * (self._robot.speed[1] / max(math.hypot(x, y), 1e-6))
        bearing = math.atan2(y, x)
        turn = bearing / self._robot.control_period
        return self._robot.speed[1] * max(0.0, math.cos(bearing)), turn
