"""Physics steps short enough that nobody passes through anything.

Chipmunk moves bodies first and looks for contacts afterwards, so a body must not move farther in
one step than it can be pushed back from: less than half of its own size.
"""

from __future__ import annotations

import itertools
import math

from crowdbench.compiled import compiled
from crowdbench.scenario import Scenario, ScenarioError
from crowdbench.scenario.room import robot_radius
from crowdbench.simulation.kinematics import Drive, Velocity

SHARE = 0.5
"""How far a body moves in one physics step at most, in half extents of the smallest body."""
DEEPEST = 0.8
"""How far a body that keeps pushing gets into a wall at most, likewise."""
MOST = 1000
"""Physics steps of a control period at most."""
_SOFT, _STIFF = 1e-8, 0.0
"""Share of an overlap that is left after a second."""


def half_extent(scenario: Scenario) -> float:
    """Of the smallest body that moves [m]."""
    robots, people = scenario.robots, scenario.pedestrians
    sizes = [robots.length / 2, robots.width / 2]
    return min([*sizes, people.radii[0]] if people.count else sizes)


def body_speed(scenario: Scenario, drive: Drive, velocity: Velocity) -> float:
    """Of a robot's fastest point, with what its drive is doing [m/s]."""
    _, _, speed = drive.travel(0.0, velocity)
    return abs(speed) + robot_radius(scenario.robots) * abs(drive.turn_rate(velocity))


def check_speeds(scenario: Scenario, drive: Drive, pedestrian_speed: float) -> None:
    """See that the scenario can be simulated at its top speeds.

    Args:
        scenario: names period and sizes.
        drive: bounds what robots do.
        pedestrian_speed: of the fastest pedestrian [m/s].

    Raises:
        ScenarioError: it needs too many physics steps; the message names the fields.
    """
    corners = itertools.product(*zip(drive.low.tolist(), drive.high.tolist(), strict=True))
    speeds = [body_speed(scenario, drive, corner) for corner in corners]
    if scenario.pedestrians.count:
        speeds.append(pedestrian_speed)
    physics(scenario, max(speeds))


def physics(scenario: Scenario, speed: float) -> tuple[int, float]:
    """Choose the physics of one control period.

    Args:
        scenario: ``substeps`` is the least number of steps.
        speed: of the fastest body [m/s].

    Returns:
        Number of physics steps, and the share of an overlap that is left after a second.

    Raises:
        ScenarioError: more than ``MOST`` steps would be needed.
    """
    period, extent = scenario.control_period, half_extent(scenario)
    substeps, bias = steps_and_bias(speed, period, extent, scenario.substeps)
    if substeps == 0:
        needed = math.ceil(speed * period / (SHARE * extent))
        raise ScenarioError(
            f"scenario {scenario.name!r}: at {speed:g} m/s a body of half extent {extent:g} m "
            f"(robots.length, robots.width, pedestrians.radius) needs {needed:,} physics steps "
            f"per control_period of {period:g} s; allowed: {MOST:,}, "
            f"control_period <= {MOST * SHARE * extent / speed:.3g}"
        )
    return substeps, bias


@compiled()
def steps_and_bias(speed, period, extent, least):  # type: ignore[no-untyped-def]
    """What ``physics`` chooses; no steps where these would be too many."""
    needed = speed * period / (SHARE * extent)
    if not needed <= MOST:
        return 0, _STIFF
    substeps = max(least, math.ceil(needed))
    duration = period / substeps
    # A body that keeps pushing sinks in until as much of the overlap is taken back as is added.
    depth = speed * duration / (1 - _SOFT**duration)
    return substeps, _SOFT if depth <= DEEPEST * extent else _STIFF
