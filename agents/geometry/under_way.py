"""Where a robot will be when its next command begins to act: the commands under way, driven ahead.

With ``robots.latency`` a command acts some control periods after it was given, and what the robot
does until then is decided. Whoever plans from where it will be by then, and not from where it is,
plans as if there was no latency.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from crowdbench_agents.geometry.footprint import advance
from numpy.typing import NDArray

import crowdbench
from crowdbench.compiled import compiled

Array = NDArray[np.float64]


class CommandsUnderWay:
    """The commands of one robot that do not act yet.

    Attributes:
        time: until the next command begins to act [s]; 0 without latency.
        commands: (latency, 2) what the robot was told, the next to act first.
    """

    def __init__(self, robot: crowdbench.RobotSpec) -> None:
        """Begin an episode: the robot stands, and nothing is under way."""
        self._robot = robot
        self.time = robot.latency * robot.control_period
        self.commands = np.zeros((robot.latency, 2))
        across = robot.lateral_speed if robot.drive == "omnidirectional" else robot.turn_rate
        self._low, self._high = np.array([robot.speed, across]).T

    def send(self, action: crowdbench.Action) -> crowdbench.Action:
        """Remember an action that is given now; returns it as it is."""
        if self._robot.latency:
            told = np.clip(np.asarray(action, dtype=np.float64), self._low, self._high)
            self.commands = np.vstack([self.commands[1:], told])
        return action

    def foresee(self, observation: crowdbench.Observation) -> crowdbench.Observation:
        """What will be observed when the next command begins to act, with the scan of now.

        Without latency it is the observation itself.
        """
        if not self._robot.latency:
            return observation
        (pose,), (velocity,), (goal,) = foresee(
            self._robot,
            observation.pose[None],
            observation.velocity[None],
            observation.goal[None],
            self.commands[None],
        )
        return replace(observation, velocity=velocity, goal=goal, pose=pose)


def foresee(
    robot: crowdbench.RobotSpec,
    pose: NDArray[np.float32],
    velocity: NDArray[np.float32],
    goal: NDArray[np.float32],
    commands: Array,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """What N robots of a kind will observe once the commands that are under way have acted.

    Args:
        robot: their drive and limits.
        pose, velocity, goal: (N, 3), (N, 2), (N, 2) as observed now.
        commands: (N, latency, 2) under way, the next to act first.
    """
    after, doing = drive_ahead(robot, pose, velocity, commands)
    here = pose.astype(np.float64)
    shifts = [relative(one, other) for one, other in zip(here, after, strict=True)]
    offsets = [into_frame(one[None], by)[0] for one, by in zip(goal, shifts, strict=True)]
    return (
        after.astype(np.float32),
        doing.astype(np.float32),
        np.array(offsets, dtype=np.float32).reshape(goal.shape),
    )


def drive_ahead(
    robot: crowdbench.RobotSpec,
    pose: NDArray[np.floating],
    velocity: NDArray[np.floating],
    commands: Array,
) -> tuple[Array, Array]:
    """Where a robot is, and what its drive does, after some commands.

    Args:
        robot: its drive, limits on acceleration, and control period.
        pose: (..., 3) before: x, y [m], heading [rad], in any frame that does not move.
        velocity: (..., 2) what the drive does before.
        commands: (..., K, 2) actions within its bounds, each for a control period.

    Returns:
        Pose (..., 3) and velocity (..., 2) after them.
    """
    after: Array = np.array(pose, dtype=np.float64)
    doing: Array = np.array(velocity, dtype=np.float64)
    _drive(
        after.reshape(-1, 3),
        doing.reshape(-1, 2),
        np.ascontiguousarray(commands, dtype=np.float64).reshape(-1, *np.shape(commands)[-2:]),
        np.array(robot.acceleration or (np.inf, np.inf)) * robot.control_period,
        robot.control_period,
        robot.drive != "omnidirectional",
    )
    return after, doing


def relative(here: Array, there: Array) -> Array:
    """(3,) the pose ``there`` in the frame of the pose ``here``; the turn is not wrapped."""
    x, y = into_frame(there[None, :2], here)[0]
    return np.array([x, y, there[2] - here[2]])


def into_frame(points: Array, pose: Array) -> Array:
    """(N, 2) points in the frame of a pose (3,) that is given where they are."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    x, y = points[:, 0] - pose[0], points[:, 1] - pose[1]
    return np.column_stack([cosine * x + sine * y, cosine * y - sine * x])


@compiled()
def _drive(pose, velocity, commands, reach, period, turns):
    """Change pose (N, 3) and velocity (N, 2) by commands (N, K, 2)."""
    for n in range(len(pose)):
        for k in range(commands.shape[1]):
            for i in range(2):
                now = velocity[n, i]
                velocity[n, i] = min(max(commands[n, k, i], now - reach[i]), now + reach[i])
            x, y, heading = pose[n, 0], pose[n, 1], pose[n, 2]
            first, second = velocity[n, 0], velocity[n, 1]
            if turns:
                x, y, heading = advance(x, y, heading, first, second, period)
            else:
                cosine, sine = math.cos(heading), math.sin(heading)
                x += period * (cosine * first - sine * second)
                y += period * (sine * first + cosine * second)
            pose[n, 0], pose[n, 1], pose[n, 2] = x, y, heading
