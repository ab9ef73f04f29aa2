"""Plain facts that leave the simulation: contacts and the intents of pedestrians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ContactKind = Literal["pedestrian", "obstacle", "wall", "robot"]

INTENTS = ("keep", "return", "divert")
"""What a pedestrian will do with its leg; intents are stored as indices into this."""


@dataclass(frozen=True)
class Contact:
    """What a robot touched, and how fast each side closed in at that moment.

    Attributes:
        kind: what was touched.
        index: which pedestrian, obstacle, wall or robot.
        robot_speed: the robot's speed along the line to the other, towards it [m/s].
        other_speed: the other's speed along that line, towards the robot [m/s].
    """

    kind: ContactKind
    index: int
    robot_speed: float
    other_speed: float
