"""Vacancy: whether there is room for somebody at a place, in compiled code."""

from __future__ import annotations

import math

from crowdbench.compiled import compiled

ENTRY_GAP = 0.1
"""Least gap to other people with which a person enters the scene [m]."""


@compiled(inline="always")
def is_off_discs(x, y, discs, last):  # type: ignore[no-untyped-def]
    """Whether disc ``last`` of some (N, 3), moved to (x, y), overlaps none of those before it."""
    free = True
    for i in range(last):
        dx, dy = x - discs[i, 0], y - discs[i, 1]
        free = free and math.sqrt(dx * dx + dy * dy) > discs[i, 2] + discs[last, 2]
    return free


@compiled()
def may_enter(p, x, y, world, robots, people, obstacles, gap):  # type: ignore[no-untyped-def]
    """Whether person ``p`` of a lane may enter at (x, y), ``gap`` from obstacles, surfaces [m]."""
    radius = people[p].radius
    for q in range(world.people):
        dx, dy = people[q].position[0] - x, people[q].position[1] - y
        if q != p and math.sqrt(dx * dx + dy * dy) < radius + people[q].radius + ENTRY_GAP:
            return False
    for r in range(len(robots)):
        dx, dy = robots[r].pose[0] - x, robots[r].pose[1] - y
        if robots[r].reserves and math.sqrt(dx * dx + dy * dy) < radius + world.entry_gap:
            return False
    for o in range(len(obstacles)):
        dx, dy = obstacles[o, 0] - x, obstacles[o, 1] - y
        if math.sqrt(dx * dx + dy * dy) < radius + obstacles[o, 2] + gap:
            return False
    return True
