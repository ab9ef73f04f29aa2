"""Pedestrians: where each one wants to go, and whom it sees on the way.

A pedestrian walks *legs*: from where it stands to a goal. Uni-modal legs are kept. A multi-modal
leg is, with the switch probability, interrupted at a random moment, half the time to return to its
start, half the time for a new goal; that intent is fixed when the leg begins and hidden from the
robot. Every leg consumes the same number of draws from the pedestrian's own stream, so leg k
depends on nothing but the seed, the pedestrian and where the leg began. With ``leg_from: goal`` it
begins, for all that is drawn, in the goal of the leg before, wherever the pedestrian is. Whether
a leg ends by arrival or by its interruption depends on what was in the way all the same.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.simulation.contact import INTENTS
from crowdbench.simulation.lanes import CANDIDATES, DRAWS, LEGS_AHEAD
from crowdbench.simulation.rounding import sum_of_products

KEEP, RETURN, DIVERT = range(len(INTENTS))

ARRIVAL = 0.3
"""A pedestrian this near to its goal has arrived [m]."""
PATIENCE = 3.0
"""A leg that takes this many times as long as a free walk is given up."""
SLOWEST = 0.05
"""Slower pedestrians count as this fast, or do not turn their heads [m/s]."""


@compiled()
def begin_legs(
    lane: int,
    worlds: NDArray[np.void],
    people: NDArray[np.void],
    obstacles: NDArray[np.float64],
    draws: NDArray[np.float64],
) -> None:
    """Begin the first leg of everybody in a lane."""
    for p in range(worlds[lane].people):
        _begin_leg(people[lane, p], worlds[lane], obstacles[lane], draws[lane, p])


@compiled()
def decide(
    lanes: NDArray[np.int64],
    worlds: NDArray[np.void],
    robots: NDArray[np.void],
    people: NDArray[np.void],
    obstacles: NDArray[np.float64],
    sees: NDArray[np.bool_],
    draws: NDArray[np.float64],
) -> bool:
    """Everything that precedes a walking model's choice: legs, heads, preferred velocities.

    Legs that are due are switched, finished or given up; everybody who walks looks ahead.

    Args:
        lanes: (M,) which.
        worlds, robots, people, obstacles, sees, draws: of all lanes, see ``State``.

    Returns:
        Somebody has no draws left for another leg.
    """
    exhausted = False
    for i in range(len(lanes)):
        lane = lanes[i]
        world = worlds[lane]
        for p in range(world.people):
            person = people[lane, p]
            x, y = person.goal[0] - person.position[0], person.goal[1] - person.position[1]
            if world.time >= person.switch_time:
                _aim(person, person.next_goal[0], person.next_goal[1], world.time)
            elif person.walks_on and (
                person.arrived or math.hypot(x, y) < ARRIVAL or world.time >= person.deadline
            ):
                _begin_leg(person, world, obstacles[lane], draws[lane, p])
                exhausted = exhausted or person.drawn == LEGS_AHEAD
            x, y = person.goal[0] - person.position[0], person.goal[1] - person.position[1]
            x, y = preferred_velocity(x, y, person.speed, world.period)
            person.preferred[0], person.preferred[1] = x, y
        look(world, robots[lane], people[lane], sees[lane])
    return exhausted


@compiled()
def _begin_leg(person, world, obstacles, draws):  # type: ignore[no-untyped-def]
    leg = draws[person.drawn]
    person.drawn += 1
    switch, kind, when = leg[DRAWS - 3], leg[DRAWS - 2], leg[DRAWS - 1]
    x, y = person.position[0], person.position[1]
    if world.from_goal:
        x, y = person.next_goal[0], person.next_goal[1]
    goal_x, goal_y = _first_fit(leg, np.int64(0), x, y, world, obstacles)
    _aim(person, goal_x, goal_y, world.time)
    if switch >= world.switch_probability:
        return
    if kind < 0.5:
        person.intent = RETURN
        next_x, next_y = x, y
    else:
        person.intent = DIVERT
        turn_x, turn_y = x + when * (goal_x - x), y + when * (goal_y - y)
        next_x, next_y = _first_fit(leg, np.int64(2 * CANDIDATES), turn_x, turn_y, world, obstacles)
    person.next_goal[0], person.next_goal[1] = next_x, next_y
    person.switch_time = world.time + when * _free_walk(person)


@compiled(inline="always")
def _aim(person, x, y, time):  # type: ignore[no-untyped-def]
    """Head for a goal that will be kept."""
    person.start[0], person.start[1] = person.position[0], person.position[1]
    person.goal[0], person.goal[1] = x, y
    person.next_goal[0], person.next_goal[1] = x, y
    person.intent = KEEP
    person.switch_time = math.inf
    person.deadline = time + PATIENCE * _free_walk(person) + 5.0


@compiled(inline="always")
def _free_walk(person):  # type: ignore[no-untyped-def]
    """Seconds that the leg takes when nobody is in the way."""
    x, y = person.goal[0] - person.start[0], person.goal[1] - person.start[1]
    return math.sqrt(sum_of_products(x, x, y, y)) / max(person.speed, SLOWEST)


@compiled()
def _first_fit(leg, begin, x, y, world, obstacles):  # type: ignore[no-untyped-def]
    """The first place outside the obstacles and a leg away, else the farthest one outside.

    Places are drawn from the whole arena, two draws each; where all are inside obstacles, all count
    as outside.
    """
    for strict in range(2):
        best_x, best_y, farthest = 0.0, 0.0, -1.0
        for k in range(CANDIDATES):
            px = (2.0 * leg[begin + 2 * k] - 1.0) * world.half_length
            py = (2.0 * leg[begin + 2 * k + 1] - 1.0) * world.half_width
            inside = False
            for o in range(world.obstacles):
                dx, dy = px - obstacles[o, 0], py - obstacles[o, 1]
                gap = math.sqrt(dx * dx + dy * dy) - (obstacles[o, 2] + world.largest_radius)
                inside = inside or not gap > ARRIVAL
            if inside and strict == 0:
                continue
            distance = math.sqrt((px - x) * (px - x) + (py - y) * (py - y))
            if distance >= world.leg:
                return px, py
            if distance > farthest:
                best_x, best_y, farthest = px, py, distance
        if farthest >= 0.0:
            return best_x, best_y
    return best_x, best_y


@compiled(inline="always")
def look(world, robots, people, sees):  # type: ignore[no-untyped-def]
    """Turn the heads of a lane's people who walk, and note who sees which robot."""
    for p in range(world.people):
        person = people[p]
        if math.hypot(person.velocity[0], person.velocity[1]) > SLOWEST:
            person.heading = math.atan2(person.velocity[1], person.velocity[0])
        for r in range(len(robots)):
            sees[p, r] = False
            if person.reactive and robots[r].active:
                x = robots[r].pose[0] - person.position[0]
                y = robots[r].pose[1] - person.position[1]
                off = (math.atan2(y, x) - person.heading + math.pi) % (2 * math.pi) - math.pi
                sees[p, r] = abs(off) <= world.half_view


@compiled(inline="always")
def read_robots(robots, position, velocity):  # type: ignore[no-untyped-def]
    """Write where a lane's robots are and how they move in the world, as people take them."""
    for r in range(len(robots)):
        robot = robots[r]
        position[r, 0], position[r, 1] = robot.pose[0], robot.pose[1]
        velocity[r, 0], velocity[r, 1] = robot.world_velocity[0], robot.world_velocity[1]


@compiled(inline="always")
def preferred_velocity(x, y, speed, period):  # type: ignore[no-untyped-def]
    """Straight to a goal at (x, y) with ``speed``; nobody overshoots a goal within ``period``."""
    distance = math.hypot(x, y)
    if distance == 0.0:
        return 0.0, 0.0
    # A pedestrian that stops on arrival stands still, since nobody overshoots.
    pace = min(speed, distance / period)
    return pace * x / distance, pace * y / distance
