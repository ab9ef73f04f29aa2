"""What the robot costs the people: the same episode with and without it.

What a person draws does not depend on the robot, so the same seed without the robot says where
everybody would have been. Both twins run for the same time, ``DURATION``, and the robot leaves
where its episode ended. Crowds are chaotic: a third twin without the robot, whose people are a
millimetre off after the first control period, says how large the numbers are when there is nothing
to measure.

People of streams do not enter near a robot. That is how the simulation keeps out of trouble and
nothing that a robot does to anybody, so the twins without it keep free what it kept free.

A person's way is compared by goals, so these must not depend on where the person was pushed to:
``undefined`` says of which scenarios that holds. How far behind somebody is follows from the way
without the robot, walls and other people included: from its point that is nearest to where the
person is now, on the same leg. Those who get other goals in the two twins after all (who is called
back to a queue may be anywhere, and who is held up may be interrupted where it would have arrived)
are left out of delay and detour, and ``compared`` is the share of those who are left.

Recorded people come and go by the recording's clock, in all twins alike, and are compared while it
has them. Who could not appear because a robot stood there has waited, and is behind by what the
recording walked meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Scenario
from crowdbench.simulation.kinematics import make_drive
from crowdbench.simulation.routes import has_routes
from crowdbench.simulation.world import Pedestrians, World

DURATION = 20.0
"""For which the twins run [s]."""
JUMP = 1.0
"""Who moves this much farther in a control period than it can walk has entered anew [m]."""
NUDGE = 1e-3
"""How far off the people of the third twin are [m]."""
STANDS = 0.1
"""Who is recorded at less than this mean speed stands, and has no delay [m/s]."""

Array = NDArray[np.float64]


class DisturbanceError(ValueError):
    """Commands or a scenario that no twins can be simulated of; the message says why."""


class _Robots(NamedTuple):
    """What N control periods began with: (N, R, 3) poses and (N, R) who was in the scene."""

    pose: Array
    there: NDArray[np.bool_]


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


@dataclass(frozen=True)
class _Walks:
    """One twin: N + 1 states of P people.

    Attributes:
        position: (N + 1, P, 2) [m], NaN while somebody is not there.
        goal: (N + 1, P, 2) where each was going when the state came about [m].
        speed: (P,) preferred, of recorded people the mean [m/s].
        first_velocity: (P, 2) in the first control period [m/s].
        way: (N + 1, P) walked so far [m].
        entries: (N + 1, P) how often each has entered anew, elsewhere.
    """

    position: Array
    goal: Array
    speed: Array
    first_velocity: Array
    way: Array
    entries: NDArray[np.int64]

    @classmethod
    def of_states(
        cls, position: Array, goal: Array, speed: Array, first_velocity: Array, period: float
    ) -> _Walks:
        """Tell steps from jumps, of which nobody walks any, and add up both."""
        steps = np.linalg.norm(np.diff(position, axis=0), axis=2)
        jumps = steps > speed * period + JUMP
        begin = np.zeros((1, len(speed)))
        walked = np.where(jumps, 0.0, np.nan_to_num(steps))
        way = np.concatenate([begin, np.cumsum(walked, axis=0)])
        entries = np.concatenate([begin.astype(np.int64), np.cumsum(jumps, axis=0)])
        return cls(position, goal, speed, first_velocity, way, entries)

    @property
    def there(self) -> NDArray[np.bool_]:
        """(N + 1, P) who is in the scene."""
        return np.isfinite(self.position[..., 0])

    def of(self, p: int) -> _Walk:
        """What one person did while it was there."""
        there = self.there[:, p]
        goals = self.goal[there, p]
        # A goal of a state was chosen in the state before.
        changes = np.flatnonzero(np.any(goals[1:] != goals[:-1], axis=1))
        ends = np.append(changes, len(goals) - 1)
        return _Walk(
            self.position[there, p],
            self.way[there, p],
            self.entries[there, p],
            goals[ends],
            np.append(0, ends),
        )


class _Walk(NamedTuple):
    """One person: N + 1 places, the way to each, and G goals in their order.

    Leg i goes from state ``bounds[i]`` to state ``bounds[i + 1]``.
    """

    places: Array
    way: Array
    entries: NDArray[np.int64]
    goals: Array
    bounds: NDArray[np.int64]

    def nearest(self, leg: int, place: Array) -> float:
        """The way up to the point of a leg that is nearest to a place [m]."""
        states = slice(self.bounds[leg], self.bounds[leg + 1] + 1)
        places, way, entries = self.places[states], self.way[states], self.entries[states]
        if len(places) == 1:
            return float(way[0])
        ahead = np.diff(places, axis=0)
        ahead[np.diff(entries) > 0] = 0.0  # nobody is on the way of a jump
        squared = np.maximum((ahead**2).sum(axis=1), 1e-300)
        share = np.clip(((place - places[:-1]) * ahead).sum(axis=1) / squared, 0.0, 1.0)
        gaps = np.linalg.norm(place - places[:-1] - share[:, None] * ahead, axis=1)
        best = int(np.argmin(gaps))
        if math.dist(place, places[-1]) <= gaps[best]:
            return float(way[-1])
        return float(way[best] + share[best] * (way[best + 1] - way[best]))


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
    with_robot, robots = _simulate(scenario, seed, commands)
    nobody = [np.empty((0, 2))] * len(commands)
    without, _ = _simulate(scenario, seed, nobody, robots)
    count = len(without.speed)
    angle = np.arange(count) * np.pi * (3 - np.sqrt(5))  # each person another way
    nudge = NUDGE / scenario.control_period * np.column_stack([np.cos(angle), np.sin(angle)])
    nudged, _ = _simulate(scenario, seed, nobody, robots, without.first_velocity + nudge)
    return Disturbance(_shift(with_robot, without), _shift(nudged, without))


def undefined(scenario: Scenario) -> str:
    """Why twins of a scenario cannot be compared: field, value, allowed; empty if they can."""
    people = scenario.pedestrians
    if not people.count:
        return ""
    if people.control == "agents":
        return (
            "pedestrians.control: 'agents': what steers them sees the robot, and is not simulated "
            "again; allowed: 'scripted'"
        )
    drawn_by_place = people.on_arrival == "new_goal" and people.leg_from == "position"
    if drawn_by_place and people.model != "recorded" and not has_routes(scenario):
        return (
            "pedestrians.leg_from: 'position': where people go depends on where the robot has "
            "pushed them; allowed: 'goal'"
        )
    return ""


def _simulate(
    scenario: Scenario,
    seed: int,
    commands: Sequence[NDArray[np.float64]],
    others: _Robots | None = None,
    first_velocity: Array | None = None,
) -> tuple[_Walks, _Robots]:
    """One twin, and its robots.

    Args:
        scenario: the world.
        seed: episode seed.
        commands: of the robots.
        others: robots of another twin, which are not here but where nobody enters either.
        first_velocity: (P, 2) how people walk in the first control period.
    """
    world, drive = World(scenario, seed), make_drive(scenario)
    people = world.pedestrians
    position, goal = [_places(people)], [people.goal.copy()]
    pose, there = [], []
    steer = {} if first_velocity is None else dict(enumerate(first_velocity))
    velocity = people.velocity.copy()
    for step in range(round(DURATION / scenario.control_period)):
        told = np.zeros((len(commands), 2))
        for r in np.flatnonzero(world.active).tolist():
            if step >= len(commands[r]) or r in world.contacts:
                world.remove(r)
            else:
                told[r] = np.clip(commands[r][step], drive.low, drive.high)
        if others is not None:
            world.reserve(others.pose[step], others.there[step])
        pose.append(world.pose.copy())
        there.append(world.active.copy())
        world.step(told, steer if step == 0 else None)
        people = world.pedestrians
        if step == 0:
            velocity = people.velocity.copy()
        position.append(_places(people))
        goal.append(people.goal.copy())
    walks = _Walks.of_states(
        np.array(position),
        np.array(goal),
        _paces(scenario, people),
        velocity,
        scenario.control_period,
    )
    return walks, _Robots(np.array(pose), np.array(there))


def _places(people: Pedestrians) -> Array:
    """(P, 2) where everybody is, NaN for those who are not there [m]."""
    return np.where(people.present[:, None], people.position, np.nan)


def _paces(scenario: Scenario, people: Pedestrians) -> Array:
    """(P,) speeds by which people are late, 0 for those who stand [m/s]."""
    least = STANDS if scenario.pedestrians.model == "recorded" else 0.0
    return np.where(people.speed >= least, people.speed, 0.0)


def _shift(walks: _Walks, without: _Walks) -> Shift:
    expected = without.there
    people = np.flatnonzero(expected.any(axis=0))
    if not len(people):
        return Shift(np.nan, np.nan, np.nan, np.nan)
    held = expected & ~walks.there
    behind = _missed(held, without)
    for p in np.flatnonzero(walks.there.any(axis=0)).tolist():
        behind[p] += _behind(walks.of(p), without.of(p))
    detour = walks.way[-1] + behind - without.way[-1]
    walkers = people[without.speed[people] > 0]
    apart = np.linalg.norm(walks.position - without.position, axis=2)
    # Who has entered anew in one twin is nowhere near the same person in the other.
    apart[walks.entries != without.entries] = np.nan
    # Who is held back waits where it would have appeared.
    begin = without.position[expected.argmax(axis=0), np.arange(len(without.speed))]
    apart[held] = np.linalg.norm(begin - without.position, axis=2)[held]
    known = np.isfinite(apart).any(axis=1)
    return Shift(
        delay=_mean(behind[walkers] / without.speed[walkers]),
        detour=_mean(detour[people]),
        displacement=float(np.nanmean(apart[known], axis=1).max()),
        compared=float(np.mean(np.isfinite(behind[people]))),
    )


def _missed(held: NDArray[np.bool_], without: _Walks) -> Array:
    """(P,) what people walk without the robot while it holds them back [m]."""
    last = len(held) - 1
    appears = np.minimum(last + 1 - held[::-1].argmax(axis=0), last)
    way: Array = np.take_along_axis(without.way, appears[None], axis=0)[0]
    return np.where(held.any(axis=0), way, 0.0)


def _behind(one: _Walk, other: _Walk) -> float:
    """How much farther the other has come along its way to the goals that both have had [m].

    That is what is left of the other's way from the place on it that is nearest to where ``one``
    ends, on the same leg; less the same the other way round. NaN where goals differ.
    """
    shared = min(len(one.goals), len(other.goals))
    if not np.array_equal(one.goals[:shared], other.goals[:shared]):
        return np.nan
    left = 0.0
    for sign, here, there in ((1.0, one, other), (-1.0, other, one)):
        leg = len(here.goals) - 1
        if leg < len(there.goals):
            left += sign * (there.way[-1] - there.nearest(leg, here.places[-1]))
    return float(left)


def _mean(values: Array) -> float:
    """Over those that are defined; NaN where none is."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan
