"""Drives: what an action means, found by the name that ``robots.drive`` gives.

An action is two numbers for every drive. The drive bounds them, moves the robot by them for one
physics step at a time, and says where and how fast that takes the robot in the world.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.extensions import DRIVES
from crowdbench.registry import UnknownNameError
from crowdbench.scenario import Robots, Scenario, ScenarioError
from crowdbench.simulation.rounding import length

Velocity = tuple[float, float] | list[float]
"""What a drive is doing: an action within all its limits."""


OTHER, DIFFERENTIAL, OMNIDIRECTIONAL = range(3)
"""Drives as compiled code knows them."""


class Drive(ABC):
    """How the robots of a scenario move; it holds limits and no state.

    Attributes:
        low, high: (2,) bounds of an action.
        full_speed: the speed at which not yielding to a pedestrian is judged [m/s].
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    full_speed: float

    def __init__(self, robots: Robots) -> None:
        """Take the limits from a scenario's ``robots``; subclasses set ``low`` and ``high``.

        Raises:
            ValueError: they do not suit this drive; the message names the field.
        """
        self.full_speed = robots.speed[1]
        self._acceleration = robots.acceleration

    def limit(
        self, commands: NDArray[np.float64], velocity: NDArray[np.float64], period: float
    ) -> NDArray[np.float64]:
        """What the robots do when told something, within the limits on acceleration.

        Args:
            commands: (R, 2) actions within ``low`` and ``high``.
            velocity: (R, 2) what they did before.
            period: time for which they keep to it [s].

        Returns:
            (R, 2) velocities of this drive.
        """
        if self._acceleration is None:
            return commands
        reach = np.array(self._acceleration) * period
        return np.clip(commands, velocity - reach, velocity + reach)

    @abstractmethod
    def turn_rate(self, velocity: Velocity) -> float:
        """How fast the robot turns [rad/s], left positive."""

    @abstractmethod
    def advance(
        self, heading: float, velocity: Velocity, duration: float
    ) -> tuple[float, float, float]:
        """Move for one physics step.

        Args:
            heading: at its beginning [rad].
            velocity: what the drive is doing.
            duration: of the step [s].

        Returns:
            Mean velocity x, y in the world [m/s], and the heading after the step [rad].
        """

    @abstractmethod
    def travel(self, heading: float, velocity: Velocity) -> tuple[float, float, float]:
        """Where the robot is going.

        Args:
            heading: [rad].
            velocity: what the drive is doing.

        Returns:
            Unit vector x, y in the world and the speed along it [m/s], negative backwards. The
            vector of a robot that stands is one in which it could go.
        """


class Differential(Drive):
    """Two driven wheels: v ahead [m/s] and turn rate w [rad/s], left positive.

    ``robots.acceleration`` bounds |dv/dt| [m/s^2] and |dw/dt| [rad/s^2].
    """

    def __init__(self, robots: Robots) -> None:
        super().__init__(robots)
        self.low, self.high = np.array([robots.speed, robots.turn_rate]).T

    def turn_rate(self, velocity: Velocity) -> float:
        """The second number itself."""
        return velocity[1]

    def advance(
        self, heading: float, velocity: Velocity, duration: float
    ) -> tuple[float, float, float]:
        """Follow the arc of (v, w) exactly."""
        x, y, after = advance(DIFFERENTIAL, heading, velocity[0], velocity[1], duration)
        return x, y, after

    def travel(self, heading: float, velocity: Velocity) -> tuple[float, float, float]:
        """Along the heading with v."""
        # As ``travel`` does, which would be compiled by itself for this alone.
        return math.cos(heading), math.sin(heading), velocity[0]


class Omnidirectional(Drive):
    """Wheels that roll any way: speeds ahead and to the left [m/s]; the heading stays.

    ``robots.speed`` bounds the first, ``robots.lateral_speed`` the second, and
    ``robots.acceleration`` the change of either [m/s^2].
    """

    def __init__(self, robots: Robots) -> None:
        super().__init__(robots)
        self.low, self.high = np.array([robots.speed, robots.lateral_speed]).T

    def turn_rate(self, velocity: Velocity) -> float:
        """None at all."""
        return 0.0

    def advance(
        self, heading: float, velocity: Velocity, duration: float
    ) -> tuple[float, float, float]:
        """Go straight."""
        x, y, after = advance(OMNIDIRECTIONAL, heading, velocity[0], velocity[1], duration)
        return x, y, after

    def travel(self, heading: float, velocity: Velocity) -> tuple[float, float, float]:
        """Along the velocity; ahead where there is none."""
        x, y, speed = travel(OMNIDIRECTIONAL, heading, velocity[0], velocity[1])
        return x, y, speed


def kernel_of(drive: Drive) -> int:
    """Which of the compiled drives this is; OTHER for one from elsewhere, subclasses included."""
    return {Differential: DIFFERENTIAL, Omnidirectional: OMNIDIRECTIONAL}.get(type(drive), OTHER)


@compiled()
def advance(kind, heading, first, second, duration):  # type: ignore[no-untyped-def]
    """``Drive.advance`` of a compiled drive that is doing (first, second)."""
    if kind == DIFFERENTIAL:
        # The chord of an arc of angle w t has the length v t sin(w t / 2) / (w t / 2) and lies half
        # the angle off the heading.
        half_turn = second * duration / 2
        chord = first * math.sin(half_turn) / half_turn if half_turn != 0.0 else first
        middle = heading + half_turn
        return chord * math.cos(middle), chord * math.sin(middle), middle + half_turn
    cosine, sine = math.cos(heading), math.sin(heading)
    return cosine * first - sine * second, sine * first + cosine * second, heading


@compiled()
def travel(kind, heading, first, second):  # type: ignore[no-untyped-def]
    """``Drive.travel`` of a compiled drive that is doing (first, second)."""
    cosine, sine = math.cos(heading), math.sin(heading)
    if kind == DIFFERENTIAL:
        return cosine, sine, first
    speed = length(first, second)
    if speed == 0.0:
        return cosine, sine, 0.0
    first, second = first / speed, second / speed
    return cosine * first - sine * second, sine * first + cosine * second, speed


def poses_ahead(
    drive: Drive,
    period: float,
    pose: NDArray[np.floating],
    velocity: NDArray[np.floating],
    commands: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Where robots are after some commands; nothing is in their way.

    Args:
        drive: of all of them.
        period: for which each command acts [s].
        pose: (N, 3) before.
        velocity: (N, 2) what they do before.
        commands: (N, K, 2) actions within the drive's bounds.

    Returns:
        (N, 3) poses after the last.
    """
    after, doing = pose.astype(np.float64), velocity.astype(np.float64)
    for k in range(commands.shape[1]):
        doing = drive.limit(commands[:, k], doing, period)
        for row, does in zip(after, doing.tolist(), strict=True):
            x, y, row[2] = drive.advance(float(row[2]), does, period)
            row[:2] += x * period, y * period
    return after


def make_drive(scenario: Scenario) -> Drive:
    """The drive that a scenario names.

    Raises:
        ScenarioError: it cannot be loaded, or refuses the scenario's limits.
    """
    name = scenario.robots.drive
    where = f"scenario {scenario.name!r}: robots.drive"
    try:
        kind = DRIVES[name]
    except UnknownNameError as error:
        raise ScenarioError(f"{where}: {error}") from error
    try:
        return kind(scenario.robots)
    except ValueError as error:
        raise ScenarioError(f"{where}: {name!r}: {error}") from error
