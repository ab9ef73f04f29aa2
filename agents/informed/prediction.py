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


def walking_on(state):
    """A state in which everybody's goal is straight ahead, and speed the present one."""
    velocity = state["pedestrian_velocity"]
    vx, vy = velocity[:, 0], velocity[:, 1]
    goal = state["pedestrian_position"] + STRAIGHT_ON * velocity
    return {
        **state,
        "pedestrian_goal": goal,
        "pedestrian_next_goal": goal,
        "pedestrian_switch_time": np.full(len(goal), np.inf),
        "pedestrian_speed": np.sqrt(vx * vx + vy * vy),
    }


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
    further,
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
    """Let everybody walk for a plan's length; other robots keep their velocity.

    Args:
        period: control period [s].
        periods: how many.
        time: now [s].
        position, velocity, goal, next_goal: (N, 2) of people [m, m/s].
        switch_time: (N,) when the next goal counts [s].
        further: (N, L, 2) goals after arrival [m]; when they are used up, nobody knows.
        speed, radius: (N,) [m/s, m].
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
    preferred, out = np.empty_like(position), np.empty_like(position)
    sees = np.zeros((people, 1), dtype=np.bool_)
    here, still = np.empty((1, 2)), np.zeros((1, 2))
    here[0, 0], here[0, 1] = robot_pose[me, 0], robot_pose[me, 1]
    arrived, begun = np.full(people, np.inf), np.zeros(people, dtype=np.int64)
    # Scenarios have pedestrians of one size, and so has the model by which they walk.
    widest = 0.0
    # Element by element: numba compiles numpy's message about shapes for assigned rows.
    for p in range(people):
        sees[p, 0] = courteous[p]
        future[0, p, 0], future[0, p, 1] = position[p, 0], position[p, 1]
        for row in range(len(future)):
            future[row, p, 2] = radius[p]
        widest = max(widest, radius[p])
    for step in range(periods):
        now = time + step * period
        for p in range(people):
            if begun[p] == 0 and now >= switch_time[p]:
                goal[p, 0], goal[p, 1] = next_goal[p, 0], next_goal[p, 1]
            dx, dy = goal[p, 0] - position[p, 0], goal[p, 1] - position[p, 1]
            distance = math.hypot(dx, dy)
            if distance < ARRIVAL and arrived[p] == np.inf:
                if begun[p] < further.shape[1]:
                    goal[p, 0], goal[p, 1] = further[p, begun[p], 0], further[p, begun[p], 1]
                    begun[p] += 1
                    dx, dy = goal[p, 0] - position[p, 0], goal[p, 1] - position[p, 1]
                    distance = math.hypot(dx, dy)
                else:
                    arrived[p] = now
            pace = min(speed[p], distance / period)
            preferred[p, 0] = pace * dx / distance if distance > 0.0 else 0.0
            preferred[p, 1] = pace * dy / distance if distance > 0.0 else 0.0
        orca_velocities(
            position, velocity, preferred, speed, widest, sees, here, still,
            robot_radius, 0.5, obstacles, walls, period, out,
        )  # fmt: skip
        for p in range(people):
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
