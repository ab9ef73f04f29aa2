"""Following: people who walk along ways, from region to region or between places of a map.

Legs are those of ``crowdbench.simulation.pedestrians``, with the same number of draws, but
everything drawn for one is independent of where the leg before ended. A person in a stream enters
at a place of the start region, passes the regions on the way and walks to a place of the goal
region. There it leaves, and enters anew as soon as the place is free of people and robots; until
then it stands where it is. So a stream keeps its direction and the scene its number of people.
Who returns to the start region (an intent of multimodal goals) sets out again from there; who
diverts walks to the goal of another stream. A person without a stream walks to a place anywhere.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.simulation.chipmunk import SET_POSITION, set_vector
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
from crowdbench.simulation.routes import Routes
from crowdbench.simulation.ways import lengths_to, next_point, sees

ENTRY_GAP = 0.1
"""Least gap to others with which a person enters [m]."""
PLACE = 3
"""Numbers that a place takes of a leg's draws."""
_TRIES, _FREE_TRIES = 3, 10
"""Places drawn for a goal, in a stream and without one: obstacles may be in the way."""
_OTHER, _WHICH, _ENTRY = _TRIES * PLACE, 2 * _TRIES * PLACE, 2 * _TRIES * PLACE + 1
_VIA = _ENTRY + ENTRIES * PLACE
"""Where in the draws of a stream's leg those of another goal, of the stream that it belongs to, of
the start and of the regions on the way begin."""


@compiled()
def begin_routes(
    lane: int,
    worlds: NDArray[np.void],
    people: NDArray[np.void],
    walks: NDArray[np.void],
    obstacles: NDArray[np.float64],
    draws: NDArray[np.float64],
    routes: Routes,
) -> None:
    """Begin the first leg of everybody in a lane; ``walks.stage`` says how far each is."""
    world = worlds[lane]
    for p in range(world.people):
        person, walk = people[lane, p], walks[lane, p]
        walk.stream = routes.member[p]
        _draw_leg(person, walk, world, obstacles[lane], draws[lane, p], routes)
        _set_out(person, walk, world, routes)


@compiled()
def follow(
    lanes: NDArray[np.int64],
    worlds: NDArray[np.void],
    robots: NDArray[np.void],
    people: NDArray[np.void],
    walks: NDArray[np.void],
    obstacles: NDArray[np.float64],
    sees_robot: NDArray[np.bool_],
    draws: NDArray[np.float64],
    calls: NDArray[np.uint64],
    routes: Routes,
) -> bool:
    """The same as ``pedestrians.decide`` for people with routes.

    Args:
        lanes: (M,) which, of scenarios with these routes.
        worlds, robots, people, walks, obstacles, sees_robot, draws: of all lanes, see ``State``.
        calls: Chipmunk's functions.
        routes: of the lanes' scenario.

    Returns:
        Somebody has no draws left for another leg.
    """
    exhausted = False
    for i in range(len(lanes)):
        lane = lanes[i]
        world = worlds[lane]
        for p in range(world.people):
            person, walk = people[lane, p], walks[lane, p]
            if walk.waiting == 0:
                begun = person.drawn
                _decide(person, walk, world, obstacles[lane], draws[lane, p], routes)
                exhausted = exhausted or begun != person.drawn == LEGS_AHEAD
            if walk.waiting > 0:
                _enter(p, world, robots[lane], people[lane], walk, obstacles[lane], calls, routes)
            _prefer(person, walk, world, routes)
        look(world, robots[lane], people[lane], sees_robot[lane])
    return exhausted


@compiled()
def _decide(person, walk, world, obstacles, draws, routes):  # type: ignore[no-untyped-def]
    """Switch, finish or give up a leg that is due, and count regions that have been reached."""
    x, y = person.position[0], person.position[1]
    to_pass = routes.streams[walk.stream, 2] if walk.stream >= 0 else 0
    if world.time >= person.switch_time:
        goal_x, goal_y = person.next_goal[0], person.next_goal[1]
        walk.stage, walk.intent = to_pass, KEEP
        person.goal[0], person.goal[1] = goal_x, goal_y
        _set_out(person, walk, world, routes)
        return
    if walk.stage < to_pass:
        table = routes.streams[walk.stream, 3 + walk.stage]
        dx, dy = walk.via[walk.stage, 0] - x, walk.via[walk.stage, 1] - y
        if math.hypot(dx, dy) < ARRIVAL or _is_within(table, x, y, routes):
            walk.stage += 1
            _plan(x, y, walk, *_target(person, walk, to_pass), routes)
    late = world.time >= person.deadline
    if not world.walks_on or not (late or _has_arrived(person, walk, to_pass)):
        return
    _draw_leg(person, walk, world, obstacles, draws, routes)
    if walk.stream >= 0 and not late:
        walk.stage = 0
        if not _is_within(routes.streams[walk.stream, 0], x, y, routes):
            walk.waiting = 1
            return
    _set_out(person, walk, world, routes)


@compiled()
def _has_arrived(person, walk, to_pass):  # type: ignore[no-untyped-def]
    x, y = person.goal[0] - person.position[0], person.goal[1] - person.position[1]
    return walk.stage >= to_pass and math.hypot(x, y) < ARRIVAL


@compiled()
def _target(person, walk, to_pass):  # type: ignore[no-untyped-def]
    """Where the way leads: a place in the next region to pass, or the goal."""
    if walk.stage < to_pass:
        return walk.via[walk.stage, 0], walk.via[walk.stage, 1]
    return person.goal[0], person.goal[1]


@compiled()
def _draw_leg(person, walk, world, obstacles, draws, routes):  # type: ignore[no-untyped-def]
    """Draw all of the next leg; it has not begun."""
    leg = draws[person.drawn]
    person.drawn += 1
    switch, kind, walk.when = leg[DRAWS - 3], leg[DRAWS - 2], leg[DRAWS - 1]
    walk.intent = KEEP
    if switch < world.switch_probability:
        walk.intent = RETURN if kind < 0.5 else DIVERT
    radius = person.radius
    if walk.stream < 0:
        # Nominally it begins where the last one would have ended.
        x, y = person.next_goal[0], person.next_goal[1]
        table = len(routes.begin) - 2
        goal_x, goal_y = _place_a_leg_away(leg, 0, x, y, table, radius, world, obstacles, routes)
        other_x, other_y = goal_x, goal_y
        if walk.intent == DIVERT:
            turn_x, turn_y = x + walk.when * (goal_x - x), y + walk.when * (goal_y - y)
            first = _FREE_TRIES * PLACE
            other_x, other_y = _place_a_leg_away(
                leg, first, turn_x, turn_y, table, radius, world, obstacles, routes
            )
    else:
        stream = routes.streams[walk.stream]
        for k in range(ENTRIES):
            entry_x, entry_y = place_of(leg, _ENTRY + k * PLACE, stream[0], routes)
            walk.entries[k, 0], walk.entries[k, 1] = entry_x, entry_y
        for k in range(stream[2]):
            via_x, via_y = place_of(leg, _VIA + k * PLACE, stream[3 + k], routes)
            walk.via[k, 0], walk.via[k, 1] = via_x, via_y
        x, y = walk.entries[0, 0], walk.entries[0, 1]
        goal_x, goal_y = _free_place(leg, 0, stream[1], radius, world, obstacles, routes)
        other_x, other_y = goal_x, goal_y
        if walk.intent == DIVERT:
            table = _goal_of_another(leg[_WHICH], walk.stream, routes)
            other_x, other_y = _free_place(leg, _OTHER, table, radius, world, obstacles, routes)
    if walk.intent == RETURN:
        other_x, other_y = x, y
    person.start[0], person.start[1] = x, y
    person.goal[0], person.goal[1] = goal_x, goal_y
    person.next_goal[0], person.next_goal[1] = other_x, other_y


@compiled()
def _goal_of_another(draw, stream, routes):  # type: ignore[no-untyped-def]
    """The goal's table of a stream that one may divert to; of the own one where there is none."""
    others = 0
    for k in range(len(routes.streams)):
        others += routes.exchange[stream, k]
    chosen = np.int64(draw * others)
    for k in range(len(routes.streams)):
        if routes.exchange[stream, k]:
            if chosen == 0:
                return routes.streams[k, 1]
            chosen -= 1
    return routes.streams[stream, 1]


@compiled()
def place_of(draws, first, table, routes):  # type: ignore[no-untyped-def]
    """A place of a table, from three draws."""
    begin, end = routes.begin[table], routes.begin[table + 1]
    square = begin + np.int64(draws[first] * (end - begin))
    x = routes.corner[square, 0] + routes.side * draws[first + 1]
    y = routes.corner[square, 1] + routes.side * draws[first + 2]
    return x, y


@compiled()
def _free_place(leg, first, table, radius, world, obstacles, routes):  # type: ignore[no-untyped-def]
    """The first of several places of a table that no obstacle takes, else the last."""
    for k in range(_TRIES):
        x, y = place_of(leg, first + k * PLACE, table, routes)
        if not _is_taken(x, y, radius, world, obstacles):
            break
    return x, y


@compiled()
def _place_a_leg_away(leg, first, x, y, table, radius, world, obstacles, routes):  # type: ignore[no-untyped-def]
    """The first of several places a leg away that no obstacle takes, else the farthest such."""
    best_x, best_y, farthest = x, y, -1.0
    for k in range(_FREE_TRIES):
        px, py = place_of(leg, first + k * PLACE, table, routes)
        if _is_taken(px, py, radius, world, obstacles):
            continue
        distance = math.sqrt((px - x) * (px - x) + (py - y) * (py - y))
        if distance >= world.leg:
            return px, py
        if distance > farthest:
            best_x, best_y, farthest = px, py, distance
    return best_x, best_y


@compiled()
def _is_taken(x, y, radius, world, obstacles):  # type: ignore[no-untyped-def]
    """Whether a person could not arrive at a place for an obstacle."""
    for o in range(world.obstacles):
        dx, dy = x - obstacles[o, 0], y - obstacles[o, 1]
        if not math.sqrt(dx * dx + dy * dy) - (obstacles[o, 2] + radius) > ARRIVAL:
            return True
    return False


@compiled()
def _is_within(table, x, y, routes):  # type: ignore[no-untyped-def]
    """Whether a point lies in the region of a table."""
    inside = False
    begin, end = routes.outline_begin[table], routes.outline_begin[table + 1]
    last = end - 1
    for k in range(begin, end):
        ax, ay = routes.outline[last, 0], routes.outline[last, 1]
        bx, by = routes.outline[k, 0], routes.outline[k, 1]
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            inside = not inside
        last = k
    return inside


@compiled()
def _set_out(person, walk, world, routes):  # type: ignore[no-untyped-def]
    """Begin to walk from where the person is, in the state that ``walk`` tells."""
    to_pass = routes.streams[walk.stream, 2] if walk.stream >= 0 else 0
    x, y = person.position[0], person.position[1]
    length = _plan(x, y, walk, *_target(person, walk, to_pass), routes)
    for k in range(walk.stage, to_pass):
        x, y = walk.via[k, 0], walk.via[k, 1]
        to_x, to_y = person.goal[0], person.goal[1]
        if k + 1 < to_pass:
            to_x, to_y = walk.via[k + 1, 0], walk.via[k + 1, 1]
        length += length_of(x, y, to_x, to_y, routes)
    duration = length / max(person.speed, SLOWEST)
    person.intent = walk.intent
    person.switch_time = math.inf
    if walk.intent != KEEP:
        person.switch_time = world.time + walk.when * duration
    else:
        person.next_goal[0], person.next_goal[1] = person.goal[0], person.goal[1]
    person.deadline = world.time + PATIENCE * duration + 5.0


@compiled()
def length_of(x, y, to_x, to_y, routes):  # type: ignore[no-untyped-def]
    """Length of the way between two points; of the straight line where there is none [m]."""
    lengths = np.empty(len(routes.nodes))
    lengths_to(to_x, to_y, routes.nodes, routes.between, routes.cores, routes.reach, lengths)
    _, _, length = next_point(x, y, to_x, to_y, lengths, routes.nodes, routes.cores, routes.reach)
    return length if length < math.inf else math.hypot(to_x - x, to_y - y)


@compiled()
def _plan(x, y, walk, to_x, to_y, routes):  # type: ignore[no-untyped-def]
    """Note the next points of the way to a target; the length of all of it [m].

    Without a way it is the straight line.
    """
    lengths = np.empty(len(routes.nodes))
    lengths_to(to_x, to_y, routes.nodes, routes.between, routes.cores, routes.reach, lengths)
    total = math.inf
    walk.at, walk.count, walk.whole = 0, 0, False
    while walk.count < POINTS and not walk.whole:
        nx, ny, length = next_point(
            x, y, to_x, to_y, lengths, routes.nodes, routes.cores, routes.reach
        )
        if walk.count == 0:
            total = length if length < math.inf else math.hypot(to_x - x, to_y - y)
        walk.points[walk.count, 0], walk.points[walk.count, 1] = nx, ny
        walk.count += 1
        walk.whole = nx == to_x and ny == to_y
        x, y = nx, ny
    return total


@compiled()
def _enter(p, world, robots, people, walk, obstacles, calls, routes):  # type: ignore[no-untyped-def]
    """Let a person enter where its leg begins, or at another place there if it has to wait."""
    person = people[p]
    k = (walk.waiting - 1) % ENTRIES
    x, y = walk.entries[k, 0], walk.entries[k, 1]
    walk.waiting += 1
    for q in range(world.people):
        dx, dy = people[q].position[0] - x, people[q].position[1] - y
        gap = person.radius + people[q].radius + ENTRY_GAP
        if q != p and dx * dx + dy * dy < gap * gap:
            return
    for r in range(len(robots)):
        dx, dy = robots[r].pose[0] - x, robots[r].pose[1] - y
        gap = person.radius + routes.robot_gap
        if robots[r].active and dx * dx + dy * dy < gap * gap:
            return
    for o in range(world.obstacles):
        dx, dy = obstacles[o, 0] - x, obstacles[o, 1] - y
        gap = person.radius + obstacles[o, 2]
        if dx * dx + dy * dy < gap * gap:
            return
    walk.waiting = 0
    person.position[0], person.position[1] = x, y
    set_vector(calls[SET_POSITION], person.body, x, y)
    _set_out(person, walk, world, routes)
    # It comes walking.
    _prefer(person, walk, world, routes)
    person.velocity[0], person.velocity[1] = person.preferred[0], person.preferred[1]


@compiled()
def _prefer(person, walk, world, routes):  # type: ignore[no-untyped-def]
    """Prefer the velocity that leads to where the way is after the next period."""
    person.preferred[0], person.preferred[1] = 0.0, 0.0
    if walk.waiting > 0:
        return
    x, y = person.position[0], person.position[1]
    cores, reach = routes.cores, routes.reach
    ahead = walk.at + 1
    while ahead < walk.count and sees(
        x, y, walk.points[ahead, 0], walk.points[ahead, 1], cores, reach, 1.0
    ):
        ahead += 1
    if ahead == walk.at + 1:
        at_x, at_y = walk.points[walk.at, 0], walk.points[walk.at, 1]
        if not sees(x, y, at_x, at_y, cores, reach, routes.walkable) or (
            ahead == walk.count and not walk.whole
        ):
            to_pass = routes.streams[walk.stream, 2] if walk.stream >= 0 else 0
            _plan(x, y, walk, *_target(person, walk, to_pass), routes)
            ahead = np.int64(1)
    walk.at = ahead - 1
    left = person.speed * world.period
    px, py = x, y
    for k in range(walk.at, walk.count):
        dx, dy = walk.points[k, 0] - px, walk.points[k, 1] - py
        distance = math.sqrt(dx * dx + dy * dy)
        if distance > left:
            px, py = px + left / distance * dx, py + left / distance * dy
            break
        left -= distance
        px, py = walk.points[k, 0], walk.points[k, 1]
    person.preferred[0] = (px - x) / world.period
    person.preferred[1] = (py - y) / world.period
