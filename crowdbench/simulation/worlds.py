"""Worlds side by side: bodies and contacts, and one control step of everybody in them.

What is built in runs compiled, over all lanes at once. Drives and walking models from elsewhere,
noise, and what is drawn for an episode stay in Python, in the lanes that need them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.agent import lidar_angles
from crowdbench.scenario import Scenario
from crowdbench.simulation import kinematics, streams, walking
from crowdbench.simulation.chipmunk import FUNCTIONS, Bodies
from crowdbench.simulation.kinematics import Drive, make_drive
from crowdbench.simulation.lanes import (
    DRAWS,
    LEGS_AHEAD,
    PROPRIOCEPTION,
    allocate,
    world_of,
)
from crowdbench.simulation.layout import Layout, place
from crowdbench.simulation.lidar import beam_table
from crowdbench.simulation.motion import move
from crowdbench.simulation.pedestrians import begin_legs, decide, look
from crowdbench.simulation.reward import judge
from crowdbench.simulation.sensing import add_noise, observe, outline
from crowdbench.simulation.substeps import body_speed, physics
from crowdbench.simulation.walking import Crowd, WalkingModel, make_walking_model

Lanes = NDArray[np.int64]


class Prepared(NamedTuple):
    """What the episodes of a scenario share."""

    scenario: Scenario
    drive: Drive
    world: NDArray[np.void]
    corners: list[tuple[float, float]]
    noisy: bool


@dataclass
class Episode:
    """What a lane keeps in Python.

    Attributes:
        prepared: of its scenario.
        seed: that fixes it.
        layout: where everything began.
        bodies: what Chipmunk moves.
        model: how pedestrians walk.
        streams: of the pedestrians' legs.
        noise: of the robots' LiDARs, where these are noisy.
    """

    prepared: Prepared
    seed: int
    layout: Layout
    bodies: Bodies
    model: WalkingModel
    streams: list[np.random.Generator]
    noise: list[np.random.Generator]


class Worlds:
    """L worlds, with an episode each once it has begun.

    Attributes:
        state: of all lanes, as compiled functions know it.
        episodes: (L,) the present ones.
    """

    def __init__(self, lanes: int, scenarios: Sequence[Scenario]) -> None:
        """Make room for any of the scenarios in every lane; robots and LiDAR have to be alike."""
        self.state = allocate(lanes, scenarios)
        self.episodes: list[Episode | None] = [None] * lanes
        self._beams = beam_table(lidar_angles(scenarios[0]))
        self._prepared: dict[int, Prepared] = {}
        self._kernels: list[Callable[..., None] | None] = [None] * lanes
        self._noisy: set[int] = set()

    def episode(self, lane: int) -> Episode:
        """The present episode of a lane that has begun."""
        episode = self.episodes[lane]
        assert episode is not None, f"no episode has begun in lane {lane}"
        return episode

    def begin(self, lane: int, scenario: Scenario, seed: int) -> None:
        """Begin an episode in a lane; what was there before ends.

        Raises:
            ScenarioError: the scenario has no room for what it asks for, or its drive or walking
                model cannot be used. The lane stays as it was.
        """
        prepared = self._prepare(scenario)
        model = make_walking_model(scenario)
        layout = place(scenario, seed)
        state = self.state
        state.worlds[lane] = prepared.world
        state.obstacles[lane, : len(layout.obstacles)] = layout.obstacles
        state.walls[lane, : len(layout.walls)] = layout.walls
        self._place_robots(lane, layout, prepared)
        drawing = self._place_people(lane, layout, seed, scenario)
        bodies = Bodies(
            layout.robot_pose,
            prepared.corners,
            layout.pedestrian_position,
            scenario.pedestrians.radius,
            layout.obstacles,
            layout.walls,
            state.contacts[lane],
        )
        state.worlds["space"][lane] = bodies.space
        state.robots["body"][lane] = bodies.addresses[: state.robots.shape[1]]
        state.people["body"][lane, : scenario.pedestrians.count] = bodies.addresses[
            state.robots.shape[1] :
        ]
        noisy = state.robots.shape[1] if prepared.noisy else 0
        noise = [streams.lidar(seed, r) for r in range(noisy)]
        before = self.episodes[lane]
        self._kernels[lane] = walking.kernel_of(model)
        (self._noisy.add if noisy else self._noisy.discard)(lane)
        self.episodes[lane] = Episode(prepared, seed, layout, bodies, model, drawing, noise)
        if before is not None:
            before.bodies.free()
        if self._kernels[lane] is None:
            look(state.worlds[lane], state.robots[lane], state.people[lane], state.sees[lane])
            model.reset(self._crowd(lane), streams.walking(seed))

    def choose(self, lanes: Lanes) -> None:
        """Let all pedestrians decide from the same snapshot how to walk.

        Raises:
            ScenarioError: a walking model returns no velocities.
        """
        s = self.state
        if decide(lanes, s.worlds, s.robots, s.people, s.obstacles, s.sees, s.draws):
            self._draw()
        kernels = [self._kernels[lane] for lane in lanes.tolist()]
        for kernel in set(kernels):
            which = lanes[np.array([other is kernel for other in kernels])]
            if kernel is None:
                for lane in which.tolist():
                    self._choose_in_python(lane)
            else:
                kernel(which, s.worlds, s.robots, s.people, s.obstacles, s.walls, s.sees)

    def move(self, lanes: Lanes, commands: NDArray[np.float64]) -> None:
        """Move robots and pedestrians together, for one control period.

        Args:
            lanes: (M,) which.
            commands: (M, R, 2) actions within the drive's bounds; those of robots that have left
                the scene are ignored.

        Raises:
            ScenarioError: somebody is far too fast.
        """
        s = self.state
        stuck = move(lanes, commands, s.worlds, s.robots, s.people, FUNCTIONS)
        if stuck >= 0:
            scenario = self.episode(stuck).prepared.scenario
            physics(scenario, float(s.worlds["bias"][stuck]))
        for i in np.flatnonzero(s.worlds["drive"][lanes] == kinematics.OTHER).tolist():
            self._move_by_drive(int(lanes[i]), commands[i])

    def observe(self, lanes: Lanes) -> None:
        """Write what robots see, and how near the nearest thing is, into ``state``."""
        s = self.state
        if s.robots.shape[1] > 1:
            outline(lanes, s.worlds, s.robots)
        observe(lanes, s.worlds, s.robots, s.people, s.obstacles, s.walls, self._beams, s.seen)
        for lane in self._noisy.intersection(lanes.tolist()):
            episode = self.episode(lane)
            for r, noise in enumerate(episode.noise):
                if s.robots["active"][lane, r]:
                    scan = s.seen[lane, r, PROPRIOCEPTION:]
                    add_noise(scan, episode.prepared.scenario, noise)

    def judge(self, lanes: Lanes) -> None:
        """Write reward terms and outcomes of a step that has been observed into ``state``."""
        s = self.state
        judge(lanes, s.worlds, s.robots, s.people, s.contacts)

    def remove(self, lane: int, robot: int) -> None:
        """Take a robot out of the scene."""
        self.state.robots["active"][lane, robot] = False
        self.episode(lane).bodies.remove(robot)

    def _prepare(self, scenario: Scenario) -> Prepared:
        if id(scenario) not in self._prepared:
            drive = make_drive(scenario)
            x, y = scenario.robots.length / 2, scenario.robots.width / 2
            self._prepared[id(scenario)] = Prepared(
                scenario,
                drive,
                world_of(scenario, drive, kinematics.kernel_of(drive)),
                [(x, y), (-x, y), (-x, -y), (x, -y)],
                scenario.lidar.noise > 0.0 or scenario.lidar.dropout > 0.0,
            )
        return self._prepared[id(scenario)]

    def _place_robots(self, lane: int, layout: Layout, prepared: Prepared) -> None:
        robots = self.state.robots[lane]
        robots["pose"] = robots["origin"] = layout.robot_pose
        robots["goal"] = layout.robot_goal
        robots["velocity"] = 0.0
        robots["active"] = True
        ways = layout.robot_goal - layout.robot_pose[:, :2]
        robots["distance"] = np.linalg.norm(ways, axis=1)
        self._note_travel(lane, prepared)

    def _place_people(
        self, lane: int, layout: Layout, seed: int, scenario: Scenario
    ) -> list[np.random.Generator]:
        """Begin the first legs; returns where later ones are drawn from."""
        s, settings = self.state, scenario.pedestrians
        people = s.people[lane, : settings.count]
        low, high = settings.speed
        drawing = [streams.pedestrian(seed, p) for p in range(settings.count)]
        draws = np.empty((settings.count, 1 + LEGS_AHEAD * DRAWS))
        for row, stream in zip(draws, drawing, strict=True):
            stream.random(out=row)
        people["speed"] = low + (high - low) * draws[:, 0]
        s.draws[lane, : settings.count] = draws[:, 1:].reshape(-1, LEGS_AHEAD, DRAWS)
        people["drawn"] = 0
        people["position"] = layout.pedestrian_position
        people["reactive"] = layout.pedestrian_reactive
        people["radius"] = settings.radius
        begin_legs(lane, s.worlds, s.people, s.obstacles, s.draws)
        ahead = people["goal"] - people["position"]
        people["heading"] = headings = [math.atan2(y, x) for x, y in ahead.tolist()]
        directions = np.array([(math.cos(heading), math.sin(heading)) for heading in headings])
        people["velocity"] = people["speed"][:, None] * directions.reshape(-1, 2)
        return drawing

    def _draw(self) -> None:
        """Give those who have used up their draws new ones."""
        drawn = self.state.people["drawn"]
        for lane, p in np.argwhere(drawn == LEGS_AHEAD).tolist():
            drawn[lane, p] = 0
            drawing = self.episode(lane).streams
            if p < len(drawing):  # others are rows that this lane has not
                self.state.draws[lane, p] = drawing[p].random((LEGS_AHEAD, DRAWS))

    def _choose_in_python(self, lane: int) -> None:
        episode = self.episode(lane)
        chosen = episode.model.velocities(self._crowd(lane), float(self.state.worlds["time"][lane]))
        scenario = episode.prepared.scenario
        people = self.state.people[lane, : scenario.pedestrians.count]
        people["chosen"] = walking.checked_velocities(scenario, chosen)

    def _crowd(self, lane: int) -> Crowd:
        """A lane as walking models see it: copies, which they may keep."""
        episode, robots = self.episode(lane), self.state.robots[lane]
        scenario = episode.prepared.scenario
        count = scenario.pedestrians.count
        people = self.state.people[lane, :count]
        return Crowd(
            position=people["position"].copy(),
            velocity=people["velocity"].copy(),
            heading=people["heading"].copy(),
            goal=people["goal"].copy(),
            preferred_speed=people["speed"].copy(),
            radius=scenario.pedestrians.radius,
            present=np.ones(count, dtype=np.bool_),
            sees_robot=self.state.sees[lane, :count].copy(),
            robot_position=robots["pose"][:, :2].copy(),
            robot_velocity=robots["world_velocity"].copy(),
            robot_radius=float(episode.prepared.world["robot_radius"]),
            responsibility=scenario.pedestrians.responsibility,
            obstacles=episode.layout.obstacles,
            walls=episode.layout.walls,
            period=scenario.control_period,
        )

    def _move_by_drive(self, lane: int, commands: NDArray[np.float64]) -> None:
        """Move a lane whose drive comes from elsewhere."""
        prepared, s = self.episode(lane).prepared, self.state
        scenario, drive = prepared.scenario, prepared.drive
        robots, people = s.robots[lane], s.people[lane]
        doing = drive.limit(commands, robots["velocity"].copy(), scenario.control_period)
        robots["velocity"] = np.where(robots["active"][:, None], doing, 0.0)
        driving = {
            r: robots["velocity"][r].tolist() for r in np.flatnonzero(robots["active"]).tolist()
        }
        chosen = people["chosen"][: scenario.pedestrians.count]
        walks = float(np.hypot(chosen[:, 0], chosen[:, 1]).max(initial=0.0))
        speeds = [body_speed(scenario, drive, velocity) for velocity in driving.values()]
        steps, bias = physics(scenario, max(walks, *speeds, 0.0))
        duration = scenario.control_period / steps
        bodies = self.episode(lane).bodies
        bodies.set_off(bias, chosen.tolist())
        for _ in range(steps):
            for r, velocity in driving.items():
                heading = float(robots["pose"][r, 2])
                x, y, robots["pose"][r, 2] = drive.advance(heading, velocity, duration)
                bodies.drive(r, x, y, drive.turn_rate(velocity))
            bodies.step(duration)
        s.worlds["time"][lane] += scenario.control_period
        for r in driving:
            robots["pose"][r, :2] = bodies.position(r)
        for p in range(len(chosen)):
            people["position"][p] = bodies.position(len(robots) + p)
            people["velocity"][p] = bodies.velocity(len(robots) + p)
        self._note_travel(lane, prepared)

    def _note_travel(self, lane: int, prepared: Prepared) -> None:
        """Where robots are going."""
        robots = self.state.robots[lane]
        for robot in robots:
            x, y, speed = prepared.drive.travel(float(robot["pose"][2]), robot["velocity"].tolist())
            robot["direction"], robot["speed"] = (x, y), speed
            robot["world_velocity"] = speed * x, speed * y
