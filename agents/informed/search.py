"""Beam search in time and space for a robot among moving discs, in numba.

A plan is a sequence of arcs, or of lines for an omnidirectional robot. It costs the time it takes,
plus what is left of the way at full speed, plus the discomfort of gaps; plans that touch something
are the last resort.
"""

from __future__ import annotations

import math

import numpy as np
from crowdbench_agents.geometry.footprint import advance, point_gap, wall_gap
from crowdbench_agents.informed.distance_field import look_up
from crowdbench_agents.informed.sorting import sort

from crowdbench.compiled import compiled

PERIODS = np.array([1, 1, 2, 2, 2, 3, 3, 3, 3, 4])
"""Control periods for which each arc of a plan is driven: fine now, coarse later."""
HORIZON = int(PERIODS.sum())
"""Length of a plan in control periods."""
TICKS = 2
"""Collision checks per control period."""
QUICK = (64, 2)
"""Partial plans kept after each arc, and arcs of a plan that are chosen among all actions, the
others among the coarse half."""
THOROUGH = (512, len(PERIODS))
"""The same where a quick search has found no way out."""
CELL, SECTOR = 0.12, 0.4
"""Of partial plans that end in the same cell [m] and sector [rad], one is kept."""
CONTACT = 0.04
"""A gap below this counts as a contact [m]."""
COMFORT = 0.45
"""Gaps to people below this cost something [m]."""
COMFORT_COST = 1.5
"""Cost of a gap of zero [s per s]."""
TURN_COST = 0.05
"""Cost of turning [s per rad]."""
RISK_COST = 16.0
"""Cost of being where somebody whose next goal is unknown may be [s per s]."""
CERTAIN = 1.0 - 1e-9
"""Share of the futures from which on a contact counts as one that will be."""
LOST = 1000.0
"""Cost of a contact now; later contacts cost less, so that the last resort is to delay one [s]."""
ABSENT = -1.0
"""Radius of who is in nobody's way."""
_RUNNING, _ENDED = 0, 1


@compiled()
def search(
    pose,
    velocity,
    goal,
    tolerance,
    half_length,
    half_width,
    period,
    limits,
    turns,
    arcs,
    future,
    spread,
    share,
    price,
    obstacles,
    walls,
    origin,
    lengths,
    winds,
    width,
    fine,
    kept,
    plan,
):
    """Find the cheapest plan.

    Args:
        pose, velocity, goal: the robot's, (3,), (2,), (2,) [m, rad, m/s, rad/s].
        tolerance: arrival distance [m].
        half_length, half_width: of the robot's rectangle [m].
        period: control period [s].
        limits: (2,) on the change of either number of an action in a second.
        turns: whether the robot is differential, else omnidirectional.
        arcs: (A, 2) actions to choose from; later ones only from the first half. Here and below
            (v, w) are v [m/s], w [rad/s], or speeds ahead and to the left [m/s].
        future: (HORIZON * TICKS + 1, N, 3) x, y, radius of the discs at every tick [m]; those of
            several possible futures one beside the other.
        spread: (HORIZON * TICKS + 1, N) how far each may be from there [m].
        share: probability of each of the futures, 1 where there is but one.
        price: cost of being where somebody may be [s per s].
        obstacles: (K, 3) x, y, radius [m].
        walls: (S, 4) x1, y1, x2, y2 [m].
        origin, lengths, winds: of the DistanceField.
        width: partial plans kept after each arc.
        fine: arcs of a plan that are chosen among all; the others among the coarse half.
        kept: (M, 2) what is left of the last plan. It competes: a plan that still works is not
            to be lost because the arcs are cut elsewhere now.
        plan: (HORIZON, 2) the cheapest plan, written.

    Returns:
        Length of the plan in control periods, its cost [s].
    """
    top, turn = _fastest(arcs, turns)
    scene = (
        turns,
        goal,
        tolerance,
        half_length,
        half_width,
        period / TICKS,
        future,
        spread,
        share,
        price,
        obstacles,
        walls,
    )
    reach_v, reach_w = limits[0] * period, limits[1] * period
    # Columns: x, y, heading, v, w, cost so far, row of the beam it continues (-1: the last plan).
    beam = np.zeros((width + 1, 7))
    for i in range(3):
        beam[0, i] = pose[i]
    beam[0, 3], beam[0, 4] = velocity[0], velocity[1]
    alive, old, old_lives = 1, np.empty(7), True
    _copy(beam[0], old)
    children, score = np.empty((len(beam) * len(arcs), 7)), np.empty(len(beam) * len(arcs))
    history = np.empty((len(PERIODS), len(beam), 7))
    best, best_level, best_end = np.inf, 0, np.zeros(7)
    # No literals: numba would compile what they are handed to for them as well.
    row, count = np.int64(0), np.int64(0)
    for level in range(len(PERIODS)):
        count = np.int64(0)
        ticks = np.int64(PERIODS[level] * TICKS)
        choices = len(arcs) if level < fine else len(arcs) // 2
        for b in range(alive):
            for a in range(choices):
                v, w = _within(arcs[a, 0], arcs[a, 1], beam[b, 3], beam[b, 4], reach_v, reach_w)
                child = children[count]
                status = _drive(beam[b], v, w, row, ticks, scene, child)
                child[6] = b
                if status == _RUNNING:
                    left = _time_left(child, goal, tolerance, top, turn, origin, lengths, winds)
                    score[count] = child[5] + left
                    count += 1
                elif child[5] < best:
                    best, best_level = child[5], level
                    _copy(child, best_end)
        for step in range(row // TICKS, row // TICKS + PERIODS[level]):
            old_lives = old_lives and step < len(kept)
            if old_lives:
                status = _drive(
                    old, kept[step, 0], kept[step, 1], step * TICKS, np.int64(TICKS), scene, old
                )
                old_lives = status == _RUNNING
                old[6] = -1
                if not old_lives and old[5] < best:
                    best, best_level = old[5], level
                    _copy(old, best_end)
        row += ticks
        if count == 0 or best <= score[_cheapest(score, count)]:
            break
        if level < len(PERIODS) - 1:
            alive = _select(children, score, count, width, beam)
            if old_lives:
                _copy(old, beam[alive])
                alive += 1
            for b in range(len(beam)):
                _copy(beam[b], history[level, b])
    if count > 0:
        cheapest = _cheapest(score, count)
        if score[cheapest] < best:
            best, best_level = score[cheapest], len(PERIODS) - 1
            _copy(children[cheapest], best_end)
    return _trace(best_end, best_level, history, kept, plan), best


@compiled()
def cost_of(
    pose,
    goal,
    tolerance,
    half_length,
    half_width,
    period,
    turns,
    arcs,
    future,
    spread,
    share,
    price,
    obstacles,
    walls,
    origin,
    lengths,
    winds,
    plan,
):
    """Cost [s] of a plan (HORIZON, 2), for arguments as of ``search``."""
    top, turn = _fastest(arcs, turns)
    tick = period / TICKS
    scene = (
        turns, goal, tolerance, half_length, half_width, tick,
        future, spread, share, price, obstacles, walls,
    )  # fmt: skip
    node = np.zeros(7)
    for i in range(3):
        node[i] = pose[i]
    for step in range(len(plan)):
        row = np.int64(step * TICKS)
        if _drive(node, plan[step, 0], plan[step, 1], row, np.int64(TICKS), scene, node) == _ENDED:
            return node[5]
    return node[5] + _time_left(node, goal, tolerance, top, turn, origin, lengths, winds)


@compiled()
def _fastest(arcs, turns):
    """Largest speed [m/s] and turn rate [rad/s] of some actions."""
    top, turn = arcs[0, 0], abs(arcs[0, 1])
    for a in range(1, len(arcs)):
        top, turn = max(top, arcs[a, 0]), max(turn, abs(arcs[a, 1]))
    if not turns:
        for a in range(len(arcs)):
            top, turn = max(top, math.hypot(arcs[a, 0], arcs[a, 1])), math.inf
    return top, turn


@compiled()
def _copy(source, target):
    """Element by element: numba compiles numpy's message about shapes for an assigned row."""
    for i in range(len(source)):
        target[i] = source[i]


@compiled()
def _cheapest(score, count):
    """The first of the lowest among ``count`` scores."""
    best = 0
    for i in range(1, count):
        if score[i] < score[best]:
            best = i
    return best


@compiled()
def _trace(node, level, history, kept, plan):
    """Write the plan that led to a node of a level, period by period; returns its length."""
    length = 0
    for i in range(level + 1):
        length += PERIODS[i]
    last = length
    while level >= 0:
        if node[6] < 0:
            # Arriving ends the last plan, perhaps in the middle of a level.
            length = min(length, len(kept)) if last == length else length
            for i in range(min(last, length)):
                plan[i, 0], plan[i, 1] = kept[i, 0], kept[i, 1]
            return length
        first = last - PERIODS[level]
        for i in range(first, last):
            plan[i, 0], plan[i, 1] = node[3], node[4]
        last, level = first, level - 1
        if level >= 0:
            node = history[level, int(node[6])]
    return length


@compiled()
def _time_left(node, goal, tolerance, top, turn, origin, lengths, winds):
    """Least time from a pose to the goal [s], and a little for facing elsewhere."""
    x, y = node[0], node[1]
    dx, dy = goal[0] - x, goal[1] - y
    if winds and dx * dx + dy * dy > CELL:
        # Down the slope of the length, which is that of the way.
        dx = look_up(x - CELL, y, goal[0], goal[1], origin, lengths)
        dx -= look_up(x + CELL, y, goal[0], goal[1], origin, lengths)
        dy = look_up(x, y - CELL, goal[0], goal[1], origin, lengths)
        dy -= look_up(x, y + CELL, goal[0], goal[1], origin, lengths)
    off = (math.atan2(dy, dx) - node[2] + math.pi) % (2 * math.pi) - math.pi
    left = look_up(x, y, goal[0], goal[1], origin, lengths) - tolerance
    return max(0.0, left) / top + 0.5 * abs(off) / turn


@compiled()
def _drive(node, v, w, row, ticks, scene, end):
    """Follow an arc for ``ticks`` from a node at ``row`` of the future; writes where it ends."""
    turns, goal, tolerance, half_length, half_width, tick = scene[:6]
    future, spread, share, price, obstacles, walls = scene[6:]
    x, y, heading, cost = node[0], node[1], node[2], node[5]
    turn = w if turns else 0.0
    cost += TURN_COST * abs(turn) * ticks * tick
    # The chord of one tick, and the rotation that takes one chord to the next.
    cosine, sine = math.cos(heading), math.sin(heading)
    turned_c, turned_s = math.cos(turn * tick), math.sin(turn * tick)
    if turns:
        chord_x, chord_y, _ = advance(0.0, 0.0, heading, v, w, tick)
    else:
        chord_x, chord_y = tick * (cosine * v - sine * w), tick * (sine * v + cosine * w)
    status = _RUNNING
    for i in range(row + 1, row + ticks + 1):
        x, y = x + chord_x, y + chord_y
        cosine, sine = cosine * turned_c - sine * turned_s, sine * turned_c + cosine * turned_s
        chord_x, chord_y = (
            chord_x * turned_c - chord_y * turned_s,
            chord_y * turned_c + chord_x * turned_s,
        )
        discomfort = _discomfort(
            x, y, cosine, sine, half_length, half_width,
            future[i], spread[i], share, price, obstacles, walls,
        )  # fmt: skip
        cost += tick * (1.0 + discomfort)
        if discomfort == np.inf:
            cost, status = LOST - i * tick, _ENDED
            break
        if math.hypot(goal[0] - x, goal[1] - y) <= tolerance - 0.02:
            status = _ENDED
            break
    end[0], end[1], end[2] = x, y, heading + turn * ticks * tick
    end[3], end[4], end[5] = v, w, cost
    return status


@compiled()
def _within(v, w, now_v, now_w, reach_v, reach_w):
    """The nearest command that the acceleration limits permit."""
    v = min(now_v + reach_v, max(now_v - reach_v, v))
    return v, min(now_w + reach_w, max(now_w - reach_w, w))


@compiled()
def _discomfort(
    x, y, cosine, sine, half_length, half_width, discs, spread, share, price, obstacles, walls
):
    """Cost per second of being here [s/s]; inf for a contact in all futures."""
    total, touched = 0.0, 0.0
    reach = half_length + half_width
    for d in range(len(discs)):
        if discs[d, 2] == ABSENT:
            continue
        dx, dy = discs[d, 0] - x, discs[d, 1] - y
        far = reach + discs[d, 2] + spread[d] + COMFORT
        if dx * dx + dy * dy > far * far:
            continue
        gap = point_gap(x, y, cosine, sine, half_length, half_width, discs[d, 0], discs[d, 1])
        gap -= discs[d, 2]
        if gap < CONTACT:
            touched += share
            if touched >= CERTAIN:
                return np.inf
            total += share * price
            continue
        if gap < spread[d]:
            total += share * price * (1.0 - gap / spread[d])
        if gap < COMFORT:
            short = 1.0 - gap / COMFORT
            total += share * COMFORT_COST * short * short
    for k in range(len(obstacles)):
        dx, dy, far = obstacles[k, 0] - x, obstacles[k, 1] - y, obstacles[k, 2] + reach
        if dx * dx + dy * dy < far * far:
            gap = point_gap(
                x, y, cosine, sine, half_length, half_width, obstacles[k, 0], obstacles[k, 1]
            )
            if gap - obstacles[k, 2] < CONTACT:
                return np.inf
    for s in range(len(walls)):
        ex, ey = walls[s, 2] - walls[s, 0], walls[s, 3] - walls[s, 1]
        cross = ex * (y - walls[s, 1]) - ey * (x - walls[s, 0])
        if (
            cross * cross < reach * reach * (ex * ex + ey * ey)
            and wall_gap(x, y, cosine, sine, half_length, half_width, walls[s]) < CONTACT
        ):
            return np.inf
    return total


@compiled()
def _select(children, score, count, width, beam):
    """Keep the best children, at most one per cell of position and heading."""
    order = np.empty(count, dtype=np.int64)
    sort(score, order)
    cells = np.empty((width, 3), dtype=np.int64)
    kept = 0
    for i in order:
        cx, cy = math.floor(children[i, 0] / CELL), math.floor(children[i, 1] / CELL)
        ch = math.floor((children[i, 2] % (2 * math.pi)) / SECTOR)
        fresh = True
        for k in range(kept):
            if cells[k, 0] == cx and cells[k, 1] == cy and cells[k, 2] == ch:
                fresh = False
                break
        if fresh:
            cells[kept, 0], cells[kept, 1], cells[kept, 2] = cx, cy, ch
            _copy(children[i], beam[kept])
            kept += 1
            if kept == width:
                break
    return kept
