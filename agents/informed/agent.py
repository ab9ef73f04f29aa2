"""Informed: the ceiling. Knows everybody's true position, velocity, goal and hidden intent.

Pedestrians are predicted with the model by which they walk (ORCA), towards the goals they really
have and will really switch to, as if the robot were not there. Against that prediction a beam
search in time and space looks for the fastest collision-free sequence of actions, anew at every
step (cf. Fraichard, "Trajectory planning in a dynamic workspace: a 'state-time space' approach",
Advanced Robotics 13, 1998). What nobody can know, the next goal of a pedestrian that arrives, is
met with distance. Made for the scenarios that come with crowdbench: people walk by ORCA and take a
new goal on arrival.
"""

from __future__ import annotations

import math

import numpy as np
from crowdbench_agents.informed.distance_field import DistanceField
from crowdbench_agents.informed.search import ABSENT, HORIZON, LOST, TICKS, arcs, lines, search

import crowdbench
from crowdbench import orca_velocities
from crowdbench.compiled import compiled

ARRIVAL = 0.3
"""A pedestrian this near to its goal takes a new one [m]."""
SURPRISE = 1.2
"""Time after which a pedestrian's unknown next goal will have been noticed [s]."""
GONE = 2.5
"""A pedestrian with an unknown goal counts as gone after a walk of this length [m]."""


class Informed(crowdbench.Agent):
    """Searches time and space against the true future of everybody."""

    privileged = True
    drives = ("differential", "omnidirectional")
    version = "0.1.0"

    def reset(self, robot: crowdbench.RobotSpec, seed: int) -> None:
        """Remember the robot's limits; there is no randomness."""
        self._robot = robot
        self._index = int(robot.name.rpartition("_")[2])
        self._turns = robot.drive == "differential"
        self._actions = (
            arcs(robot.speed, robot.turn_rate)
            if self._turns
            else lines(robot.speed, robot.lateral_speed)
        )
        self._field: DistanceField | None = None
        self._plan = np.empty((0, 2))

    def act(self, observation: crowdbench.Observation) -> crowdbench.Action:
        """Return the first action of the best plan."""
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
        plan = np.empty((HORIZON, 2))
        length, cost = search(
            pose,
            state["robot_velocity"][self._index],
            state["robot_goal"][self._index],
            robot.goal_tolerance,
            robot.length / 2,
            robot.width / 2,
            robot.control_period,
            np.array([limits[0], limits[1]]),
            self._turns,
            self._actions,
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
        return _predict(
            self._robot.control_period,
            float(state["time"]),
            state["pedestrian_position"],
            state["pedestrian_velocity"],
            state["pedestrian_goal"],
            state["pedestrian_next_goal"],
            state["pedestrian_switch_time"],
            state["pedestrian_speed"],
            state["pedestrian_radius"],
            state["robot_pose"],
            state["robot_world_velocity"],
            state["robot_active"],
            state["pedestrian_reactive"] & courteous,
            self._index,
            self._robot.radius,
            state["obstacles"],
            state["walls"],
        )


@compiled()
def _predict(
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
    """Let everybody walk for a plan's length; other robots keep their velocity."""
    people, robots = len(position), len(robot_pose)
    future = np.zeros((HORIZON * TICKS + 1, people + robots, 3))
    spread = np.zeros((HORIZON * TICKS + 1, people + robots))
    position, velocity, goal = position.copy(), velocity.copy(), goal.copy()
    preferred, out = np.empty_like(position), np.empty_like(position)
    sees = np.zeros((people, 1), dtype=np.bool_)
    here, still = np.empty((1, 2)), np.zeros((1, 2))
    here[0, 0], here[0, 1] = robot_pose[me, 0], robot_pose[me, 1]
    arrived = np.full(people, np.inf)
    # Element by element: numba compiles numpy's message about shapes for assigned rows.
    for p in range(people):
        sees[p, 0] = courteous[p]
        future[0, p, 0], future[0, p, 1] = position[p, 0], position[p, 1]
        for row in range(len(future)):
            future[row, p, 2] = radius[p]
    for step in range(HORIZON):
        now = time + step * period
        for p in range(people):
            if now >= switch_time[p]:
                goal[p, 0], goal[p, 1] = next_goal[p, 0], next_goal[p, 1]
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
