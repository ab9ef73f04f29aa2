"""One lane of ``Worlds`` under plain names, and one world by itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Scenario
from crowdbench.simulation.contact import Contact
from crowdbench.simulation.layout import Layout
from crowdbench.simulation.obstacle_map import MapGeometry
from crowdbench.simulation.worlds import Worlds

_LANE = np.zeros(1, dtype=np.int64)


class Pedestrians(NamedTuple):
    """State of P pedestrians; row p of every array belongs to pedestrian p.

    Attributes:
        position, velocity: (P, 2) [m], [m/s].
        heading: (P,) direction of the last step walked [rad].
        goal, start, next_goal: (P, 2) current target, start of the leg, target after a switch [m].
        speed: (P,) preferred speed, never exceeded [m/s].
        acceleration: (P,) limit on the change of velocity, inf without one [m/s^2].
        radius: (P,) of the discs that they are [m].
        intent: (P,) index into INTENTS.
        switch_time: (P,) when the leg is interrupted, inf when it is kept [s].
        present: (P,) in the scene; others are far from it.
        reactive: (P,) sees the robots; the others are non-reactive.
        attentive: (P,) does not look away now.
        attention_time: (P,) when that changes, inf for those who never look away [s].
        group: (P,) that each walks with, -1 for none.
        queue: (P,) that each belongs to, -1 for none.
        place: (P,) in the queue, from 0, -1 while somewhere else.
        served_time: (P,) when the first one in line leaves, inf before it is served [s].
        stop_time, stop_end: (P,) when the stop on this leg is, inf without one [s].
        walks_on: (P,) takes another goal on arrival; the others stand there.
        chosen: (P, 2) how they walk in this control period [m/s].
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    heading: NDArray[np.float64]
    goal: NDArray[np.float64]
    start: NDArray[np.float64]
    next_goal: NDArray[np.float64]
    speed: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    radius: NDArray[np.float64]
    intent: NDArray[np.int64]
    switch_time: NDArray[np.float64]
    present: NDArray[np.bool_]
    reactive: NDArray[np.bool_]
    attentive: NDArray[np.bool_]
    attention_time: NDArray[np.float64]
    group: NDArray[np.int64]
    queue: NDArray[np.int64]
    place: NDArray[np.int64]
    served_time: NDArray[np.float64]
    stop_time: NDArray[np.float64]
    stop_end: NDArray[np.float64]
    walks_on: NDArray[np.bool_]
    chosen: NDArray[np.float64]


class Lane:
    """Robots, pedestrians, obstacles and walls of one lane, under names without the lane.

    Attributes:
        worlds: where all of it is kept.
        pose: (R, 3) robots' x, y [m], heading [rad].
        velocity: (R, 2) what the robots' drive is doing, e.g. v [m/s], w [rad/s].
        under_way: (R, latency, 2) commands that do not act yet, the next to act first.
        direction: (R, 2) unit vectors along which the robots travel, in the world.
        speed: (R,) along these, negative backwards [m/s].
        world_velocity: (R, 2) direction times speed [m/s].
        active: (R,) robots still in the scene.
        goals: (R, 2) [m].
        pedestrians: everybody who walks.
        seen: (R, PROPRIOCEPTION + beams) what robots observe, as ``as_observation`` names it.
        maps: (R, cells, cells) their obstacle maps, where they are asked for.
        terms: (R, 3) of the reward, as in TERMS.
        outcome: (R,) index into OUTCOMES.
    """

    def __init__(self, worlds: Worlds, lane: int) -> None:
        """Take a lane in which an episode has begun."""
        self.worlds, self._lane = worlds, lane
        robots = worlds.state.robots[lane]
        self.pose, self.velocity = robots["pose"], robots["velocity"]
        self.under_way = worlds.state.under_way[lane]
        self.direction, self.speed = robots["direction"], robots["speed"]
        self.world_velocity, self.active = robots["world_velocity"], robots["active"]
        self.goals, self.terms, self.outcome = robots["goal"], robots["terms"], robots["outcome"]
        count = worlds.episode(lane).prepared.scenario.pedestrians.count
        people = worlds.state.people[lane, :count]
        self.pedestrians = Pedestrians(**{name: people[name] for name in Pedestrians._fields})
        self.seen = worlds.state.seen[lane]
        self.maps = None if worlds.drawn is None else worlds.drawn.maps[lane]

    @property
    def time(self) -> float:
        """Since the episode began [s]."""
        return float(self.worlds.state.worlds["time"][self._lane])

    @property
    def goal_area(self) -> NDArray[np.float64]:
        """(2,) length and width of the area around the middle of ``bounds`` in which pedestrians
        have their goals [m]."""
        world = self.worlds.state.worlds[self._lane]
        return np.array([2.0 * world["half_length"], 2.0 * world["half_width"]])

    @property
    def least_leg(self) -> float:
        """Least distance from where a leg begins to its goal [m]."""
        return float(self.worlds.state.worlds["leg"][self._lane])

    @property
    def switch_probability(self) -> float:
        """Chance that a leg is interrupted; 0 where goals are unimodal."""
        return float(self.worlds.state.worlds["switch_probability"][self._lane])

    @property
    def stop_share(self) -> float:
        """Chance that somebody stops on a leg."""
        return float(self.worlds.state.worlds["stop_share"][self._lane])

    @property
    def stop_duration(self) -> NDArray[np.float64]:
        """(2,) bounds of how long a stop lasts [s]."""
        return self.worlds.state.worlds["stop_for"][self._lane].copy()

    @property
    def field_of_view(self) -> float:
        """Angle within which reactive pedestrians see robots [rad]."""
        return 2.0 * float(self.worlds.state.worlds["half_view"][self._lane])

    @property
    def responsibility(self) -> float:
        """Share of an evasion that a pedestrian takes on when meeting a robot."""
        return float(self.worlds.state.worlds["responsibility"][self._lane])

    @property
    def way_clearance(self) -> float:
        """Distance that the ways of people keep from walls; 0 without any [m]."""
        routes = self.worlds.episode(self._lane).prepared.routes
        return 0.0 if routes is None else float(routes.network.reach.max(initial=0.0))

    @property
    def layout(self) -> Layout:
        """Where everything began."""
        return self.worlds.episode(self._lane).layout

    def recorded(self) -> dict[str, NDArray[Any]]:
        """What a recording says of the time to come, and who was held back; else nothing."""
        episode = self.worlds.episode(self._lane)
        if episode.layout.tracks is None:
            return {}
        step = round(self.time / episode.prepared.scenario.control_period)
        held = self.worlds.state.people["held"][self._lane, : len(self.pedestrians.present)]
        return {"recorded_ahead": episode.layout.tracks.ahead(step), "recorded_held": held.copy()}

    @property
    def ways(self) -> NDArray[np.float64]:
        """(P, POINTS, 2) next points of people's ways, the last one repeated; else goals [m]."""
        return self.worlds.ways(self._lane)

    @property
    def stream(self) -> NDArray[np.int64]:
        """(P,) the stream that each pedestrian walks in; -1: none."""
        routes = self.worlds.episode(self._lane).prepared.routes
        nowhere = np.full(len(self.pedestrians.speed), -1, dtype=np.int64)
        return nowhere if routes is None else routes.member[self.layout.traits.first]

    @property
    def stage(self) -> NDArray[np.int64]:
        """(P,) regions on the way of its stream that lie behind each pedestrian; -1 for those who
        wait to enter anew, and without a stream."""
        stream = self.stream
        if (stream < 0).all():
            return stream
        walks = self.worlds.state.walks[self._lane, : len(stream)]
        return np.where((stream >= 0) & (walks["waiting"] == 0), walks["stage"], -1)

    @property
    def stream_places(self) -> NDArray[np.float64]:
        """(N, S, K, 3) squares of the regions of streams, see ``Routes.places``."""
        routes = self.worlds.episode(self._lane).prepared.routes
        return np.empty((0, 0, 0, 3)) if routes is None else routes.places.copy()

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(4,) x_min, y_min, x_max, y_max of the area [m]."""
        return np.array(self.worlds.episode(self._lane).prepared.scenario.arena.bounds)

    @property
    def contacts(self) -> dict[int, Contact]:
        """What each robot has touched first, by robot."""
        touched = self.worlds.episode(self._lane).bodies.touched
        found = ((r, touched(r)) for r in range(len(self.pose)))
        return {r: contact for r, contact in found if contact is not None}


class World(Lane):
    """One world by itself."""

    def __init__(
        self, scenario: Scenario, seed: int, obstacle_map: MapGeometry | None = None
    ) -> None:
        """Place everything.

        Raises:
            ScenarioError: the scenario has no room for what it asks for, or its drive or walking
                model cannot be used.
        """
        self._scenario = scenario
        worlds = Worlds(1, [scenario], obstacle_map)
        worlds.begin(0, scenario, seed)
        super().__init__(worlds, 0)

    def begin(self, seed: int) -> None:
        """Begin another episode; arrays are the same ones.

        Raises:
            ScenarioError: the scenario has no room for what it asks for; nothing has changed.
        """
        self.worlds.begin(0, self._scenario, seed)

    def step(
        self,
        commands: NDArray[np.float64],
        walking: Mapping[int, NDArray[np.float64]] | None = None,
    ) -> None:
        """Advance everybody by one control period.

        Pedestrians all decide from the same snapshot; then robots and pedestrians move together.

        Args:
            commands: (R, 2) actions within the drive's bounds; rows of robots that have left the
                scene are ignored.
            walking: velocities (2,) [m/s] of pedestrians that are steered from outside.

        Raises:
            ScenarioError: the walking model returns no velocities, or far too fast ones.
        """
        self.worlds.choose(_LANE)
        for p, wanted in (walking or {}).items():
            self.pedestrians.chosen[p] = wanted
        self.worlds.move(_LANE, commands[None])

    def observe(self) -> None:
        """Write what the robots see into ``seen``."""
        self.worlds.observe(_LANE)

    def judge(self) -> None:
        """Write ``terms`` and ``outcome`` of a step that has been observed."""
        self.worlds.judge(_LANE)

    def remove(self, robot: int) -> None:
        """Take a robot out of the scene; one that has left stays where it is."""
        self.worlds.remove(0, robot)

    def reserve(self, pose: NDArray[np.float64], reserves: NDArray[np.bool_]) -> None:
        """Keep people from entering where robots would be that have left the scene.

        Args:
            pose: (R, 3) of the robots [m], [rad].
            reserves: (R,) those near which nobody enters in the next control period.
        """
        robots = self.worlds.state.robots[0]
        robots["pose"], robots["reserves"] = pose, reserves
