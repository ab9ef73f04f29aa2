"""Informed: the ceiling. Knows everybody's true position, velocity, goal and hidden intent.

Pedestrians are predicted with the model by which they walk (ORCA), towards the goals they really
have and will really switch to, as if the robot were not there. Against that prediction a beam
search in time and space looks for the fastest collision-free sequence of actions, anew at every
step (cf. Fraichard, "Trajectory planning in a dynamic workspace: a 'state-time space' approach",
Advanced Robotics 13, 1998). What nobody can know, the next goal of a pedestrian that arrives, is
met with distance. Made for the scenarios that come with crowdbench: people walk by ORCA and take a
new goal on arrival.

With options it is told less, so that one sees where planners lose: in what they sense, in what they
foresee, or in what they decide.

- ``intent=velocity``: nothing of goals; people are predicted to walk on as they do, and may be
  farther from there the later it is.
- ``intent=sampled``: nothing of goals, but how they are drawn; several futures are drawn from what
  watching people tells about theirs (``crowdbench_agents.informed.goals``), and all count.
- ``view=6``: only people on a square map of 6 m, two thirds of it ahead, as learned agents have it.
- ``view=lidar``: only people whom at least one beam of a LiDAR at the robot's place meets.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from crowdbench_agents.geometry.under_way import drive_ahead
from crowdbench_agents.informed.distance_field import DistanceField
from crowdbench_agents.informed.goals import Goals
from crowdbench_agents.informed.prediction import (
    predict,
    recorded,
    together,
    walking_on,
)
from crowdbench_agents.informed.search import (
    HORIZON,
    LOST,
    RISK_COST,
    TICKS,
    arcs,
    lines,
    search,
)
from crowdbench_agents.informed.view import in_view, told_of
from pydantic import Field

import crowdbench

GROWTH = {"known": 0.0, "velocity": 0.3, "sampled": 0.0}
"""How fast people may come to be elsewhere than predicted, by intent [m/s]."""
PRICE = {"known": RISK_COST, "velocity": RISK_COST, "sampled": 3 * RISK_COST}
"""Cost of being where somebody may be, by intent [s/s]."""
FUTURES = 8
"""How many are sampled."""

Intent = Literal["known", "velocity", "sampled"]
View = Literal["all", "lidar"] | Annotated[float, Field(ge=0.1, le=1000)]


class Informed(crowdbench.Agent):
    """Searches time and space against the true future of everybody."""

    privileged = True
    drives = ("differential", "omnidirectional")
    version = "0.1.0"

    def __init__(
        self,
        intent: Annotated[Intent, Field()] = "known",
        view: Annotated[View, Field()] = "all",
        growth: Annotated[float | None, Field(ge=0, le=10)] = None,
        price: Annotated[float | None, Field(ge=0, le=1000)] = None,
        futures: Annotated[int | None, Field(ge=1, le=100)] = None,
    ) -> None:
        """Say what it is told.

        Args:
            intent: where people are going: the truth (``known``), nothing (``velocity``), or how
                goals are drawn (``sampled``).
            view: whom it is told of: ``all``, the side of a map around the robot [m], or ``lidar``.
            growth: how fast people may come to be elsewhere than predicted [m/s]; not for
                ``known``.
            price: cost of being where somebody may be [s/s]; not for ``known``.
            futures: how many are sampled; for ``sampled``.

        Raises:
            ValueError: an option that the intent has no use for.
        """
        for option, value, users in (
            ("growth", growth, ("velocity", "sampled")),
            ("price", price, ("velocity", "sampled")),
            ("futures", futures, ("sampled",)),
        ):
            if value is not None and intent not in users:
                only = " or ".join(f"intent={user}" for user in users)
                raise ValueError(f"option {option!r} goes with {only}, not with intent={intent}")
        self._intent, self._view = intent, view
        self._growth = GROWTH[intent] if growth is None else growth
        self._price = PRICE[intent] if price is None else price
        self._futures = FUTURES if futures is None else futures

    def reset(self, robot: crowdbench.RobotSpec, seed: int) -> None:
        """Remember the robot's limits; only the futures of ``sampled`` are random."""
        self._robot = robot
        self._rng = np.random.Generator(np.random.PCG64(seed))
        self._index = int(robot.name.rpartition("_")[2])
        self._turns = robot.drive == "differential"
        self._actions = (
            arcs(robot.speed, robot.turn_rate)
            if self._turns
            else lines(robot.speed, robot.lateral_speed)
        )
        self._field: DistanceField | None = None
        self._goals: Goals | None = None
        self._plan = np.empty((0, 2))

    def act(self, observation: crowdbench.Observation) -> crowdbench.Action:
        """Return the first action of the best plan."""
        state, robot = observation.state, self._robot
        if state is None:
            raise ValueError("the informed agent needs the true state of the world")
        pose, velocity = state["robot_pose"][self._index], state["robot_velocity"][self._index]
        if robot.latency:
            under_way = state["robot_under_way"][self._index]
            pose, velocity = drive_ahead(robot, pose, velocity, under_way)
        goal = state["robot_goal"][self._index]
        if self._field is None:
            self._field = DistanceField(
                goal, pose[:2], state["obstacles"], state["walls"], robot.width / 2 + 0.1
            )
        told = self._told(state)
        # Plans count on nobody's courtesy unless there is no other way.
        for courteous in (False, True):
            predicted = [self._predict(future, courteous) for future in told]
            future, spread = (np.concatenate(part, axis=1) for part in zip(*predicted, strict=True))
            plan, cost = self._search(pose, velocity, state, future, spread, 1.0 / len(told))
            if cost < LOST / 2 or not told[0]["pedestrian_reactive"].any():
                break
        self._plan = plan[1:]
        return plan[0]

    def _told(self, state):
        """What it is told of the state: one that may be true for each possible future."""
        told = [together(state)]
        seen = in_view(self._view, self._index, self._robot, state)
        if self._intent == "velocity":
            told = [walking_on(state)]
        elif self._intent == "sampled":
            told = self._draw(state, seen[: len(state["pedestrian_position"])])
        return told if seen.all() else [told_of(seen, future) for future in told]

    def _draw(self, state, seen):
        """The state with goals that may be the true ones, for each possible future."""
        if self._goals is None:
            robot = self._robot
            self._goals = Goals(state, robot.control_period, robot.radius, self._futures, self._rng)
        self._goals.update(state, seen)
        return [together(future) for future in self._goals.draw(state)]

    def _search(self, pose, velocity, state, future, spread, share):
        robot = self._robot
        limits = robot.acceleration or (np.inf, np.inf)
        plan = np.empty((HORIZON, 2))
        length, cost = search(
            pose,
            velocity,
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
            share,
            self._price,
            state["obstacles"],
            state["walls"],
            self._field.origin,
            self._field.values,
            self._field.winds,
            self._plan,
            plan,
        )
        return plan[:length], cost

    def _predict(self, state, courteous):
        """Discs at every tick: (ticks + 1, N, 3) x, y, radius, and their uncertainty (…, N) [m]."""
        robot, periods = self._robot, HORIZON + self._robot.latency
        people = len(state["pedestrian_position"])
        known = state
        if "recorded_ahead" in state:  # those who walk by no model are none of the model's
            known = told_of(np.arange(people + len(state["robot_pose"])) >= people, state)
        goal = known["pedestrian_goal"]
        future, spread = predict(
            robot.control_period,
            periods,
            float(known["time"]),
            known["pedestrian_position"],
            known["pedestrian_velocity"],
            goal,
            known["pedestrian_next_goal"],
            known["pedestrian_switch_time"],
            known["pedestrian_way"],
            known.get("pedestrian_further", np.empty((len(goal), 0, 2))),
            np.where(known["pedestrian_walks_on"], -np.inf, known["pedestrian_served_time"]),
            known["pedestrian_stop_time"],
            known["pedestrian_stop_end"],
            known["pedestrian_speed"],
            known["pedestrian_acceleration"],
            known["pedestrian_radius"],
            known["robot_pose"],
            known["robot_world_velocity"],
            known["robot_active"],
            known["pedestrian_reactive"] & known["pedestrian_attentive"] & courteous,
            self._index,
            robot.radius,
            known["obstacles"],
            known["walls"],
        )
        if known is not state:
            as_recorded = recorded(state, robot.control_period, periods)
            future = np.concatenate([as_recorded, future], axis=1)
            spread = np.concatenate([np.zeros(as_recorded.shape[:2]), spread], axis=1)
        if self._growth > 0.0:
            later = np.arange(len(spread)) * (robot.control_period / TICKS)
            spread += self._growth * later[:, None]
        # A plan begins when its first command acts.
        return future[robot.latency * TICKS :], spread[robot.latency * TICKS :]
