"""Following: people who walk along ways, from region to region or between places of a map.

Legs are those of ``crowdbench.simulation.pedestrians``, with the same number of draws, but
everything drawn for one is independent of where the leg before ended. A person in a stream enters
at a place of the start region, passes the regions on the way and walks to a place of the goal
region. There it leaves, and enters anew as soon as the place is free of people and robots; until
then it stands where it is. So a stream keeps its direction and the scene its number of people.
Others of its group come with it, from wherever they are (``crowdbench.simulation.group_entry``).
Who returns to the start region (an intent of multimodal goals) sets out again from there; who
diverts walks to the goal of another stream. A person without a stream walks to a place anywhere.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.simulation.chipmunk import SET_POSITION, set_vector
from crowdbench.simulation.clearance import sees
from crowdbench.simulation.lanes import DRAWS, ENTRIES, LEGS_AHEAD, POINTS
from crowdbench.simulation.pedestrians import (
    ARRIVAL,
    DIVERT,
    KEEP,
    PATIENCE,
    RETURN,
    SLOWEST,
    look,
)
from crowdbench.simulation.routes import Regions
from crowdbench.simulation.vacancy import may_enter
from crowdbench.simulation.ways import SQUEEZED, Network, lengths_to, next_point

PLACE = 3
"""Numbers that a place takes of a leg's draws."""
_TRIES, _FREE_TRIES = 3, 10
"""Places drawn for a goal, in a stream and without one: obstacles may be in the way."""
_OTHER, _FREE_OTHER = _TRIES * PLACE, _FREE_TRIES * PLACE
_WHICH = 2 * _TRIES * PLACE
_ENTRY = _WHICH + 1
_VIA = _ENTRY + ENTRIES * PLACE
"""Where in a leg's draws those of another goal, of the stream that it belongs to, of the start and
of the regions on the way begin."""


@compiled()
def begin_routes(
    lane: int,
    worlds: NDArray[np.void],
    people: NDArray[np.void],
    walks: NDArray[np.void],
    obstacles: NDArray[np.float64],
    draws: NDArray[np.float64],
    network: Network,
    regions: Regions,
) -> None:
    """Begin the first leg of everybody in a lane; ``walks`` say in which stream, and how far."""
    world = worlds[lane]
    around = obstacles[lane, : world.obstacles]
    for p in range(world.people):
        person, walk = people[lane, p], walks[lane, p]
        _draw_leg(person, walk, world, around, draws[lane, p], regions)
        _set_out(person, walk, world.time, network)


@compiled()
def follow(
    lanes: NDArray[np.int64],
    worlds: NDArray[np.void],
    robots: NDArray[np.void],
    people: NDArray[np.void],
    obstacles: NDArray[np.float64],
    walks: NDArray[np.void],
    sees_robot: NDArray[np.bool_],
    draws: NDArray[np.float64],
    calls: NDArray[np.uint64],
    network: Network,
    regions: Regions,
) -> bool:
    """The same as ``pedestrians.decide`` for people with routes.

    Args:
        lanes: (M,) which, of scenarios with these routes.
        worlds, robots, people, obstacles, walks, sees_robot, draws: of all lanes, see ``State``.
        calls: Chipmunk's functions.
        network, regions: of the lanes' ``Routes``.

    Returns:
        Somebody has no draws left for another leg.
    """
    exhausted = False
    for i in range(len(lanes)):
        lane = lanes[i]
        world = worlds[lane]
        around = obstacles[lane, : world.obstacles]
        for p in range(world.people):
            person, walk = people[lane, p], walks[lane, p]
            leaves = False
            _go_where_told(person, walk, network)
            if walk.waiting == 0 and _is_due(person, walk, world, network, regions):
                late = world.time >= person.deadline
                _draw_leg(person, walk, world, around, draws[lane, p], regions)
                exhausted = exhausted or person.drawn == LEGS_AHEAD
                x, y = person.position[0], person.position[1]
                leaves = walk.stream >= 0 and not late
                if leaves:
                    walk.stage = 0
                    leaves = not _is_within(regions.streams[walk.stream, 2], x, y, regions)
                if leaves:  # until it enters, its way ends here
                    walk.at, walk.count = 0, 1
                    walk.points[0, 0], walk.points[0, 1] = x, y
                else:
                    _set_out(person, walk, world.time, network)
            enters = False
            if leaves or walk.waiting > 0:
                walk.waiting += 1
                # Where its leg begins, then, if it has to wait, other places there in turn.
                entry = walk.entries[(walk.waiting - 1) % ENTRIES]
                x, y = entry[0], entry[1]
                enters = may_enter(p, x, y, world, robots[lane], people[lane], around, 0.0)
            if enters:
                _enter(person, walk, calls)
                _set_out(person, walk, world.time, network)
            _prefer(person, walk, world.period, network)
            if enters:  # who enters comes walking
                for axis in range(2):
                    person.velocity[axis] = person.preferred[axis]
        look(world, robots[lane], people[lane], sees_robot[lane])
    return exhausted


@compiled()
def _go_where_told(person, walk, network):  # type: ignore[no-untyped-def]
    """Head for a goal that the person was given on the way, e.g. a place in a queue."""
    x, y, last = person.goal[0], person.goal[1], walk.last
    if walk.stops[last, 0] != x or walk.stops[last, 1] != y:
        walk.stops[last, 0], walk.stops[last, 1] = x, y
        walk.stage, walk.waiting = last, 0
        _plan(person.position[0], person.position[1], walk, network)


@compiled()
def _is_due(person, walk, world, network, regions):  # type: ignore[no-untyped-def]
    """Switch a leg and count a region that has been reached; whether another leg is due."""
    x, y = person.position[0], person.position[1]
    stage = walk.stage
    if world.time >= person.switch_time:
        walk.stage, walk.intent = walk.last, KEEP
        for axis in range(2):
            person.goal[axis] = walk.stops[walk.last, axis] = person.next_goal[axis]
        if walk.stream < 0:  # its leg begins here, as in the open
            person.start[0], person.start[1] = x, y
        _set_out(person, walk, world.time, network)
        return False
    dx, dy = walk.stops[stage, 0] - x, walk.stops[stage, 1] - y
    reached = person.arrived or math.hypot(dx, dy) < ARRIVAL
    if stage < walk.last:
        if reached or _is_within(regions.streams[walk.stream, 3 + stage], x, y, regions):
            walk.stage += 1
            _plan(x, y, walk, network)
        reached = False
    return person.walks_on and (reached or world.time >= person.deadline)


@compiled()
def _draw_leg(person, walk, world, obstacles, draws, regions):  # type: ignore[no-untyped-def]
    """Draw all of the next leg; it has not begun."""
    leg = draws[person.drawn]
    person.drawn += 1
    walk.when = leg[DRAWS - 1]
    walk.intent = KEEP
    if leg[DRAWS - 3] < world.switch_probability:
        walk.intent = RETURN if leg[DRAWS - 2] < 0.5 else DIVERT
    # Without a stream a leg begins, for all that is drawn, where the last one would have ended.
    x, y = person.next_goal[0], person.next_goal[1]
    tries, least, other = np.int64(_FREE_TRIES), world.leg, np.int64(_FREE_OTHER)
    table = len(regions.tables) - 2
    turn_table = table
    walk.last = 0
    if walk.stream >= 0:
        stream = regions.streams[walk.stream]
        for k in range(ENTRIES):
            place = place_of(leg, _ENTRY + k * PLACE, stream[2], regions)
            walk.entries[k, 0], walk.entries[k, 1] = place
        walk.last = stream[1] - 1
        for k in range(walk.last):
            place = place_of(leg, _VIA + k * PLACE, stream[3 + k], regions)
            walk.stops[k, 0], walk.stops[k, 1] = place
        x, y = walk.entries[0, 0], walk.entries[0, 1]
        tries, least, other = np.int64(_TRIES), 0.0, np.int64(_OTHER)
        table = stream[3 + walk.last]
        turn_table = _goal_of_another(leg[_WHICH], walk.stream, table, regions)
    goal_x, goal_y = _place_a_leg_away(
        leg, np.int64(0), tries, x, y, least, table, person.radius, obstacles, regions
    )
    person.start[0], person.start[1] = x, y
    if walk.intent == DIVERT:
        x, y = x + walk.when * (goal_x - x), y + walk.when * (goal_y - y)
        x, y = _place_a_leg_away(
            leg, other, tries, x, y, least, turn_table, person.radius, obstacles, regions
        )
    elif walk.intent == KEEP:
        x, y = goal_x, goal_y
    person.goal[0], person.goal[1] = goal_x, goal_y
    walk.stops[walk.last, 0], walk.stops[walk.last, 1] = goal_x, goal_y
    person.next_goal[0], person.next_goal[1] = x, y


@compiled()
def _goal_of_another(draw, stream, own, regions):  # type: ignore[no-untyped-def]
    """The goal's table of another stream in the same area; the own one where there is none."""
    rows = regions.streams
    others = -1
    for k in range(len(rows)):
        others += rows[k, 0] == rows[stream, 0]
    chosen = np.int64(draw * others)
    for k in range(len(rows)):
        if k != stream and rows[k, 0] == rows[stream, 0]:
            if chosen == 0:
                return rows[k, 2 + rows[k, 1]]
            chosen -= 1
    return own


@compiled()
def place_of(draws, first, table, regions):  # type: ignore[no-untyped-def]
    """A place of a table, from three draws."""
    begin, end = regions.tables[table, 0], regions.tables[table + 1, 0]
    square = begin + np.int64(draws[first] * (end - begin))
    x = regions.corner[square, 0] + regions.side * draws[first + 1]
    y = regions.corner[square, 1] + regions.side * draws[first + 2]
    return x, y


@compiled()
def _place_a_leg_away(leg, first, tries, x, y, least, table, radius, obstacles, regions):  # type: ignore[no-untyped-def]
    """The first of several places ``least`` away that no obstacle takes, else the farthest such."""
    best_x, best_y, farthest = x, y, -1.0
    for k in range(tries):
        px, py = place_of(leg, first + k * PLACE, table, regions)
        distance = math.sqrt((px - x) * (px - x) + (py - y) * (py - y))
        for o in range(len(obstacles)):
            dx, dy = px - obstacles[o, 0], py - obstacles[o, 1]
            if not math.sqrt(dx * dx + dy * dy) - (obstacles[o, 2] + radius) > ARRIVAL:
                distance = -1.0
        if distance >= least:
            return px, py
        if distance > farthest:
            best_x, best_y, farthest = px, py, distance
    return best_x, best_y


@compiled()
def _is_within(table, x, y, regions):  # type: ignore[no-untyped-def]
    """Whether a point lies in the region of a table."""
    inside = False
    begin, end = regions.tables[table, 1], regions.tables[table + 1, 1]
    last = end - 1
    for k in range(begin, end):
        ax, ay = regions.outline[last, 0], regions.outline[last, 1]
        bx, by = regions.outline[k, 0], regions.outline[k, 1]
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            inside = not inside
        last = k
    return inside


@compiled()
def _set_out(person, walk, time, network):  # type: ignore[no-untyped-def]
    """Begin to walk the leg that was drawn, from where the person is."""
    length = _plan(person.position[0], person.position[1], walk, network)
    for k in range(walk.stage, walk.last):
        a, b = walk.stops[k], walk.stops[k + 1]
        length += length_of(a[0], a[1], b[0], b[1], network)
    duration = length / max(person.speed, SLOWEST)
    person.intent = walk.intent
    person.switch_time = math.inf if walk.intent == KEEP else time + walk.when * duration
    person.deadline = time + PATIENCE * duration + 5.0


@compiled()
def length_of(x, y, to_x, to_y, network):  # type: ignore[no-untyped-def]
    """Length of the way between two points; of the straight line where there is none [m]."""
    lengths = np.empty(len(network.nodes))
    lengths_to(to_x, to_y, network, lengths)
    _, _, length = next_point(x, y, to_x, to_y, lengths, network)
    return length if length < math.inf else math.hypot(to_x - x, to_y - y)


@compiled()
def _plan(x, y, walk, network):  # type: ignore[no-untyped-def]
    """Note the next points of the way to the next stop; the length of all of it [m].

    Without a way it is the straight line.
    """
    to_x, to_y = walk.stops[walk.stage, 0], walk.stops[walk.stage, 1]
    lengths = np.empty(len(network.nodes))
    lengths_to(to_x, to_y, network, lengths)
    total = 0.0
    walk.at, walk.count, walk.whole = 0, 0, False
    while walk.count < POINTS and not walk.whole:
        nx, ny, length = next_point(x, y, to_x, to_y, lengths, network)
        if walk.count == 0:
            total = length if length < math.inf else math.hypot(to_x - x, to_y - y)
        walk.points[walk.count, 0], walk.points[walk.count, 1] = nx, ny
        walk.count += 1
        walk.whole = nx == to_x and ny == to_y
        x, y = nx, ny
    return total


@compiled()
def _enter(person, walk, calls):  # type: ignore[no-untyped-def]
    """Move a person to where it may enter."""
    k = (walk.waiting - 1) % ENTRIES
    x, y = walk.entries[k, 0], walk.entries[k, 1]
    person.position[0], person.position[1] = x, y
    set_vector(calls[SET_POSITION], person.body, x, y)
    walk.waiting = 0
    person.entered = True


@compiled()
def _prefer(person, walk, period, network):  # type: ignore[no-untyped-def]
    """Prefer the velocity that leads to where the way is after the next period."""
    person.preferred[0], person.preferred[1] = 0.0, 0.0
    if walk.waiting > 0:
        return
    x, y, cores, reach = person.position[0], person.position[1], network.cores, network.reach
    at = walk.at
    while at + 1 < walk.count and sees(
        x, y, walk.points[at + 1, 0], walk.points[at + 1, 1], cores, reach, 1.0
    ):
        at += 1
    if at == walk.at:
        at_x, at_y = walk.points[at, 0], walk.points[at, 1]
        if not sees(x, y, at_x, at_y, cores, reach, SQUEEZED) or (
            at + 1 == walk.count and not walk.whole
        ):
            _plan(x, y, walk, network)
            at = walk.at
    walk.at = at
    px, py = further_along(walk.points, at, walk.count, x, y, person.speed * period)
    person.preferred[0] = (px - x) / period
    person.preferred[1] = (py - y) / period


@compiled()
def further_along(points, at, count, x, y, left):  # type: ignore[no-untyped-def]
    """Where ``left`` metres from (x, y) past points ``at`` to ``count - 1`` lead."""
    for k in range(at, count):
        dx, dy = points[k, 0] - x, points[k, 1] - y
        distance = math.sqrt(dx * dx + dy * dy)
        share = min(1.0, left / distance) if distance > 0.0 else 1.0
        x, y = x + share * dx, y + share * dy
        if share < 1.0:
            break
        left -= distance
    return x, y
