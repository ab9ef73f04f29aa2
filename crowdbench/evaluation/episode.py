"""Episode: the log of one robot's run, the only input of the metrics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from crowdbench.evaluation import interactions
from crowdbench.evaluation.shortest_path import Route, shortest_route
from crowdbench.simulation.contact import Contact

if TYPE_CHECKING:
    from crowdbench.evaluation.disturbance import Disturbance
    from crowdbench.scenario import Scenario

Outcome = Literal["success", "collision", "timeout", "agent_error"]


@dataclass(frozen=True, eq=False)
class Source:
    """What fixes an episode; all its robots share one.

    Attributes:
        scenario: the world.
        seed: episode seed.
        commands: for each robot (T_r, 2), as in ``Episode.commands``.
    """

    scenario: Scenario
    seed: int
    commands: Sequence[NDArray[np.float64]]

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Source)
            and (self.scenario, self.seed) == (other.scenario, other.seed)
            and len(self.commands) == len(other.commands)
            and all(map(np.array_equal, self.commands, other.commands))
        )

    @cached_property
    def disturbance(self) -> Disturbance | None:
        """What the robots cost the people, None where it is not defined for the scenario."""
        from crowdbench.evaluation.disturbance import disturbance, undefined

        if undefined(self.scenario):
            return None
        return disturbance(self.scenario, self.seed, self.commands)


@dataclass(frozen=True)
class Episode:
    """Everything that happened to one robot, T control steps, P pedestrians, K obstacles, S walls.

    Arrays of T + 1 rows hold states: row 0 after reset, row t after action t - 1. Positions are
    in the world frame.

    Attributes:
        scenario: name of the scenario.
        agent: the agent with its options, e.g. ``NAME:horizon=2``.
        seed: episode seed.
        robot: name of the robot in the environment.
        control_period: time between two actions [s].
        footprint: robot's length and width [m].
        goal_tolerance: arrival distance [m].
        top_speed: the fastest that the drive lets it travel [m/s].
        goal: (2,) [m].
        walls: (S, 4) segments x1, y1, x2, y2 [m].
        obstacles: (K, 3) x, y, radius [m].
        pedestrian_radius: (P,) [m].
        robot_pose: (T + 1, 3) x, y [m], heading [rad].
        robot_world_velocity: (T + 1, 2) its velocity in the world [m/s].
        robot_speed: (T + 1,) along the direction in which it travels, negative backwards [m/s].
        actions: (T, 2) as executed (clipped), in the terms of the scenario's drive: for a
            differential one v [m/s], w [rad/s].
        other_robots: (T + 1, R - 1, 3) poses of the other robots, NaN once they are gone.
        pedestrian_reactive: (P,) which pedestrians see the robot.
        pedestrian_attentive: (T + 1, P) who does not look away; reactive ones see the robot then.
        pedestrian_position: (T + 1, P, 2) [m]; NaN where somebody is not there.
        pedestrian_velocity: (T + 1, P, 2) [m/s].
        pedestrian_goal: (T + 1, P, 2) where each is heading now [m].
        pedestrian_intent: (T + 1, P) index into ``crowdbench.simulation.contact.INTENTS``, hidden
            from the robot.
        pedestrian_switch_time: (T + 1, P) when the leg is interrupted [s]; inf for kept legs.
        pedestrian_group: (P,) the group that each walks with, -1 for none.
        pedestrian_queue: (P,) the queue that each belongs to, -1 for none.
        pedestrian_place: (T + 1, P) place in it, from 0, -1 for somebody who is somewhere else.
        pedestrian_stop_time, pedestrian_stop_end: (T + 1, P) when the pedestrian stops on this leg
            and walks on [s]; inf for legs without a stop.
        inference_s: (T,) wall-clock seconds spent in ``act``.
        outcome: how it ended.
        contact: what was touched when the outcome is ``collision``.
        error: the agent's message when the outcome is ``agent_error``.
        diagnostics: the agent's own counters.
        commands: (T, 2) what the agent asked for, before any limit; with them and the seed the
            episode can be simulated again. Empty where it was not recorded.
        processor_share: processor time of the process inside ``act``, as a share of the sum of
            ``inference_s``; well below 1, the process waited for something.
        source: what it was simulated from, by which people's ways without the robot are found;
            None for a log that was made by hand.
    """

    scenario: str
    agent: str
    seed: int
    robot: str
    control_period: float
    footprint: tuple[float, float]
    goal_tolerance: float
    top_speed: float
    goal: NDArray[np.float64]
    walls: NDArray[np.float64]
    obstacles: NDArray[np.float64]
    pedestrian_radius: NDArray[np.float64]
    robot_pose: NDArray[np.float64]
    robot_world_velocity: NDArray[np.float64]
    robot_speed: NDArray[np.float64]
    actions: NDArray[np.float64]
    other_robots: NDArray[np.float64]
    pedestrian_reactive: NDArray[np.bool_]
    pedestrian_attentive: NDArray[np.bool_]
    pedestrian_position: NDArray[np.float64]
    pedestrian_velocity: NDArray[np.float64]
    pedestrian_goal: NDArray[np.float64]
    pedestrian_intent: NDArray[np.int64]
    pedestrian_switch_time: NDArray[np.float64]
    pedestrian_group: NDArray[np.int64]
    pedestrian_queue: NDArray[np.int64]
    pedestrian_place: NDArray[np.int64]
    pedestrian_stop_time: NDArray[np.float64]
    pedestrian_stop_end: NDArray[np.float64]
    inference_s: NDArray[np.float64]
    outcome: Outcome
    contact: Contact | None = None
    error: str | None = None
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    commands: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    processor_share: float = 1.0
    source: Source | None = field(default=None, repr=False)

    @property
    def steps(self) -> int:
        """T, the number of actions executed."""
        return len(self.actions)

    @property
    def reach(self) -> NDArray[np.float64]:
        """(P,) radius of the circle around the footprint plus each pedestrian's radius [m]."""
        return math.hypot(*self.footprint) / 2 + self.pedestrian_radius

    @cached_property
    def clearance(self) -> NDArray[np.float64]:
        """(T + 1, P) distance between footprint and pedestrians, 0 when they touch [m].

        NaN where somebody is not there.
        """
        return interactions.clearance(
            self.robot_pose, self.footprint, self.pedestrian_position, self.pedestrian_radius
        )

    @cached_property
    def crossing_gaps(self) -> NDArray[np.float64]:
        """(T, P) time gap wherever the robot crosses a pedestrian's path, else infinite [s]."""
        return interactions.crossing_gaps(
            self.robot_pose[:, :2],
            self.pedestrian_position,
            self.pedestrian_velocity,
            self.control_period,
            self.reach,
        )

    @cached_property
    def route(self) -> Route:
        """The shortest path from the start to the goal's centre among walls and obstacles.

        It keeps half the footprint's lesser side away from them, which is the least distance that
        any pose needs.
        """
        clearance = min(self.footprint) / 2
        start = self.robot_pose[0, :2]
        return shortest_route(start, self.goal, self.walls, self.obstacles, clearance)
