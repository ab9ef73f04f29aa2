"""Foresight: how the people of a state will walk on, by what they walk by in the simulation.

For those who know everything (``env.state()``). Legs that have begun are kept, interrupted and
ended as they will be; groups keep together, queues close up, people look away, stop and evade, by
the same compiled functions as in a world. Not foreseen are next legs and whatever else is drawn
later, and bodies that push each other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.simulation.following import further_along
from crowdbench.simulation.groups import keep_together
from crowdbench.simulation.lanes import PERSON, ROBOT, WORLD
from crowdbench.simulation.motion import limit_changes
from crowdbench.simulation.pedestrians import ARRIVAL, look, preferred_velocity
from crowdbench.simulation.walking import Orca, kernel_of
from crowdbench.simulation.ways import sees

State = Mapping[str, NDArray[Any]]

_LANE = np.zeros(1, dtype=np.int64)
_FAR = 1e6
"""Where somebody is who has left [m]."""
_SAME = (
    "position",
    "velocity",
    "heading",
    "goal",
    "next_goal",
    "speed",
    "acceleration",
    "radius",
    "switch_time",
    "reactive",
    "attentive",
    "attention_time",
    "group",
    "stop_time",
    "stop_end",
    "walks_on",
)


class Walk(NamedTuple):
    """How P people walk for T control periods.

    Attributes:
        position: (T + 1, P, 2) from now on [m]; far away for those who have left.
        velocity: (T, P, 2) in each period [m/s].
        arrived: (P,) when each has arrived and begins a leg that nobody knows, inf for never [s].
        leaves: (P,) bool, who is not there any more from then on, but enters anew elsewhere.
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    arrived: NDArray[np.float64]
    leaves: NDArray[np.bool_]


def walk_ahead(
    state: State, period: float, robots: NDArray[np.float64], robot_radius: float
) -> Walk:
    """Let the people of a state walk on among robots that move as they are told here.

    They walk by ORCA.

    Args:
        state: as ``env.state()`` returns it, with everybody in the scene; it may hold
            ``pedestrian_further`` (P, L, 2), goals of the legs after the present one [m].
        period: control period [s].
        robots: (T, R, 4) x, y [m], velocity in the world [m/s] at the beginning of each period;
            NaN for robots that have left.
        robot_radius: of the circle around a robot's footprint, as people see it [m].
    """
    people, worlds = _people_of(state), _world_of(state, period, robot_radius)
    count, periods = people.shape[1], len(robots)
    obstacles, walls = state["obstacles"][None], state["walls"][None]
    around = np.zeros((1, robots.shape[1]), dtype=ROBOT)
    sees_robot = np.zeros((1, count, robots.shape[1]), dtype=np.bool_)
    further = state.get("pedestrian_further", np.empty((count, 0, 2)))
    walk = Walk(
        np.empty((periods + 1, count, 2)),
        np.empty((periods, count, 2)),
        np.full(count, np.inf),
        state["pedestrian_stream"] >= 0,
    )
    walk.position[0] = state["pedestrian_position"]
    begun = np.zeros(count, dtype=np.int64)
    routes = _Routes(state) if _has_ways(state) else None
    served = np.isfinite(state["pedestrian_served_time"]).any()
    queues = _Queues(state) if served else None
    stops = np.isfinite(state["pedestrian_stop_time"]).any()
    attends = np.isfinite(state["pedestrian_attention_time"]).any()
    grouped = (state["pedestrian_group"] >= 0).any()
    limited = np.isfinite(state["pedestrian_acceleration"]).any()
    choose = kernel_of(Orca())
    assert choose is not None
    for k in range(periods):
        worlds["time"][0] = now = float(state["time"]) + k * period
        if queues is not None:
            queues.close_up(people[0], k, now, walk.arrived)
        _go_on(worlds, around, people, sees_robot, robots[k], further, begun, walk.arrived)
        if routes is not None:
            routes.lead(people[0], period, walk)
        if stops:
            _stop(worlds, people)
        if grouped:
            keep_together(_LANE, worlds, people, obstacles, walls)
        if attends:
            _attend(worlds, people, sees_robot)
        choose(_LANE, worlds, around, people, obstacles, walls, sees_robot)
        if limited:
            limit_changes(_LANE, worlds, people)
        _move(people, period, walk.position[k + 1], walk.velocity[k])
    if queues is not None:
        queues.bring_back(walk)
    return walk


def _people_of(state: State) -> NDArray[np.void]:
    """(1, P) records PERSON."""
    people = np.zeros((1, len(state["pedestrian_position"])), dtype=PERSON)
    for name in _SAME:
        people[name][0] = state[f"pedestrian_{name}"]
    people["leader"] = -1
    for g in np.unique(people["group"][people["group"] >= 0]):
        members = np.flatnonzero(people["group"][0] == g)
        people["leader"][0, members] = members[0]
    heading = people["heading"][0]
    people["along"][0, :, 0] = [math.cos(angle) for angle in heading.tolist()]
    people["along"][0, :, 1] = [math.sin(angle) for angle in heading.tolist()]
    return people


def _world_of(state: State, period: float, robot_radius: float) -> NDArray[np.void]:
    """(1,) record WORLD, as far as walking takes."""
    world = np.zeros(1, dtype=WORLD)
    world["period"], world["robot_radius"] = period, robot_radius
    world["people"] = len(state["pedestrian_position"])
    world["obstacles"], world["walls"] = len(state["obstacles"]), len(state["walls"])
    world["half_view"] = state["field_of_view"] / 2
    world["responsibility"] = state["responsibility"]
    return world


def _has_ways(state: State) -> bool:
    """Whether somebody's way is not straight, or ends where people leave."""
    way, goal = state["pedestrian_way"], state["pedestrian_goal"]
    return bool((state["pedestrian_stream"] >= 0).any() or (way != goal[:, None]).any())


class _Queues:
    """Lines of which it is known when the first one leaves."""

    def __init__(self, state: State) -> None:
        self._queue, self._served = state["pedestrian_queue"], state["pedestrian_served_time"]
        self._place = state["pedestrian_place"].copy()
        self._due = self._served.copy()
        self._left: list[tuple[int, int]] = []

    def close_up(
        self, people: NDArray[np.void], step: int, now: float, arrived: NDArray[np.float64]
    ) -> None:
        """Have everybody behind somebody who has been served step forward."""
        for p in np.flatnonzero(now >= self._due).tolist():
            self._due[p] = np.inf
            members = np.flatnonzero(self._queue == self._queue[p])
            line = members[np.argsort(self._place[members])]
            line = line[self._place[line] >= 0]
            away = members[self._place[members] < 0]
            places = people["goal"][line].copy()
            for q, place in zip([*line[1:], *away], places, strict=False):
                people["goal"][q] = people["next_goal"][q] = place
                people["switch_time"][q], people["walks_on"][q] = np.inf, False
            self._place[members] -= 1
            self._place[away] = len(line) - 1
            self._place[p] = -1
            people["walks_on"][p], arrived[p] = True, now
            # It walks away, whereto nobody knows: out of the way of those behind.
            people["position"][p] = _FAR * (1 + p)
            self._left.append((p, step))

    def bring_back(self, walk: Walk) -> None:
        """Note of those who have been served that they were last seen in the first place."""
        for p, step in self._left:
            walk.position[step:, p], walk.velocity[step:, p] = walk.position[step, p], 0.0


class _Routes:
    """Ways past walls, and ends of streams."""

    def __init__(self, state: State) -> None:
        self._way, self._stream = state["pedestrian_way"], state["pedestrian_stream"]
        goal, walls = state["pedestrian_goal"], state["walls"]
        self._goal = goal.copy()
        self._at = np.zeros(len(goal), dtype=np.int64)
        # Who waits to enter has no way.
        self._waits = (self._stream >= 0) & (self._way == self._way[:, :1]).all(axis=(1, 2))
        self._waits &= (self._way[:, 0] != goal).any(axis=1)
        ends, reach = walls.reshape(-1, 2, 2), float(state["way_clearance"])
        self._cores = np.hstack([walls, ends.min(axis=1) - reach, ends.max(axis=1) + reach])
        self._reach = np.full(len(walls), reach)

    def lead(self, people: NDArray[np.void], period: float, walk: Walk) -> None:
        """Turn preferred velocities along the ways, and take those away who leave."""
        _lead(
            people, self._way, self._at, self._goal, self._waits, self._cores, self._reach, period
        )
        for p in np.flatnonzero(walk.leaves & (walk.arrived < np.inf)).tolist():
            together = people["leader"] == p if people["leader"][p] == p else [p]
            walk.arrived[together] = walk.arrived[p]
            people["position"][together, 0] = _FAR
            people["position"][together, 1] = _FAR * np.arange(len(people))[together]


@compiled()
def _go_on(worlds, robots, people, sees_robot, moving, further, begun, arrived):  # type: ignore[no-untyped-def]
    """Legs, preferred straight ways, and who sees which robot, see ``pedestrians.decide``."""
    world = worlds[0]
    for r in range(len(moving)):
        robot = robots[0, r]
        robot.active = not math.isnan(moving[r, 0])
        robot.pose[0], robot.pose[1] = moving[r, 0], moving[r, 1]
        robot.world_velocity[0], robot.world_velocity[1] = moving[r, 2], moving[r, 3]
        if not robot.active:
            robot.pose[0], robot.pose[1] = 0.0, 0.0
            robot.world_velocity[0], robot.world_velocity[1] = 0.0, 0.0
    for p in range(world.people):
        person = people[0, p]
        if begun[p] == 0 and world.time >= person.switch_time:
            person.goal[0], person.goal[1] = person.next_goal[0], person.next_goal[1]
        x, y = person.goal[0] - person.position[0], person.goal[1] - person.position[1]
        there = person.arrived or math.hypot(x, y) < ARRIVAL
        if there and person.walks_on and arrived[p] == math.inf:
            if begun[p] < further.shape[1]:
                person.goal[0] = further[p, begun[p], 0]
                person.goal[1] = further[p, begun[p], 1]
                begun[p] += 1
                x, y = person.goal[0] - person.position[0], person.goal[1] - person.position[1]
            else:
                arrived[p] = world.time
        x, y = preferred_velocity(x, y, person.speed, world.period)
        person.preferred[0], person.preferred[1] = x, y
    look(world, robots[0], people[0], sees_robot[0])


@compiled()
def _stop(worlds, people):  # type: ignore[no-untyped-def]
    """See ``habits.stop``."""
    for p in range(worlds[0].people):
        person = people[0, p]
        follows = 0 <= person.leader != p
        if not follows and person.stop_time <= worlds[0].time < person.stop_end:
            person.preferred[0], person.preferred[1] = 0.0, 0.0


@compiled()
def _attend(worlds, people, sees_robot):  # type: ignore[no-untyped-def]
    """See ``habits.attend``; of each person one change is known."""
    for p in range(worlds[0].people):
        person = people[0, p]
        if worlds[0].time >= person.attention_time:
            person.attentive, person.attention_time = not person.attentive, math.inf
        for r in range(sees_robot.shape[2]):
            sees_robot[0, p, r] = sees_robot[0, p, r] and person.attentive


@compiled()
def _lead(people, way, at, goal, waits, cores, reach, period):  # type: ignore[no-untyped-def]
    """See ``following._prefer``; who has another goal than in the beginning walks straight."""
    last = way.shape[1] - 1
    for p in range(len(people)):
        person = people[p]
        if waits[p]:
            person.preferred[0], person.preferred[1] = 0.0, 0.0
            continue
        if person.goal[0] != goal[p, 0] or person.goal[1] != goal[p, 1]:
            continue
        x, y = person.position[0], person.position[1]
        while at[p] < last and sees(
            x, y, way[p, at[p] + 1, 0], way[p, at[p] + 1, 1], cores, reach, 1.0
        ):
            at[p] += 1
        px, py = further_along(way[p], at[p], last + 1, x, y, person.speed * period)
        person.preferred[0], person.preferred[1] = (px - x) / period, (py - y) / period


@compiled()
def _move(people, period, position, velocity):  # type: ignore[no-untyped-def]
    """Take a step as chosen, and note it."""
    for p in range(people.shape[1]):
        person = people[0, p]
        for axis in range(2):
            person.velocity[axis] = person.chosen[axis]
            person.position[axis] += period * person.chosen[axis]
            velocity[p, axis], position[p, axis] = person.chosen[axis], person.position[axis]
