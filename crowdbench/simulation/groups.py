"""Groups: people who walk together to common goals, and wait for each other.

The first of a group walks legs as everybody does. The others have its goals, and all of them keep
to places in a formation around their centre: abreast, as Moussaid et al. saw groups walk ("The
walking behaviour of pedestrian social groups and its impact on crowd dynamics", PLoS ONE 5(4),
2010), or in rows as wide as walls and obstacles leave room for. Everybody prefers the pace of the
slowest plus what leads to the own place, so that those ahead wait for those behind. How they avoid
others is left to the walking model.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.simulation.pedestrians import ARRIVAL

ABREAST = 0.75
"""From one to the next in a row, centres; more where bodies are large [m]."""
BEHIND = 0.9
"""From one row to the next [m]."""
AHEAD = 1.5
"""How far ahead a group looks for how wide it may walk [m]."""
MARGIN = 0.1
"""To walls and obstacles, surfaces [m]."""
RELAXATION = 0.5
"""In which somebody wants to be in the own place [s], as the time in which people regain their
preferred velocity (Moussaid et al. 2009)."""
LOST = 3.0
"""Who is farther from the first of the group than this, or behind a wall, walks by itself [m]."""
_MOST = 8


def begin_groups(people: NDArray[np.void], group: NDArray[np.int64]) -> None:
    """Have the people of groups (P,), -1 for none, set out together; their legs have begun."""
    people["group"], people["leader"] = group, -1
    people["arrived"] = people["entered"] = False
    for g in range(int(group.max(initial=-1)) + 1):
        members = np.flatnonzero(group == g)
        leader = people[members[0]]
        people["leader"][members] = members[0]
        people["walks_on"][members[1:]] = False
        pace = float(people["speed"][members].min())
        x, y = math.cos(leader["heading"]), math.sin(leader["heading"])
        people["heading"][members] = leader["heading"]
        people["velocity"][members] = pace * x, pace * y
        leader["along"] = x, y
        for p in members[1:].tolist():
            _follow(people[p], leader)


@compiled()
def keep_together(
    lanes: NDArray[np.int64],
    worlds: NDArray[np.void],
    people: NDArray[np.void],
    obstacles: NDArray[np.float64],
    walls: NDArray[np.float64],
) -> None:
    """Give the people of groups common goals, and preferred velocities that keep them together.

    Args:
        lanes: (M,) which.
        worlds, people, obstacles, walls: of all lanes, see ``State``.
    """
    for i in range(len(lanes)):
        lane, world = lanes[i], worlds[lanes[i]]
        around, beside = obstacles[lane, : world.obstacles], walls[lane, : world.walls]
        for p in range(world.people):
            if people[lane, p].leader == p:
                end = p + 1
                while end < world.people and people[lane, end].leader == p:
                    _follow(people[lane, end], people[lane, p])
                    end += 1
                _lead(people[lane, p:end], world, around, beside)


@compiled()
def _follow(person, leader):  # type: ignore[no-untyped-def]
    """Take over the leader's leg; only the leader's ends."""
    for axis in range(2):
        person.start[axis], person.goal[axis] = leader.start[axis], leader.goal[axis]
        person.next_goal[axis] = leader.next_goal[axis]
    person.intent, person.switch_time = leader.intent, leader.switch_time
    person.deadline = math.inf


@compiled()
def _lead(members, world, obstacles, walls):  # type: ignore[no-untyped-def]
    """Preferred velocities of one group, its leader first."""
    size, leader = len(members), members[0]
    wanted = math.hypot(leader.preferred[0], leader.preferred[1])
    if wanted > 0.0:
        leader.along[0] = leader.preferred[0] / wanted
        leader.along[1] = leader.preferred[1] / wanted
    ux, uy = leader.along[0], leader.along[1]
    pace, widest, near, waits = wanted, 0.0, 0, False
    leader.arrived = False
    cx, cy, lost = 0.0, 0.0, np.zeros(_MOST, np.bool_)
    for k in range(size):
        member = members[k]
        pace, widest = min(pace, member.speed), max(widest, member.radius)
        x, y = member.position[0], member.position[1]
        if math.hypot(leader.goal[0] - x, leader.goal[1] - y) < ARRIVAL:
            leader.arrived = True
        dx, dy = x - leader.position[0], y - leader.position[1]
        lost[k] = math.hypot(dx, dy) > LOST
        for s in range(len(walls)):
            lost[k] = lost[k] or crosses(leader.position, dx, dy, walls[s])
        if not lost[k]:
            cx, cy, near = cx + x, cy + y, near + 1
        elif dx * ux + dy * uy < 0.0:
            waits = True
        else:  # ahead of the others, and behind a corner
            member.preferred[0], member.preferred[1] = 0.0, 0.0
    cx, cy = cx / near, cy / near
    if waits:
        pace = 0.0
    spacing = max(ABREAST, 2.0 * widest + MARGIN)
    left, right = _room(cx, cy, ux, uy, (size - 1) * spacing + widest + MARGIN, obstacles, walls)
    abreast = int(max(0.0, left + right - 2.0 * (widest + MARGIN)) / spacing) + 1
    abreast = min(abreast, near)
    half = 0.5 * (abreast - 1) * spacing + widest + MARGIN
    shift = min(max(0.0, half - right), left - half)
    if left + right < 2.0 * half:
        shift = 0.5 * (left - right)
    _form(members, lost, cx, cy, ux, uy, pace, abreast, near, spacing, shift)


@compiled()
def crosses(place, dx, dy, wall):  # type: ignore[no-untyped-def]
    """Whether a wall lies between a place and another one at (dx, dy) from it."""
    ax, ay, bx, by = wall[0] - place[0], wall[1] - place[1], wall[2] - place[0], wall[3] - place[1]
    ex, ey = bx - ax, by - ay
    sides = (ey * ax - ex * ay) * (ex * (dy - ay) - ey * (dx - ax))
    ends = (dx * ay - dy * ax) * (dx * by - dy * bx)
    return sides <= 0.0 and ends <= 0.0


@compiled()
def _room(cx, cy, ux, uy, most, obstacles, walls):  # type: ignore[no-untyped-def]
    """Free width to the left and right of a centre and of the way ahead of it [m]."""
    left, right = most, most
    for s in range(len(walls)):
        x, y = walls[s, 0] - cx, walls[s, 1] - cy
        a1, b1 = x * ux + y * uy, y * ux - x * uy
        x, y = walls[s, 2] - cx, walls[s, 3] - cy
        a2, b2 = x * ux + y * uy, y * ux - x * uy
        if max(a1, a2) < -MARGIN or min(a1, a2) > AHEAD:
            continue
        # The part of the wall that lies beside the way.
        da = a2 - a1
        first = min(max((-MARGIN - a1) / da, 0.0), 1.0) if da != 0.0 else 0.0
        last = min(max((AHEAD - a1) / da, 0.0), 1.0) if da != 0.0 else 1.0
        e1, e2 = b1 + first * (b2 - b1), b1 + last * (b2 - b1)
        left, right = _narrowed(left, right, min(e1, e2), max(e1, e2))
    for o in range(len(obstacles)):
        x, y, radius = obstacles[o, 0] - cx, obstacles[o, 1] - cy, obstacles[o, 2]
        a, b = x * ux + y * uy, y * ux - x * uy
        if a + radius >= -MARGIN and a - radius <= AHEAD:
            left, right = _narrowed(left, right, b - radius, b + radius)
    return left, right


@compiled()
def _narrowed(left, right, low, high):  # type: ignore[no-untyped-def]
    """The room that is left beside something between two sideways distances, left positive."""
    if low + high >= 0.0:
        return min(left, max(low, 0.0)), right
    return left, min(right, max(-high, 0.0))


@compiled()
def _form(members, lost, cx, cy, ux, uy, pace, abreast, near, spacing, shift):  # type: ignore[no-untyped-def]
    """Lead everybody to a place: the foremost into the first row, from right to left as they go."""
    size = len(members)
    order, along, aside = np.empty(_MOST, np.int64), np.empty(_MOST), np.empty(_MOST)
    count = 0
    for k in range(size):
        x, y = members[k].position[0] - cx, members[k].position[1] - cy
        along[k], aside[k] = x * ux + y * uy, y * ux - x * uy
        if not lost[k]:
            order[count] = k
            count += 1
    _sort(order, 0, count, -along)
    rows = (near + abreast - 1) // abreast
    for row in range(rows):
        begin, end = row * abreast, min((row + 1) * abreast, near)
        _sort(order, begin, end, aside)
        for place in range(begin, end):
            k = order[place]
            member = members[k]
            ahead = (0.5 * (rows - 1) - row) * BEHIND - along[k]
            off = shift + (place - begin - 0.5 * (end - begin - 1)) * spacing - aside[k]
            forward, sideways = max(0.0, pace + ahead / RELAXATION), off / RELAXATION
            speed = math.hypot(forward, sideways)
            scale = member.speed / speed if speed > member.speed else 1.0
            forward, sideways = scale * forward, scale * sideways
            member.preferred[0] = forward * ux - sideways * uy
            member.preferred[1] = forward * uy + sideways * ux


@compiled()
def _sort(order, begin, end, by):  # type: ignore[no-untyped-def]
    """Sort a few indices by ascending values, in place and stably."""
    for i in range(begin + 1, end):
        k, j = order[i], i
        while j > begin and by[order[j - 1]] > by[k]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = k
