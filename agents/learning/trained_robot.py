"""The robot that networks were trained with, which weights say, and how another one differs."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

import crowdbench
from crowdbench.messages import explain

Pair = tuple[float, float]


class TrainedRobot(BaseModel):
    """What networks have never seen otherwise; the defaults are the robot of all 0.1.0 weights.

    Attributes:
        drive: what an action means.
        footprint: length, width [m].
        speed, turn_rate: lowest and highest [m/s], [rad/s].
        acceleration: limits on the change of either number of an action in a second, or None.
        control_period: time between two actions [s].
        beams, field_of_view, lidar_range: of the LiDAR, in beams, degrees and metres.
        latency: whole control periods until a command acts.
        lidar_mount: where on the robot the LiDAR is: x, y [m], heading [rad].
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    drive: str = "differential"
    footprint: Pair = (0.4, 0.3)
    speed: Pair = (0.0, 1.0)
    turn_rate: Pair = (-1.5, 1.5)
    acceleration: Pair | None = None
    control_period: float = 0.2
    beams: int = 180
    field_of_view: float = 360.0
    lidar_range: float = 6.0
    latency: int = 0
    lidar_mount: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, robot: crowdbench.RobotSpec) -> TrainedRobot:
        """What there is to say about a robot."""
        angles = robot.lidar_angles
        # Beams of a full circle start ahead, those of a part of it at its right edge.
        full = len(angles) > 1 and angles[0] == robot.lidar_mount[2]
        view = 360.0 if full else float(np.rad2deg(angles[-1] - angles[0]))
        return cls(
            drive=robot.drive,
            footprint=(robot.length, robot.width),
            speed=robot.speed,
            turn_rate=robot.turn_rate,
            acceleration=robot.acceleration,
            control_period=robot.control_period,
            beams=len(angles),
            field_of_view=view,
            lidar_range=robot.lidar_range,
            latency=robot.latency,
            lidar_mount=robot.lidar_mount,
        )

    @classmethod
    def from_training(cls, training: Mapping[str, Any], path: Path) -> TrainedRobot:
        """The robot that weights say they were trained with.

        Args:
            training: how they came about, as in ``save_weights``.
            path: of their file.

        Raises:
            ValueError: what they say is no robot; the message names the file.
        """
        try:
            return cls.model_validate(training.get("robot", {}))
        except ValidationError as error:
            raise ValueError(f"weights {path}: robot: {explain(error, cls)}") from error

    def differences(self, robot: crowdbench.RobotSpec) -> list[str]:
        """What is otherwise with a robot, each with what it was in training."""
        return [
            f"{what} {now} (in training {then})"
            for (what, then), (_, now) in zip(
                self._in_words(), TrainedRobot.of(robot)._in_words(), strict=True
            )
            if then != now
        ]

    def _in_words(self) -> Iterator[tuple[str, str]]:
        limits = self.acceleration
        yield "drive", self.drive
        yield "footprint", "{:.4g} x {:.4g} m".format(*self.footprint)
        yield "speed", "{:.4g} to {:.4g} m/s".format(*self.speed)
        yield "turn rate", "{:.4g} to {:.4g} rad/s".format(*self.turn_rate)
        yield (
            "acceleration limits",
            "none" if limits is None else "{:.4g} m/s^2, {:.4g} rad/s^2".format(*limits),
        )
        yield "control period", f"{self.control_period:.4g} s"
        yield "LiDAR beams", str(self.beams)
        yield "LiDAR field of view", f"{self.field_of_view:.4g} deg"
        yield "LiDAR range", f"{self.lidar_range:.4g} m"
        yield "latency", f"{self.latency} control periods"
        yield "LiDAR mount", "{:.4g} m, {:.4g} m, {:.4g} rad".format(*self.lidar_mount)


def warn_of_other_robot(weights: str, trained: TrainedRobot, robot: crowdbench.RobotSpec) -> None:
    """Warn, in one line, where a robot is not the one that weights were trained with.

    Args:
        weights: whose they are and which.
        trained: the robot they were trained with.
        robot: the one to be driven.
    """
    if differences := trained.differences(robot):
        warnings.warn(
            f"{weights} were trained with another robot and may drive this one badly: "
            + ", ".join(differences),
            stacklevel=3,
        )
