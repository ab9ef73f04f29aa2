"""What the robot costs the people: the same episode with and without it.

What a person draws does not depend on the robot, so the same seed without the robot says where
everybody would have been. Both twins run for the same time, ``DURATION``, and the robot leaves
where its episode ended, so that dying early earns nothing. Crowds are chaotic: a third twin
without the robot, whose people are a millimetre off after the first control period, says how large
the numbers are when there is nothing to measure.

A person's way is compared by goals, so these must not depend on where the person was pushed to:
``undefined`` says of which scenarios that holds. Who has turned to another goal on the way in only
one of the twins so far is left out of delay and detour; ``compared`` is the share of the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Scenario
from crowdbench.simulation.kinematics import make_drive
from crowdbench.simulation.pedestrians import ARRIVAL
from crowdbench.simulation.world import World

DURATION = 20.0
"""For which the twins run [s]."""
NUDGE = 1e-3
"""How far off the people of the third twin are [m]."""

Array = NDArray[np.float64]


class DisturbanceError(ValueError):
    """Commands or a scenario that no twins can be simulated of; the message says why."""


class Shift(NamedTuple):
    """By how much people are elsewhere than in the twin without the robot.

    Attributes:
        delay: mean over people of how far they are behind on the way to their own goals, in time
            at their preferred speed [s].
        detour: mean over people of the extra way to the same goals [m].
        displacement: the largest mean distance over people at any time [m].
        compared: share of the people that delay and detour are over.
    """

    delay: float
    detour: float
    displacement: float
    compared: float


class Disturbance(NamedTuple):
    """What the robot shifts, and what chaos alone shifts; NaN without people."""

    by_robot: Shift
    noise_floor: Shift


class _Walks(NamedTuple):
    """One twin: N + 1 states of P people."""

    position: Array
    """(N + 1, P, 2) [m]"""
    goal: Array
    """(N + 1, P, 2) where each was going when the state came about [m]"""
    speed: Array
    """(P,) preferred [m/s]"""
    first_velocity: Array
    """(P, 2) in the first control period [m/s]"""


class _Leg(NamedTuple):
    """One goal of a person, and where the person was when it was given up for the next."""

    goal: Array
    end: Array


def disturbance(
    scenario: Scenario, seed: int, commands: Sequence[NDArray[np.float64]]
) -> Disturbance:
    """Simulate the twins of an episode and compare them.

    Args:
        scenario: the world.
        seed: episode seed.
        commands: for each robot (T_r, 2), as in ``Episode.commands``. A robot leaves the scene
            after its last one, or when it touches something.

    Raises:
        DisturbanceError: ``undefined`` for the scenario, or commands that are not (T, 2) finite
            numbers for each robot.
        ScenarioError: the scenario has no room.
    """
    if reason := undefined(scenario):
        raise DisturbanceError(f"scenario {scenario.name!r}: {reason}")
    if len(commands) != scenario.robots.count:
        raise DisturbanceError(
            f"commands: {len(commands)} robots, expected {scenario.robots.count}"
        )
    for r, told in enumerate(commands):
        if np.shape(told) != (len(told), 2) or not np.isfinite(told).all():
            raise DisturbanceError(
                f"commands of robot_{r}: expected finite numbers of shape (T, 2)"
            )
    nobody = [np.empty((0, 2))] * len(commands)
    without = _simulate(scenario, seed, nobody)
    count = len(without.speed)
    angle = np.arange(count) * np.pi * (3 - np.sqrt(5))  # each person another way
    nudge = NUDGE / scenario.control_period * np.column_stack([np.cos(angle), np.sin(angle)])
    nudged = _simulate(scenario, seed, nobody, first_velocity=without.first_velocity + nudge)
    with_robot = _simulate(scenario, seed, commands)
    return Disturbance(_shift(with_robot, without), _shift(nudged, without))


def undefined(scenario: Scenario) -> str:
    """Why twins of a scenario cannot be compared: field, value, allowed; empty if they can."""
    people = scenario.pedestrians
    if people.control == "agents":
        return (
            "pedestrians.control: 'agents': what steers them sees the robot, and is not simulated "
            "again; allowed: 'scripted'"
        )
    if people.model == "recorded":
        return (
            "pedestrians.model: 'recorded': people come and go by the clock, whatever the robot "
            "does; allowed: any other"
        )
    if people.on_arrival == "new_goal" and people.leg_from == "position":
        return (
            "pedestrians.leg_from: 'position': where people go depends on where the robot has "
            "pushed them; allowed: 'goal'"
        )
    return ""


def _simulate(
    scenario: Scenario,
    seed: int,
    commands: Sequence[NDArray[np.float64]],
    first_velocity: Array | None = None,
) -> _Walks:
    """One twin; ``first_velocity`` (P, 2) is how people walk in the first control period."""
    world, drive = World(scenario, seed), make_drive(scenario)
    people = world.pedestrians
    position, goal = [people.position.copy()], [people.goal.copy()]
    steer = {} if first_velocity is None else dict(enumerate(first_velocity))
    velocity = people.velocity.copy()
    for step in range(round(DURATION / scenario.control_period)):
        told = np.zeros((len(commands), 2))
        for r in np.flatnonzero(world.active).tolist():
            if step >= len(commands[r]) or r in world.contacts:
                world.remove(r)
            else:
                told[r] = np.clip(commands[r][step], drive.low, drive.high)
        world.step(told, steer if step == 0 else None)
        people = world.pedestrians
        if step == 0:
            velocity = people.velocity.copy()
        position.append(people.position.copy())
        goal.append(people.goal.copy())
    return _Walks(np.array(position), np.array(goal), people.speed.copy(), velocity)


def _shift(walks: _Walks, without: _Walks) -> Shift:
    count = len(without.speed)
    if not count:
        return Shift(np.nan, np.nan, np.nan, np.nan)
    walked, freely = (
        np.linalg.norm(np.diff(twin.position, axis=0), axis=2).sum(axis=0)
        for twin in (walks, without)
    )
    behind = np.array([_behind(_legs(walks, p), _legs(without, p)) for p in range(count)])
    moves = without.speed > 0
    apart = np.linalg.norm(walks.position - without.position, axis=2)
    return Shift(
        delay=_mean(behind[moves] / without.speed[moves]),
        detour=_mean(walked + behind - freely),
        displacement=float(apart.mean(axis=1).max()),
        compared=float(np.mean(np.isfinite(behind))),
    )


def _legs(twin: _Walks, p: int) -> list[_Leg]:
    """The goals of a person in their order; the last leg ends where the time does."""
    goals, places = twin.goal[:, p], twin.position[:, p]
    # A goal of a state was chosen in the state before.
    changes = np.flatnonzero(np.any(goals[1:] != goals[:-1], axis=1))
    ends = [*changes.tolist(), len(goals) - 1]
    return [_Leg(goals[end], places[end]) for end in ends]


def _behind(one: list[_Leg], other: list[_Leg]) -> float:
    """How much farther ``one`` still has to go to the goals that both have [m].

    NaN where they have other goals, or where a goal that only one of them has had so far was given
    up before it was reached.
    """
    if len(one) > len(other):
        return -_behind(other, one)
    last = len(one) - 1
    if any(not np.array_equal(a.goal, b.goal) for a, b in zip(one, other, strict=False)):
        return np.nan
    done = other[last:-1]
    if any(math.dist(leg.goal, leg.end) >= ARRIVAL for leg in done):
        return np.nan
    way = math.dist(one[last].goal, one[last].end)
    # What the other has walked of the goals since: its legs end near a goal, not in it.
    for leg, following in zip(done, other[last + 1 :], strict=True):
        way += math.dist(following.goal, leg.end) - math.dist(leg.goal, leg.end)
    return way - math.dist(other[-1].goal, other[-1].end)


def _mean(values: Array) -> float:
    """Over those that are defined; NaN where none is."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan
