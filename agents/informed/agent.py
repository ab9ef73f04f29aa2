"""Informed: the ceiling. Knows everybody's true position, velocity, goal and hidden intent.

Pedestrians are predicted as they walk in the simulation (``crowdbench.walk_ahead``, by ORCA),
towards the goals they really have and will really switch to. Against that prediction a beam search
in time and space looks for the fastest collision-free sequence of actions, anew at every step (cf.
Fraichard, "Trajectory planning in a dynamic workspace: a 'state-time space' approach", Advanced
Robotics 13, 1998). A robot that can stop and turn at once takes it that nobody sees it. One with
limits on its acceleration or with latency has to know how people will take what it does: they are
predicted to see it drive its last plan, then the one that was found among them, and so on; of these
plans that is driven which is best among people who see it. What nobody can know, the next goal of
somebody who arrives, is met with distance.

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
from crowdbench_agents.geometry.steering import slow_to_react
from crowdbench_agents.geometry.under_way import drive_ahead
from crowdbench_agents.informed.actions import arcs, lines
from crowdbench_agents.informed.distance_field import DistanceField
from crowdbench_agents.informed.goals import Goals
from crowdbench_agents.informed.prediction import (
    drive_on,
    evading,
    predict,
    recorded,
    walking_on,
)
from crowdbench_agents.informed.search import (
    HORIZON,
    LOST,
    QUICK,
    RISK_COST,
    THOROUGH,
    TICKS,
    cost_of,
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

ROUNDS = 3
"""How often people and a plan are brought to agree."""

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
        if intent == "sampled":
            self.unsupported_models = ("recorded",)  # whose people have no goals to be drawn
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
        # Who can stop and turn at once need not know how others will take it.
        self._counts_on_people = slow_to_react(robot) and self._intent != "velocity"
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
        plan = (self._agree if self._counts_on_people else self._insist)(pose, velocity, told)
        self._plan = plan[1:]
        return plan[0]

    def _insist(self, pose, velocity, told):
        """A plan that counts on nobody's courtesy unless there is no other way."""
        for courteous in (False, True):
            plan, cost = self._search(pose, velocity, told, self._foresee(told, courteous))
            if cost < LOST / 2 or not told[0]["pedestrian_reactive"].any():
                break
        return plan

    def _agree(self, pose, velocity, told):
        """The best plan found that is good among people who walk as they will because of it.

        How they walk depends on the plan, and which is best on how they walk: in turn.
        """
        plan = np.zeros((HORIZON, 2))
        if len(self._plan):
            left = min(len(self._plan), HORIZON)
            plan[:left], plan[left:] = self._plan[:left], self._plan[-1]
        best, lowest = plan, np.inf
        for again in reversed(range(ROUNDS)):
            future = self._foresee(told, True, plan)
            cost = self._cost(pose, told, future, plan)
            if cost < lowest:
                best, lowest = plan, cost
            if again:
                found, promised = self._search(pose, velocity, told, future)
                if promised >= LOST / 2 and lowest >= LOST / 2:
                    found, promised = self._search(pose, velocity, told, future, THOROUGH)
                if promised >= lowest:
                    break
                plan = np.concatenate([found, np.repeat(found[-1:], HORIZON - len(found), axis=0)])
        return best

    def _told(self, state):
        """What it is told of the state: one that may be true for each possible future."""
        told = [state]
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
        return self._goals.draw(state)

    def _search(self, pose, velocity, told, future, effort=QUICK):
        robot = self._robot
        limits = robot.acceleration or (np.inf, np.inf)
        plan = np.empty((HORIZON, 2))
        first, rest = self._scene(told, future)
        length, cost = search(
            pose,
            velocity,
            *first,
            np.array([limits[0], limits[1]]),
            *rest,
            *effort,
            self._plan,
            plan,
        )
        return plan[:length], cost

    def _cost(self, pose, told, future, plan):
        first, rest = self._scene(told, future)
        return cost_of(pose, *first, *rest, plan)

    def _scene(self, told, future):
        """What ``search`` takes between velocity and limits, and between these and the plan."""
        robot, state = self._robot, told[0]
        first = (
            state["robot_goal"][self._index],
            robot.goal_tolerance,
            robot.length / 2,
            robot.width / 2,
            robot.control_period,
        )
        rest = (
            self._turns,
            self._actions,
            *future,
            1.0 / len(told),
            self._price,
            state["obstacles"],
            state["walls"],
            self._field.origin,
            self._field.values,
            self._field.winds,
        )
        return first, rest

    def _foresee(self, told, courteous, plan=None):
        """Discs of all futures and their uncertainty, one beside the other, see ``_predict``."""
        predicted = [self._predict(future, courteous, plan) for future in told]
        return tuple(np.concatenate(part, axis=1) for part in zip(*predicted, strict=True))

    def _predict(self, state, courteous, plan=None):
        """Discs at every tick: (ticks + 1, N, 3) x, y, radius, and their uncertainty (…, N) [m].

        Args:
            state: of the world, as it is told.
            courteous: whether reactive people evade the robot.
            plan: (HORIZON, 2) that it follows; without one it stands.
        """
        robot, periods = self._robot, HORIZON + self._robot.latency
        people = len(state["pedestrian_position"])
        known = state
        if "recorded_ahead" in state:  # those who walk by no model are none of the model's
            known = told_of(np.arange(people + len(state["robot_pose"])) >= people, state)
        if plan is None:
            evaders = known["pedestrian_reactive"] & known["pedestrian_attentive"] & courteous
            known = evading(known, evaders)
            place = state["robot_pose"][self._index, :2]
            robots = np.tile([*place, 0.0, 0.0], (periods, 1, 1))
        else:
            robots = self._drive_on(state, plan)
        future, spread = predict(known, robot.control_period, robots, self._index, robot.radius)
        if "recorded_ahead" in state:
            as_recorded = recorded(state, robot.control_period, periods)
            future = np.concatenate([as_recorded, future], axis=1)
            spread = np.concatenate([np.zeros(as_recorded.shape[:2]), spread], axis=1)
        if self._growth > 0.0:
            later = np.arange(len(spread)) * (robot.control_period / TICKS)
            spread += self._growth * later[:, None]
        # A plan begins when its first command acts.
        return future[robot.latency * TICKS :], spread[robot.latency * TICKS :]

    def _drive_on(self, state, plan):
        """(periods, R, 4) how robots move on, see ``crowdbench.walk_ahead``; others straight."""
        robot, me = self._robot, self._index
        commands = np.concatenate([state["robot_under_way"][me], plan])
        later = np.arange(len(commands))[:, None, None] * robot.control_period
        place, moving = state["robot_pose"][:, :2], state["robot_world_velocity"]
        robots = np.concatenate(
            [place + later * moving, np.broadcast_to(moving, (len(commands), *moving.shape))],
            axis=2,
        )
        robots[:, ~state["robot_active"]] = np.nan
        robots[:, me] = drive_on(
            state["robot_pose"][me],
            state["robot_velocity"][me],
            commands,
            np.array(robot.acceleration or (np.inf, np.inf)) * robot.control_period,
            robot.control_period,
            self._turns,
            state["robot_goal"][me],
            robot.goal_tolerance,
        )
        return robots
