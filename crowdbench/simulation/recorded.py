"""People who walk as recorded: when and where, and how those who are reactive leave their way.

A recording is resampled to the control periods of an episode, from a moment on that the seed
draws. People appear where it has them, walk by it, and leave with it; they do not push each other
or stop at walls, since real ones did not overlap. A reactive one that sees a robot walks by ORCA
against robots and walls alone, towards where the recording has it next, and takes on
``pedestrians.responsibility`` of the evasion; behind its recording, it catches up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import carray
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.scenario.recorded import AHEAD
from crowdbench.simulation.chipmunk import (
    ADD_BODY,
    REINDEX,
    REMOVE_BODY,
    SET_POSITION,
    numbers_at,
    pass_body,
    set_vector,
)
from crowdbench.simulation.orca import NEIGHBOUR_DISTANCE, orca_velocities
from crowdbench.simulation.pedestrians import look, read_robots

if TYPE_CHECKING:
    from crowdbench.people import CrowdRecording

CATCH_UP = 0.5
"""By how much those who have left their way may exceed their recorded speed [m/s]."""
_OFF = 1e-6
"""Who is farther from it than this along either axis has left the way [m]."""
_AWAY, _APART = 10_000.0, 10.0
"""Where people are kept who are not there, and how far from each other [m]."""


@dataclass(frozen=True)
class Tracks:
    """The people of an episode at its control periods.

    Attributes:
        position: (T, P, 2) [m]; NaN where a person is not there.
        period: between two of them [s].
        begin: moment of the recording at which the episode begins [s].
    """

    position: NDArray[np.float64]
    period: float
    begin: float

    @classmethod
    def of(
        cls,
        recording: CrowdRecording,
        origin: NDArray[np.float64],
        begin: float,
        duration: float,
        period: float,
        rows: int,
    ) -> Tracks:
        """Resample a recording.

        Args:
            recording: of the people.
            origin: (2,) its point that becomes the world's origin [m].
            begin: moment at which the episode begins [s].
            duration: of the episode; people are known for ``AHEAD`` longer [s].
            period: of control [s].
            rows: P, for at least as many as are there in that time; the others are never there.
        """
        # Not one more where periods do not add up to it: rows are counted for that time.
        steps = math.floor((duration + AHEAD) / period + 1e-9) + 1
        step, there = recording.at_times(begin + np.arange(steps, dtype=np.float64) * period)
        _, first, track = np.unique(there.tracks, return_index=True, return_inverse=True)
        row = np.argsort(np.argsort(first))  # of each track, by when it appears
        position = np.full((steps, rows, 2), np.nan)
        position[step, row[track]] = there.positions - origin
        return cls(position, period, begin)

    def at(self, step: int) -> NDArray[np.float64]:
        """(P, 2) where everybody is in a control period, NaN after the last one [m]."""
        past = step >= len(self.position)
        return np.full_like(self.position[0], np.nan) if past else self.position[step]

    def velocity(self, step: int) -> NDArray[np.float64]:
        """(P, 2) to the next control period, 0 for those who are not there then [m/s]."""
        velocity = (self.at(step + 1) - self.at(step)) / self.period
        return np.where(np.isnan(velocity), 0.0, velocity)

    def ahead(self, step: int) -> NDArray[np.float64]:
        """(AHEAD / period, P, 2) where everybody will be in the control periods to come [m]."""
        count = round(AHEAD / self.period)
        known = self.position[step + 1 : step + 1 + count]
        past = np.full((count - len(known), *known.shape[1:]), np.nan)
        return np.concatenate([known, past])

    def ways(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """First and last place of each person (P, 2) [m], and the mean speed between (P,) [m/s]."""
        there = np.isfinite(self.position[..., 0])
        first, last = there.argmax(axis=0), len(there) - 1 - there[::-1].argmax(axis=0)
        rows = np.arange(self.position.shape[1])
        moved = np.diff(self.position, axis=0)
        steps = np.sqrt((moved * moved).sum(axis=2))
        duration = np.maximum(last - first, 1) * self.period
        begin, end = self.position[first, rows], self.position[last, rows]
        never = ~there.any(axis=0)
        begin[never], end[never] = away(len(rows))[never], away(len(rows))[never]
        return begin, end, np.where(never, 0.0, np.nansum(steps, axis=0) / duration)


def away(count: int) -> NDArray[np.float64]:
    """(P, 2) places far from everything, for people who are not there [m]."""
    return np.column_stack([_AWAY + _APART * np.arange(count), np.full(count, _AWAY)])


def distances(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, M) between points (N, 2) and (M, 2) [m]."""
    offset = a[:, None] - b
    apart: NDArray[np.float64] = np.sqrt((offset * offset).sum(axis=2))
    return apart


@compiled()
def look_around(
    lanes: NDArray[np.int64],
    worlds: NDArray[np.void],
    robots: NDArray[np.void],
    people: NDArray[np.void],
    sees: NDArray[np.bool_],
) -> None:
    """What precedes the choice of recorded people, who have no legs: they turn their heads.

    Args:
        lanes: (M,) which.
        worlds, robots, people, sees: of all lanes, see ``State``.
    """
    for i in range(len(lanes)):
        look(worlds[lanes[i]], robots[lanes[i]], people[lanes[i]], sees[lanes[i]])


@compiled()
def walk_as_recorded(lanes, worlds, robots, people, obstacles, walls, sees):  # type: ignore[no-untyped-def]
    """Choose velocities that lead everybody to where the recording has them next."""
    number = robots.shape[1]
    robot_position, robot_velocity = np.empty((number, 2)), np.empty((number, 2))
    position, velocity, wanted = np.empty((1, 2)), np.empty((1, 2)), np.empty((1, 2))
    fastest, radius, chosen = np.empty(1), np.empty(1), np.empty((1, 2))
    for i in range(len(lanes)):
        lane = lanes[i]
        world = worlds[lane]
        tracks, step = _tracks_of(world), _step_of(world)
        read_robots(robots[lane], robot_position, robot_velocity)
        for p in range(world.people):
            person = people[lane, p]
            chosen[0, 0], chosen[0, 1] = 0.0, 0.0
            if person.present and _is_there(tracks, step + 1, p):
                x, y, speed = _lead(person.position, tracks[step, p], tracks[step + 1, p], world)
                chosen[0, 0], chosen[0, 1] = x, y
                if _evades(person.position, robot_position, sees[lane, p]):
                    for axis in range(2):
                        position[0, axis] = person.position[axis]
                        velocity[0, axis] = person.velocity[axis]
                        wanted[0, axis] = chosen[0, axis]
                    fastest[0], radius[0] = max(speed, CATCH_UP) + CATCH_UP, person.radius
                    orca_velocities(
                        position,
                        velocity,
                        wanted,
                        fastest,
                        radius,
                        sees[lane, p : p + 1],
                        robot_position,
                        robot_velocity,
                        world.robot_radius,
                        world.responsibility,
                        obstacles[lane, : world.obstacles],
                        walls[lane, : world.walls],
                        world.period,
                        chosen,
                    )
            person.chosen[0], person.chosen[1] = chosen[0, 0], chosen[0, 1]


@compiled()
def come_and_go(
    lanes: NDArray[np.int64],
    worlds: NDArray[np.void],
    robots: NDArray[np.void],
    people: NDArray[np.void],
    calls: NDArray[np.uint64],
) -> None:
    """Let recorded people appear and leave, at the end of a control period.

    Whoever would appear on top of a robot is held back until it has gone on.

    Args:
        lanes: (M,) which.
        worlds, robots, people: of all lanes, see ``State``.
        calls: Chipmunk's functions.
    """
    for i in range(len(lanes)):
        world = worlds[lanes[i]]
        tracks, step = _tracks_of(world), _step_of(world)
        for p in range(world.people):
            person = people[lanes[i], p]
            there = _is_there(tracks, step, p)
            if there == person.present:
                continue
            x, y, vx, vy = _AWAY + _APART * p, _AWAY, 0.0, 0.0
            if there:
                x, y = tracks[step, p, 0], tracks[step, p, 1]
                if _is_blocked(x, y, world.robot_radius + person.radius, robots[lanes[i]]):
                    person.held = True
                    continue
                if _is_there(tracks, step + 1, p):
                    vx = (tracks[step + 1, p, 0] - x) / world.period
                    vy = (tracks[step + 1, p, 1] - y) / world.period
            person.present = there
            person.velocity[0], person.velocity[1] = vx, vy
            _put(person, x, y, world.space, calls)


@compiled(inline="always")
def _put(person, x, y, space, calls):  # type: ignore[no-untyped-def]
    """Put somebody who has appeared or left where it is from now on."""
    person.position[0], person.position[1] = x, y
    set_vector(calls[SET_POSITION], person.body, x, y)
    pass_body(calls[REINDEX], space, person.body)
    pass_body(calls[ADD_BODY if person.present else REMOVE_BODY], space, person.body)


@compiled(inline="always")
def _tracks_of(world):  # type: ignore[no-untyped-def]
    """(T, P, 2) where the people of a lane are in its control periods."""
    return carray(numbers_at(world.tracks), (world.moments, world.people, 2))


@compiled(inline="always")
def _step_of(world):  # type: ignore[no-untyped-def]
    """The present control period."""
    return np.int64(world.time / world.period + 0.5)


@compiled(inline="always")
def _is_there(tracks, step, p):  # type: ignore[no-untyped-def]
    return step < len(tracks) and not math.isnan(tracks[step, p, 0])


@compiled(inline="always")
def _lead(position, place, following, world):  # type: ignore[no-untyped-def]
    """Velocity to where somebody is to be next, and the speed recorded there: (x, y, speed)."""
    ux, uy = (following[0] - place[0]) / world.period, (following[1] - place[1]) / world.period
    speed = math.sqrt(ux * ux + uy * uy)
    x, y = (following[0] - position[0]) / world.period, (following[1] - position[1]) / world.period
    pace = math.sqrt(x * x + y * y)
    off = max(abs(position[0] - place[0]), abs(position[1] - place[1])) > _OFF
    if off and pace > speed + CATCH_UP:
        x, y = x * ((speed + CATCH_UP) / pace), y * ((speed + CATCH_UP) / pace)
    return x, y, speed


@compiled(inline="always")
def _evades(position, robot_position, sees):  # type: ignore[no-untyped-def]
    """Whether somebody sees a robot that is near."""
    for r in range(len(robot_position)):
        x, y = position[0] - robot_position[r, 0], position[1] - robot_position[r, 1]
        if sees[r] and math.sqrt(x * x + y * y) <= NEIGHBOUR_DISTANCE:
            return True
    return False


@compiled(inline="always")
def _is_blocked(x, y, reach, robots):  # type: ignore[no-untyped-def]
    """Whether somebody at (x, y) would touch a robot that is in the scene."""
    for r in range(len(robots)):
        dx, dy = x - robots[r].pose[0], y - robots[r].pose[1]
        if robots[r].active and math.sqrt(dx * dx + dy * dy) <= reach:
            return True
    return False
