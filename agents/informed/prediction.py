"""How people will walk: by their model (ORCA) towards goals that are given, as if nobody drove."""

from __future__ import annotations

import math

import numpy as np
from crowdbench_agents.informed.search import ABSENT, TICKS

from crowdbench import orca_velocities
from crowdbench.compiled import compiled

ARRIVAL = 0.3
"""A pedestrian this near to its goal takes a new one [m]."""
SURPRISE = 1.2
"""Time after which a pedestrian's unknown next goal will have been noticed [s]."""
GONE = 2.5
"""A pedestrian with an unknown goal counts as gone after a walk of this length [m]."""
STRAIGHT_ON = 100.0
"""People who walk on as they do have goals as far away as they would get in this time [s]."""


def without_hidden(state):
    """A state without what people will do beside walking to their goals."""
    told = {name: value for name, value in state.items() if name != "recorded_ahead"}
    nothing = np.full(len(state["pedestrian_position"]), np.inf)
    return {**told, "pedestrian_stop_time": nothing, "pedestrian_served_time": nothing}


def together(state):
    """A state in which groups keep their formation and the pace of their slowest."""
    group = state["pedestrian_group"]
    if (group < 0).all():
        return state
    leader = np.arange(len(group))
    speed = state["pedestrian_speed"].copy()
    for g in np.unique(group[group >= 0]):
        members = np.flatnonzero(group == g)
        leader[members], speed[members] = members[0], speed[members].min()
    place = state["pedestrian_position"]
    offset = place - place[leader]
    led = {"pedestrian_speed": speed}
    for name in ("goal", "next_goal", "way", "further"):
        if (points := state.get(f"pedestrian_{name}")) is not None:
            aside = offset if points.ndim == 2 else offset[:, None]
            led[f"pedestrian_{name}"] = points[leader] + aside
    for name in ("switch_time", "walks_on", "stop_time", "stop_end"):
        led[f"pedestrian_{name}"] = state[f"pedestrian_{name}"][leader]
    return {**state, **led}


def walking_on(state):
    """A state in which everybody's goal is straight ahead, and speed the present one."""
    velocity = state["pedestrian_velocity"]
    vx, vy = velocity[:, 0], velocity[:, 1]
    goal = state["pedestrian_position"] + STRAIGHT_ON * velocity
    return {
        **without_hidden(state),
        "pedestrian_goal": goal,
        "pedestrian_next_goal": goal,
        "pedestrian_way": goal[:, None],
        "pedestrian_switch_time": np.full(len(goal), np.inf),
        "pedestrian_speed": np.sqrt(vx * vx + vy * vy),
    }


def recorded(state, period, periods):
    """Discs of people who walk as recorded, the same as ``predict`` returns for people."""
    place, radius = state["pedestrian_position"], state["pedestrian_radius"]
    steps = np.concatenate([place[None], state["recorded_ahead"][:periods]])
    steps = np.concatenate([steps, np.repeat(steps[-1:], periods + 1 - len(steps), axis=0)])
    future = np.empty((periods * TICKS + 1, len(place), 3))
    future[::TICKS, :, :2] = steps
    for tick in range(1, TICKS):
        share = tick / TICKS
        future[tick::TICKS, :, :2] = (1.0 - share) * steps[:-1] + share * steps[1:]
    there = np.isfinite(future[:, :, 0])
    future[:, :, 2] = np.where(there, radius, ABSENT)
    return np.where(there[:, :, None], future, [0.0, 0.0, ABSENT])


@compiled()
def predict(
    period,
    periods,
    time,
    position,
    velocity,
    goal,
    next_goal,
    switch_time,
    way,
    further,
    stays,
    stop_time,
    stop_end,
    speed,
    acceleration,
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
    """Let everybody walk for a plan's length; other robots keep their velocity.

    Args:
        period: control period [s].
        periods: how many.
        time: now [s].
        position, velocity, goal, next_goal: (N, 2) of people [m, m/s].
        switch_time: (N,) when the next goal counts [s].
        way: (N, W, 2) points that lead to the goal, the last ones repeated [m].
        further: (N, L, 2) goals after arrival [m]; when they are used up, nobody knows.
        stays: (N,) until when a person who has arrived stays there [s].
        stop_time, stop_end: (N,) between which a person stands [s].
        speed, acceleration, radius: (N,) [m/s, m/s^2, m].
        robot_pose, robot_velocity, robot_active: of R robots, in the world.
        courteous: (N,) who evades the robot ``me``, which is taken to stand still.
        me: index of one's own robot.
        robot_radius: [m].
        obstacles: (K, 3) x, y, radius [m].
        walls: (S, 4) x1, y1, x2, y2 [m].

    Returns:
        Discs at every tick (periods * TICKS + 1, N + R, 3): x, y, radius, and how far each may be
        from there (periods * TICKS + 1, N + R) [m].
    """
    people, robots = len(position), len(robot_pose)
    future = np.zeros((periods * TICKS + 1, people + robots, 3))
    spread = np.zeros((periods * TICKS + 1, people + robots))
    position, velocity, goal = position.copy(), velocity.copy(), goal.copy()
    at = np.zeros(people, dtype=np.int64)
    preferred, out = np.empty_like(position), np.empty_like(position)
    sees = np.zeros((people, 1), dtype=np.bool_)
    here, still = np.empty((1, 2)), np.zeros((1, 2))
    here[0, 0], here[0, 1] = robot_pose[me, 0], robot_pose[me, 1]
    arrived, begun = np.full(people, np.inf), np.zeros(people, dtype=np.int64)
    # Element by element: numba compiles numpy's message about shapes for assigned rows.
    for p in range(people):
        sees[p, 0] = courteous[p]
        future[0, p, 0], future[0, p, 1] = position[p, 0], position[p, 1]
        for row in range(len(future)):
            future[row, p, 2] = radius[p]
    for step in range(periods):
        now = time + step * period
        for p in range(people):
            if begun[p] == 0 and now >= switch_time[p]:
                goal[p, 0], goal[p, 1] = next_goal[p, 0], next_goal[p, 1]
                at[p] = way.shape[1]
            x, y = goal[p, 0], goal[p, 1]
            if at[p] < way.shape[1]:
                x, y = way[p, at[p], 0], way[p, at[p], 1]
            dx, dy = x - position[p, 0], y - position[p, 1]
            distance = math.hypot(dx, dy)
            while distance < ARRIVAL and at[p] < way.shape[1]:
                at[p] += 1
                x, y = goal[p, 0], goal[p, 1]
                if at[p] < way.shape[1]:
                    x, y = way[p, at[p], 0], way[p, at[p], 1]
                dx, dy = x - position[p, 0], y - position[p, 1]
                distance = math.hypot(dx, dy)
            if distance < ARRIVAL and arrived[p] == np.inf and now >= stays[p]:
                if begun[p] < further.shape[1]:
                    goal[p, 0], goal[p, 1] = further[p, begun[p], 0], further[p, begun[p], 1]
                    begun[p] += 1
                    dx, dy = goal[p, 0] - position[p, 0], goal[p, 1] - position[p, 1]
                    distance = math.hypot(dx, dy)
                else:
                    arrived[p] = now
            pace = min(speed[p], distance / period)
            if distance == 0.0 or stop_time[p] <= now < stop_end[p]:
                pace, distance = 0.0, 1.0
            preferred[p, 0] = pace * dx / distance
            preferred[p, 1] = pace * dy / distance
        orca_velocities(
            position, velocity, preferred, speed, radius, sees, here, still,
            robot_radius, 0.5, obstacles, walls, period, out,
        )  # fmt: skip
        for p in range(people):
            x, y, most = out[p, 0] - velocity[p, 0], out[p, 1] - velocity[p, 1], acceleration[p]
            change = math.hypot(x, y) / (most * period) if most < np.inf else 0.0
            if change > 1.0:
                velocity[p, 0] += x / change
                velocity[p, 1] += y / change
            else:
                velocity[p, 0], velocity[p, 1] = out[p, 0], out[p, 1]
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
        for p in range(people):
            position[p, 0] += period * velocity[p, 0]
            position[p, 1] += period * velocity[p, 1]
    for r in range(robots):
        ux, uy = robot_velocity[r, 0], robot_velocity[r, 1]
        for row in range(len(future)):
            later = row * period / TICKS
            future[row, people + r, 0] = robot_pose[r, 0] + later * ux
            future[row, people + r, 1] = robot_pose[r, 1] + later * uy
            # Oneself, and robots that have left, are in nobody's way.
            present = r != me and robot_active[r]
            future[row, people + r, 2] = robot_radius if present else ABSENT
    return future, spread
