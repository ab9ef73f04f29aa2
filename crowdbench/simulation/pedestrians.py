"""Pedestrians: where each one wants to go, and whom it sees on the way.

A pedestrian walks *legs*: from where it stands to a goal. Uni-modal legs are kept. A multi-modal
leg is, with the switch probability, interrupted at a random moment, half the time to return to its
start, half the time for a new goal; that intent is fixed when the leg begins and hidden from the
robot. Every leg consumes the same number of draws from the pedestrian's own stream, so leg k
depends on nothing but the seed, the pedestrian and where the leg began.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.scenario import Scenario
from crowdbench.simulation import streams
from crowdbench.simulation.contact import INTENTS
from crowdbench.simulation.walking import Crowd, checked_velocities, make_walking_model

KEEP, RETURN, DIVERT = range(len(INTENTS))

ARRIVAL = 0.3
"""A pedestrian this near to its goal has arrived [m]."""
PATIENCE = 3.0
"""A leg that takes this many times as long as a free walk is given up."""
_CANDIDATES = 16
_NONE, _SWITCH, _NEW_LEG = range(3)


class Robots(Protocol):
    """What pedestrians can see of R robots.

    Attributes:
        pose: (R, 3) x, y [m], heading [rad].
        world_velocity: (R, 2) [m/s].
        active: (R,) robots that are still in the scene.
    """

    pose: NDArray[np.float64]
    world_velocity: NDArray[np.float64]
    active: NDArray[np.bool_]


class Pedestrians:
    """State of all pedestrians; row p of every array belongs to pedestrian p.

    Attributes:
        position, velocity: (P, 2) [m], [m/s]; the world writes them after each physics step.
        goal, start, next_goal: (P, 2) current target, start of the leg, target after a switch [m].
        speed: (P,) preferred speed, never exceeded [m/s].
        radius: (P,) of the discs that they are [m].
        intent: (P,) index into INTENTS.
        switch_time: (P,) when the leg is interrupted, inf when it is kept [s].
        reactive: (P,) bool, sees the robots; the others are non-reactive.
        heading: (P,) direction of the last step walked [rad].
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        position: NDArray[np.float64],
        reactive: NDArray[np.bool_],
        obstacles: NDArray[np.float64],
        walls: NDArray[np.float64],
    ) -> None:
        """Begin the first leg of everybody at ``position`` (P, 2) [m]."""
        settings = scenario.pedestrians
        count = settings.count
        self._scenario, self._settings = scenario, settings
        self._obstacles, self._walls = obstacles, walls
        self._step = scenario.control_period
        self._half_view = np.deg2rad(settings.field_of_view) / 2
        self._robot_radius = float(np.hypot(scenario.robots.length, scenario.robots.width) / 2)
        self._half_extent = (
            np.array([scenario.arena.length, scenario.arena.width]) / 2 - settings.radius
        )
        self._streams = [streams.pedestrian(seed, p) for p in range(count)]
        self.position = position
        self.reactive = reactive
        self.radius = np.full(count, settings.radius)
        low, high = settings.speed
        self.speed = np.array([low + (high - low) * rng.random() for rng in self._streams])
        self.goal, self.start, self.next_goal = (position.copy() for _ in range(3))
        self.intent = np.zeros(count, dtype=np.int64)
        self.switch_time, self._deadline = np.full(count, np.inf), np.full(count, np.inf)
        for p in range(count):
            self._begin_leg(p, 0.0)
        ahead = self.goal - position
        self.heading = np.arctan2(ahead[:, 1], ahead[:, 0])
        self.velocity = self.speed[:, None] * np.column_stack(
            [np.cos(self.heading), np.sin(self.heading)]
        )
        self._flags = np.zeros(count, dtype=np.int8)
        self._present = np.ones(count, dtype=np.bool_)
        self._model = make_walking_model(scenario)
        self._draws = streams.walking(seed)

    def advance_legs(self, time: float) -> None:
        """Switch, finish or give up the legs that are due at ``time`` [s]."""
        if not _due(time, self.position, self.goal, self.switch_time, self._deadline, self._flags):
            return
        for p in np.flatnonzero(self._flags).tolist():
            if self._flags[p] == _SWITCH:
                self._aim(p, self.next_goal[p].copy(), time)
            elif self._settings.on_arrival == "new_goal":
                self._begin_leg(p, time)

    def begin(self, robots: Robots) -> None:
        """Let the walking model see everybody before the first step."""
        self._model.reset(self._crowd(robots), self._draws)

    def walk(self, robots: Robots, time: float) -> NDArray[np.float64]:
        """Return the velocity (P, 2) [m/s] that everybody chooses from the present snapshot.

        Args:
            robots: as they are now.
            time: since the episode began [s].

        Raises:
            ScenarioError: the walking model does not return finite numbers (P, 2).
        """
        chosen = self._model.velocities(self._crowd(robots), time)
        return checked_velocities(self._scenario, chosen)

    def _crowd(self, robots: Robots) -> Crowd:
        settings = self._settings
        seen = _look(
            self.position,
            self.velocity,
            self.heading,
            self.reactive,
            self._half_view,
            robots.pose,
            robots.active,
        )
        return Crowd(
            position=self.position,
            velocity=self.velocity,
            heading=self.heading,
            goal=self.goal,
            preferred_speed=self.speed,
            radius=settings.radius,
            present=self._present,
            sees_robot=seen,
            robot_position=robots.pose[:, :2].copy(),
            robot_velocity=robots.world_velocity,
            robot_radius=self._robot_radius,
            responsibility=settings.responsibility,
            obstacles=self._obstacles,
            walls=self._walls,
            period=self._step,
        )

    def _begin_leg(self, p: int, time: float) -> None:
        draws = self._streams[p].random(4 * _CANDIDATES + 3)
        switch, kind, when = draws[-3:]
        places = (2 * draws[:-3].reshape(2, _CANDIDATES, 2) - 1) * self._half_extent
        goal = self._first_fit(places[0], self.position[p])
        self._aim(p, goal, time)
        if self._settings.goals == "unimodal" or switch >= self._settings.switch_probability:
            return
        turning_point = self.position[p] + when * (goal - self.position[p])
        self.intent[p] = RETURN if kind < 0.5 else DIVERT
        self.next_goal[p] = (
            self.start[p] if kind < 0.5 else self._first_fit(places[1], turning_point)
        )
        self.switch_time[p] = time + when * self._free_walk(p)

    def _aim(self, p: int, goal: NDArray[np.float64], time: float) -> None:
        """Head for a goal that will be kept."""
        self.start[p] = self.position[p]
        self.goal[p] = self.next_goal[p] = goal
        self.intent[p] = KEEP
        self.switch_time[p] = np.inf
        self._deadline[p] = time + PATIENCE * self._free_walk(p) + 5.0

    def _free_walk(self, p: int) -> float:
        """Seconds that the leg takes when nobody is in the way."""
        return float(np.linalg.norm(self.goal[p] - self.start[p]) / max(self.speed[p], 0.05))

    def _first_fit(
        self, places: NDArray[np.float64], origin: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """The first place outside the obstacles and a leg away, else the farthest one outside."""
        if len(self._obstacles):
            gaps = np.linalg.norm(places[:, None] - self._obstacles[None, :, :2], axis=2)
            gaps -= self._obstacles[:, 2] + self._settings.radius
            outside = (gaps > ARRIVAL).all(axis=1)
            places = places[outside] if outside.any() else places
        distance = np.linalg.norm(places - origin, axis=1)
        far = distance >= self._settings.leg
        return places[np.argmax(far) if far.any() else np.argmax(distance)]


@compiled()
def _due(
    time: float,
    position: NDArray[np.float64],
    goal: NDArray[np.float64],
    switch_time: NDArray[np.float64],
    deadline: NDArray[np.float64],
    flags: NDArray[np.int8],
) -> bool:
    """Flag the pedestrians whose leg changes now; True when there are any."""
    found = False
    for p in range(len(position)):
        flags[p] = _NONE
        arrived = np.hypot(goal[p, 0] - position[p, 0], goal[p, 1] - position[p, 1]) < ARRIVAL
        if time >= switch_time[p]:
            flags[p] = _SWITCH
        elif arrived or time >= deadline[p]:
            flags[p] = _NEW_LEG
        found = found or flags[p] != _NONE
    return found


@compiled()
def _look(
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    heading: NDArray[np.float64],
    reactive: NDArray[np.bool_],
    half_view: float,
    robot_pose: NDArray[np.float64],
    robot_active: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Turn the heading of those who walk, and say which pedestrian sees which robot, (P, R)."""
    count, robots = len(position), len(robot_pose)
    seen = np.zeros((count, robots), dtype=np.bool_)
    for p in range(count):
        if np.hypot(velocity[p, 0], velocity[p, 1]) > 0.05:
            heading[p] = np.arctan2(velocity[p, 1], velocity[p, 0])
        for r in range(robots):
            if not (reactive[p] and robot_active[r]):
                continue
            bearing = np.arctan2(
                robot_pose[r, 1] - position[p, 1], robot_pose[r, 0] - position[p, 0]
            )
            off = (bearing - heading[p] + np.pi) % (2 * np.pi) - np.pi
            seen[p, r] = abs(off) <= half_view
    return seen
