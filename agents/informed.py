"""Informed: the ceiling. Knows everybody's true position, velocity, goal and hidden intent.

Pedestrians are predicted with the model by which they walk (ORCA), towards the goals they really
have and will really switch to, as if the robot were not there. Against that prediction a beam
search in time and space looks for the fastest collision-free drive (a lattice of arcs, cf. Fraichard,
"Trajectory planning in a dynamic workspace: a state-time space approach", 1998), anew at every step.
What nobody can know, the next goal of a pedestrian that arrives, is met with distance.
"""

from __future__ import annotations

import math

import numba
import numpy as np

import crowdbench
from crowdbench import orca_velocities
from crowdbench_agents.distance_field import DistanceField, look_up
from crowdbench_agents.footprint import advance, point_gap, wall_gap

PERIODS = np.array([1, 1, 2, 2, 2, 3, 3, 3, 3, 4])
"""Control periods for which each arc of a plan is driven: fine now, coarse later."""
FINE_LEVELS = 2
"""Arcs of a plan that are chosen among all; the others among the coarse half."""
TICKS = 2
"""Collision checks per control period."""
BEAM = 64
"""Partial plans kept after each arc."""
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
RUNNING, ENDED = 0, 1
ABSENT = -1.0
"""Radius of who is in nobody's way."""
LOST = 1000.0
"""Cost of a contact now; later contacts cost less, so that the last resort is to delay one [s]."""
ARRIVAL = 0.3
"""A pedestrian this near to its goal takes a new one [m]."""
SURPRISE = 1.2
"""Time after which a pedestrian's unknown next goal will have been noticed [s]."""
GONE = 2.5
"""A pedestrian with an unknown goal counts as gone after a walk of this length [m]."""


class Informed(crowdbench.Agent):
    """Searches time and space against the true future of everybody."""

    privileged = True

    def __init__(self, pedestrian_radius: float = 0.25) -> None:
        """Set the radius of every pedestrian [m]."""
        self._pedestrian_radius = pedestrian_radius

    def reset(self, robot: crowdbench.RobotSpec, seed: int) -> None:
        """Remember the robot's limits; there is no randomness."""
        self._robot = robot
        self._index = int(robot.name.rpartition("_")[2])
        low, high = robot.turn_rate
        slow, fast = max(0.0, robot.speed[0]), robot.speed[1]
        coarse = [(1.0, turn) for turn in (0.0, 0.35, 1.0, -0.35, -1.0)]
        coarse += [(0.4, turn) for turn in (0.0, 0.7, -0.7)] + [(0.0, t) for t in (0.0, 1.0, -1.0)]
        fine = [(1.0, turn) for turn in (0.12, 0.65, -0.12, -0.65)]
        fine += [(0.7, turn) for turn in (0.0, 0.5, -0.5)]
        fine += [(0.4, turn) for turn in (1.0, -1.0)] + [(0.0, t) for t in (0.4, -0.4)]
        self._arcs = np.array(
            [(slow + v * (fast - slow), w * (high if w > 0 else -low)) for v, w in coarse + fine]
        )
        self._field = None
        self._plan = np.empty((0, 2))

    def act(self, observation: crowdbench.Observation) -> crowdbench.Action:
        """Return the first arc of the best plan."""
        state, robot = observation.state, self._robot
        if state is None:
            raise ValueError("the informed agent needs the true state of the world")
        pose = state["robot_pose"][self._index]
        goal = state["robot_goal"][self._index]
        if self._field is None:
            self._field = DistanceField(
                goal, pose[:2], state["obstacles"], state["walls"], robot.width / 2 + 0.1
            )
        # Plans count on nobody's courtesy unless there is no other way.
        for courteous in (False, True):
            future, spread = self._predict(state, courteous)
            plan, cost = self._search(pose, state, future, spread)
            if cost < LOST / 2 or not state["pedestrian_reactive"].any():
                break
        self._plan = plan[1:]
        return plan[0]

    def _search(self, pose, state, future, spread):
        robot = self._robot
        limits = robot.acceleration or (np.inf, np.inf)
        plan = np.empty((int(PERIODS.sum()), 2))
        length, cost = _search(
            pose,
            state["robot_velocity"][self._index],
            state["robot_goal"][self._index],
            robot.goal_tolerance,
            robot.length / 2,
            robot.width / 2,
            robot.control_period,
            np.array([limits[0], limits[1]]),
            self._arcs,
            FINE_LEVELS,
            PERIODS,
            future,
            spread,
            state["obstacles"],
            state["walls"],
            self._field.origin,
            self._field.values,
            self._plan,
            plan,
        )
        return plan[:length], cost

    def _predict(self, state, courteous):
        """Discs at every tick: (ticks + 1, N, 3) x, y, radius, and their uncertainty (…, N) [m]."""
        periods = int(PERIODS.sum())
        return _predict(
            periods,
            self._robot.control_period,
            float(state["time"]),
            state["pedestrian_position"],
            state["pedestrian_velocity"],
            state["pedestrian_goal"],
            state["pedestrian_next_goal"],
            state["pedestrian_switch_time"],
            state["pedestrian_speed"],
            self._pedestrian_radius,
            state["robot_pose"],
            state["robot_velocity"],
            state["robot_active"],
            state["pedestrian_reactive"] & courteous,
            self._index,
            self._robot.radius,
            state["obstacles"],
            state["walls"],
        )


@numba.njit(cache=True)
def _predict(
    periods,
    period,
    time,
    position,
    velocity,
    goal,
    next_goal,
    switch_time,
    speed,
    radius,
    robot_pose,
    robot_velocity,
    robot_active,
    courteous,
    me,
    robot_radius,
    obstacles,
    walls,
):
    """Let everybody walk for ``periods`` control periods; other robots keep their velocity."""
    people, robots = len(position), len(robot_pose)
    future = np.zeros((periods * TICKS + 1, people + robots, 3))
    spread = np.zeros((periods * TICKS + 1, people + robots))
    position, velocity, goal = position.copy(), velocity.copy(), goal.copy()
    preferred, out = np.empty_like(position), np.empty_like(position)
    sees = np.zeros((people, 1), dtype=np.bool_)
    sees[:, 0] = courteous
    here, still = robot_pose[me : me + 1, :2].copy(), np.zeros((1, 2))
    arrived = np.full(people, np.inf)
    future[:, :, 2] = radius
    future[0, :people, :2] = position
    for step in range(periods):
        now = time + step * period
        for p in range(people):
            if now >= switch_time[p]:
                goal[p] = next_goal[p]
            dx, dy = goal[p, 0] - position[p, 0], goal[p, 1] - position[p, 1]
            distance = math.hypot(dx, dy)
            if distance < ARRIVAL and arrived[p] == np.inf:
                arrived[p] = now
            pace = min(speed[p], distance / period)
            preferred[p, 0] = pace * dx / distance if distance > 0.0 else 0.0
            preferred[p, 1] = pace * dy / distance if distance > 0.0 else 0.0
        orca_velocities(
            position, velocity, preferred, speed, radius, sees, here, still,
            robot_radius, 0.5, obstacles, walls, period, out,
        )  # fmt: skip
        velocity[:] = out
        for tick in range(1, TICKS + 1):
            row = step * TICKS + tick
            later = tick * period / TICKS
            for p in range(people):
                future[row, p, 0] = position[p, 0] + later * velocity[p, 0]
                future[row, p, 1] = position[p, 1] + later * velocity[p, 1]
                unknown = max(0.0, now + later - arrived[p])
                spread[row, p] = speed[p] * min(SURPRISE, unknown)
                if unknown * speed[p] > GONE:
                    future[row, p, 2] = ABSENT
        position += period * velocity
    for r in range(robots):
        ux = robot_velocity[r, 0] * math.cos(robot_pose[r, 2])
        uy = robot_velocity[r, 0] * math.sin(robot_pose[r, 2])
        for row in range(len(future)):
            later = row * period / TICKS
            future[row, people + r, 0] = robot_pose[r, 0] + later * ux
            future[row, people + r, 1] = robot_pose[r, 1] + later * uy
            # Oneself, and robots that have left, are in nobody's way.
            present = r != me and robot_active[r]
            future[row, people + r, 2] = robot_radius if present else ABSENT
    return future, spread


@numba.njit(cache=True)
def _search(
    pose,
    velocity,
    goal,
    tolerance,
    half_length,
    half_width,
    period,
    limits,
    arcs,
    fine,
    levels,
    future,
    spread,
    obstacles,
    walls,
    origin,
    lengths,
    kept,
    plan,
):
    """Beam search over sequences of arcs; writes the cheapest as (v, w) per period into ``plan``.

    A plan costs the time it takes, plus what is left of the way at full speed, plus discomfort.
    The first ``fine`` levels choose among all arcs, the others among the first half. What is left
    of the last plan, ``kept``, competes: a plan that still works is not to be lost between the
    arcs. Returns the length of the plan in periods and its cost.
    """
    top, turn = np.max(arcs[:, 0]), np.max(np.abs(arcs[:, 1]))
    scene = (
        goal,
        tolerance,
        half_length,
        half_width,
        period / TICKS,
        future,
        spread,
        obstacles,
        walls,
    )
    # Columns: x, y, heading, v, w, cost so far, row of the beam it continues (-1: the last plan).
    beam = np.zeros((BEAM + 1, 7))
    beam[0, :3], beam[0, 3:5] = pose, velocity
    alive, old, old_lives = 1, beam[0].copy(), True
    children, score = np.empty((len(beam) * len(arcs), 7)), np.empty(len(beam) * len(arcs))
    history = np.empty((len(levels), len(beam), 7))
    best, best_level, best_end = np.inf, 0, np.zeros(7)
    row, count = 0, 0
    for level in range(len(levels)):
        count = 0
        choices = len(arcs) if level < fine else len(arcs) // 2
        for b in range(alive):
            for a in range(choices):
                v, w = _within(arcs[a, 0], arcs[a, 1], beam[b, 3], beam[b, 4], limits * period)
                child = children[count]
                status = _drive(beam[b], v, w, row, levels[level] * TICKS, scene, child)
                child[6] = b
                if status == RUNNING:
                    left = _time_left(child, goal, tolerance, top, turn, origin, lengths)
                    score[count] = child[5] + left
                    count += 1
                elif child[5] < best:
                    best, best_level = child[5], level
                    best_end[:] = child
        for step in range(row // TICKS, row // TICKS + levels[level]):
            old_lives = old_lives and step < len(kept)
            if old_lives:
                status = _drive(old, kept[step, 0], kept[step, 1], step * TICKS, TICKS, scene, old)
                old_lives = status == RUNNING
                old[6] = -1
                if not old_lives and old[5] < best:
                    best, best_level = old[5], level
                    best_end[:] = old
        row += levels[level] * TICKS
        if count == 0 or best <= np.min(score[:count]):
            break
        if level < len(levels) - 1:
            alive = _select(children, score, count, beam)
            if old_lives:
                beam[alive] = old
                alive += 1
            history[level] = beam
    if count > 0:
        cheapest = np.argmin(score[:count])
        if score[cheapest] < best:
            best, best_level = score[cheapest], len(levels) - 1
            best_end[:] = children[cheapest]
    return _trace(best_end, best_level, levels, history, kept, plan), best


@numba.njit(cache=True)
def _trace(node, level, levels, history, kept, plan):
    """Write the plan that led to a node of a level, period by period; returns its length."""
    length = 0
    for i in range(level + 1):
        length += levels[i]
    last = length
    while level >= 0:
        if node[6] < 0:
            # Arriving ends the last plan, perhaps in the middle of a level.
            length = min(length, len(kept)) if last == length else length
            plan[: min(last, length)] = kept[: min(last, length)]
            return length
        first = last - levels[level]
        plan[first:last, 0], plan[first:last, 1] = node[3], node[4]
        last, level = first, level - 1
        if level >= 0:
            node = history[level, int(node[6])]
    return length


@numba.njit(cache=True)
def _time_left(node, goal, tolerance, top, turn, origin, lengths):
    """Least time from a pose to the goal [s], and a little for facing elsewhere."""
    dx, dy = goal[0] - node[0], goal[1] - node[1]
    off = (math.atan2(dy, dx) - node[2] + math.pi) % (2 * math.pi) - math.pi
    left = look_up(node[0], node[1], goal[0], goal[1], origin, lengths) - tolerance
    return max(0.0, left) / top + 0.5 * abs(off) / turn


@numba.njit(cache=True)
def _drive(node, v, w, row, ticks, scene, end):
    """Follow an arc for ``ticks`` from a node at ``row`` of the future; writes where it ends."""
    goal, tolerance, half_length, half_width, tick, future, spread, obstacles, walls = scene
    x, y, heading, cost = node[0], node[1], node[2], node[5]
    cost += TURN_COST * abs(w) * ticks * tick
    # The chord of one tick, and the rotation that takes one chord to the next.
    cosine, sine = math.cos(heading), math.sin(heading)
    turned_c, turned_s = math.cos(w * tick), math.sin(w * tick)
    chord_x, chord_y, _ = advance(0.0, 0.0, heading, v, w, tick)
    status = RUNNING
    for i in range(row + 1, row + ticks + 1):
        x, y = x + chord_x, y + chord_y
        cosine, sine = cosine * turned_c - sine * turned_s, sine * turned_c + cosine * turned_s
        chord_x, chord_y = (
            chord_x * turned_c - chord_y * turned_s,
            chord_y * turned_c + chord_x * turned_s,
        )
        discomfort = _discomfort(
            x, y, cosine, sine, half_length, half_width, future[i], spread[i], obstacles, walls
        )
        cost += tick * (1.0 + discomfort)
        if discomfort == np.inf:
            cost, status = LOST - i * tick, ENDED
            break
        if math.hypot(goal[0] - x, goal[1] - y) <= tolerance - 0.02:
            status = ENDED
            break
    end[0], end[1], end[2] = x, y, heading + w * ticks * tick
    end[3], end[4], end[5] = v, w, cost
    return status


@numba.njit(cache=True)
def _within(v, w, now_v, now_w, reach):
    """The nearest command that the acceleration limits permit."""
    v = min(now_v + reach[0], max(now_v - reach[0], v))
    return v, min(now_w + reach[1], max(now_w - reach[1], w))


@numba.njit(cache=True)
def _discomfort(x, y, cosine, sine, half_length, half_width, discs, spread, obstacles, walls):
    """Cost per second of being here [s/s]; inf for a contact."""
    total = 0.0
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
            return np.inf
        if gap < spread[d]:
            total += RISK_COST * (1.0 - gap / spread[d])
        if gap < COMFORT:
            short = 1.0 - gap / COMFORT
            total += COMFORT_COST * short * short
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


@numba.njit(cache=True)
def _select(children, score, count, beam):
    """Keep the best children, at most one per cell of position and heading."""
    order = np.argsort(score[:count])
    cells = np.empty((BEAM, 3), dtype=np.int64)
    kept = 0
    for i in order:
        cx, cy = math.floor(children[i, 0] / 0.12), math.floor(children[i, 1] / 0.12)
        ch = math.floor((children[i, 2] % (2 * math.pi)) / 0.4)
        fresh = True
        for k in range(kept):
            if cells[k, 0] == cx and cells[k, 1] == cy and cells[k, 2] == ch:
                fresh = False
                break
        if fresh:
            cells[kept, 0], cells[kept, 1], cells[kept, 2] = cx, cy, ch
            beam[kept] = children[i]
            kept += 1
            if kept == BEAM:
                break
    return kept
