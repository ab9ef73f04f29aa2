"""Groups in streams: when the first of a group enters the scene anew, the others come with it.

They leave from wherever they are then, also short of the region in which the first one has arrived.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.simulation.chipmunk import SET_POSITION, set_vector
from crowdbench.simulation.groups import crosses
from crowdbench.simulation.vacancy import ENTRY_GAP, may_enter

_GAP = 0.1
"""To obstacles and walls, surfaces [m]."""
_RINGS, _AROUND = 3, 12
"""Places that are tried around the first one."""


@compiled()
def bring_along(
    lanes: NDArray[np.int64],
    worlds: NDArray[np.void],
    robots: NDArray[np.void],
    people: NDArray[np.void],
    obstacles: NDArray[np.float64],
    walls: NDArray[np.float64],
    calls: NDArray[np.uint64],
) -> None:
    """Move people of groups to their leaders who have entered, as soon as there is room.

    Args:
        lanes: (M,) which.
        worlds, robots, people, obstacles, walls: of all lanes, see ``State``.
        calls: Chipmunk's functions.
    """
    for i in range(len(lanes)):
        lane, world = lanes[i], worlds[lanes[i]]
        around, beside = obstacles[lane, : world.obstacles], walls[lane, : world.walls]
        for p in range(world.people):
            leader = people[lane, p]
            if leader.leader != p or not leader.entered:
                continue
            leader.entered = False
            for q in range(p + 1, world.people):
                if people[lane, q].leader != p:
                    break
                if people[lane, q].entered:
                    continue
                placed, x, y = _room_beside(p, q, world, robots[lane], people[lane], around, beside)
                if placed:
                    _move(people[lane, q], leader, x, y, calls)
                else:
                    leader.entered = True
            if not leader.entered:
                for q in range(p + 1, world.people):
                    if people[lane, q].leader == p:
                        people[lane, q].entered = False


@compiled()
def _move(person, leader, x, y, calls):  # type: ignore[no-untyped-def]
    person.position[0], person.position[1] = x, y
    set_vector(calls[SET_POSITION], person.body, x, y)
    for axis in range(2):
        person.velocity[axis] = leader.velocity[axis]
    person.entered = True


@compiled()
def _room_beside(p, q, world, robots, people, obstacles, walls):  # type: ignore[no-untyped-def]
    """The nearest place beside person ``p`` that is free for person ``q``: (found, x, y)."""
    radius = people[q].radius
    from_x, from_y = people[p].position[0], people[p].position[1]
    closest = radius + people[p].radius + ENTRY_GAP
    for k in range(_RINGS * _AROUND):
        distance = closest * (1 + k // _AROUND) + 0.01
        angle = 2 * math.pi * (k % _AROUND) / _AROUND
        x, y = from_x + distance * math.cos(angle), from_y + distance * math.sin(angle)
        if abs(x - world.centre[0]) > world.half_length:
            continue
        if abs(y - world.centre[1]) > world.half_width:
            continue
        if may_enter(q, x, y, world, robots, people, obstacles, _GAP) and _is_open(
            people[p].position, x, y, radius, walls
        ):
            return True, x, y
    return False, 0.0, 0.0


@compiled()
def _is_open(place, x, y, radius, walls):  # type: ignore[no-untyped-def]
    """Whether no wall is too near to (x, y), nor between it and a place."""
    for s in range(len(walls)):
        ax, ay, bx, by = walls[s, 0], walls[s, 1], walls[s, 2], walls[s, 3]
        ex, ey = bx - ax, by - ay
        length2 = ex * ex + ey * ey
        t = ((x - ax) * ex + (y - ay) * ey) / length2 if length2 > 0.0 else 0.0
        t = min(1.0, max(0.0, t))
        dx, dy = ax + t * ex - x, ay + t * ey - y
        if math.sqrt(dx * dx + dy * dy) < radius + _GAP:
            return False
        if crosses(place, x - place[0], y - place[1], walls[s]):
            return False
    return True
