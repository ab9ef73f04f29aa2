"""Discs that people are predicted to be, tick by tick: they walk by ``crowdbench.walk_ahead``."""

from __future__ import annotations

import math

import numpy as np
from crowdbench_agents.geometry.footprint import advance
from crowdbench_agents.informed.search import ABSENT, TICKS

import crowdbench
from crowdbench.compiled import compiled

SURPRISE = 1.2
"""Time after which a pedestrian's unknown next goal will have been noticed [s]."""
GONE = 2.5
"""A pedestrian with an unknown goal counts as gone after a walk of this length [m]."""
STRAIGHT_ON = 100.0
"""People who walk on as they do have goals as far away as they would get in this time [s]."""


def without_hidden(state):
    """A state without what people will do beside walking to their goals."""
    told = {name: value for name, value in state.items() if name != "recorded_ahead"}
    never = np.full(len(state["pedestrian_position"]), np.inf)
    names = ("stop_time", "served_time", "attention_time")
    return {**told, **{f"pedestrian_{name}": never for name in names}}


def walking_on(state):
    """A state in which everybody's goal is straight ahead, and speed the present one."""
    velocity = state["pedestrian_velocity"]
    vx, vy = velocity[:, 0], velocity[:, 1]
    goal = state["pedestrian_position"] + STRAIGHT_ON * velocity
    alone = np.full(len(goal), -1)
    return {
        **without_hidden(state),
        "pedestrian_goal": goal,
        "pedestrian_next_goal": goal,
        "pedestrian_way": goal[:, None],
        "pedestrian_switch_time": np.full(len(goal), np.inf),
        "pedestrian_speed": np.sqrt(vx * vx + vy * vy),
        "pedestrian_group": alone,
        "pedestrian_stream": alone,
    }


def evading(state, who):
    """A state in which only some people (P,) see robots, all around, and evade as one another."""
    return {
        **state,
        "pedestrian_reactive": who,
        "pedestrian_attentive": np.ones(len(who), dtype=bool),
        "pedestrian_attention_time": np.full(len(who), np.inf),
        "field_of_view": np.array(2 * math.pi),
        "responsibility": np.array(0.5),
    }


def recorded(state, period, periods):
    """Discs of people who walk as recorded, the same as ``discs_of`` returns for people."""
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


def predict(state, period, robots, me, robot_radius):
    """Let everybody walk for a plan's length; other robots keep their velocity.

    Args:
        state: of the world, as it is told.
        period: control period [s].
        robots: (periods, R, 4) those that people may see, see ``crowdbench.walk_ahead``.
        me: index of one's own robot.
        robot_radius: [m].

    Returns:
        Discs at every tick (periods * TICKS + 1, P + R, 3): x, y, radius, of all people and all
        robots, and how far each may be from there (periods * TICKS + 1, P + R) [m].
    """
    walk = crowdbench.walk_ahead(state, period, robots, robot_radius)
    return _discs(
        period,
        float(state["time"]),
        walk.position,
        walk.velocity,
        walk.arrived,
        np.where(walk.leaves, 0.0, GONE),
        state["pedestrian_speed"],
        state["pedestrian_radius"],
        state["robot_pose"],
        state["robot_world_velocity"],
        state["robot_active"],
        me,
        robot_radius,
    )


@compiled()
def _discs(
    period,
    time,
    position,
    velocity,
    arrived,
    gone,
    speed,
    radius,
    robot_pose,
    robot_velocity,
    robot_active,
    me,
    robot_radius,
):
    """See ``predict``; ``gone`` (P,): walk after which each person who has arrived is gone [m]."""
    periods, people, robots = len(velocity), len(speed), len(robot_pose)
    future = np.zeros((periods * TICKS + 1, people + robots, 3))
    spread = np.zeros((periods * TICKS + 1, people + robots))
    for p in range(people):
        future[0, p, 0], future[0, p, 1] = position[0, p, 0], position[0, p, 1]
        for row in range(len(future)):
            future[row, p, 2] = radius[p]
    for step in range(periods):
        now = time + step * period
        for tick in range(1, TICKS + 1):
            row = step * TICKS + tick
            later = tick * period / TICKS
            for p in range(people):
                future[row, p, 0] = position[step, p, 0] + later * velocity[step, p, 0]
                future[row, p, 1] = position[step, p, 1] + later * velocity[step, p, 1]
                unknown = max(0.0, now + later - arrived[p])
                spread[row, p] = speed[p] * min(SURPRISE, unknown)
                if unknown * speed[p] > gone[p]:
                    future[row, p, 2] = ABSENT
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


@compiled()
def drive_on(pose, velocity, commands, reach, period, turns, goal, tolerance):
    """Where a robot is and how it moves when people look at it, at the beginning of each period.

    Args:
        pose, velocity: (3,), (2,) now.
        commands: (T, 2) actions that it follows.
        reach: (2,) how far the velocity can change in a period.
        period: [s].
        turns: whether the robot is differential, else omnidirectional.
        goal, tolerance: where it leaves [m].

    Returns:
        (T, 4) x, y [m], velocity in the world [m/s]; NaN when it has left.
    """
    x, y, heading = pose[0], pose[1], pose[2]
    first, second = velocity[0], velocity[1]
    driven = np.full((len(commands), 4), np.nan)
    for k in range(len(commands)):
        cosine, sine = math.cos(heading), math.sin(heading)
        aside = 0.0 if turns else second
        driven[k, 0], driven[k, 1] = x, y
        driven[k, 2], driven[k, 3] = cosine * first - sine * aside, sine * first + cosine * aside
        first = min(max(commands[k, 0], first - reach[0]), first + reach[0])
        second = min(max(commands[k, 1], second - reach[1]), second + reach[1])
        if turns:
            x, y, heading = advance(x, y, heading, first, second, period)
        else:
            x += period * (cosine * first - sine * second)
            y += period * (sine * first + cosine * second)
        if math.hypot(goal[0] - x, goal[1] - y) <= tolerance:
            break
    return driven
