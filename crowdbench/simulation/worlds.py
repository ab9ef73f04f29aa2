"""Worlds side by side: bodies and contacts, and one control step of everybody in them.

What is built in runs compiled, over all lanes at once. Drives and walking models from elsewhere,
noise, and what is drawn for an episode stay in Python, in the lanes that need them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from crowdbench.robot import lidar_angles
from crowdbench.scenario import Odometry, Scenario
from crowdbench.simulation import kinematics, legs, streams, walking
from crowdbench.simulation.chipmunk import FUNCTIONS, Bodies
from crowdbench.simulation.guidance import Guidance
from crowdbench.simulation.habits import (
    AFTER_CHOICE,
    AFTER_MOTION,
    BEFORE_CHOICE,
    BEFORE_LEGS,
    HabitLanes,
)
from crowdbench.simulation.kinematics import make_drive
from crowdbench.simulation.lane_episode import Episode, Prepared
from crowdbench.simulation.lane_people import crowd_of
from crowdbench.simulation.lanes import (
    DRAWS,
    LEGS_AHEAD,
    ODOMETRY,
    allocate,
    world_of,
)
from crowdbench.simulation.layout import Layout, place
from crowdbench.simulation.lidar import beam_table
from crowdbench.simulation.map_layout import places_of
from crowdbench.simulation.motion import move
from crowdbench.simulation.obstacle_map import MapGeometry
from crowdbench.simulation.odometry import DriftingOdometry
from crowdbench.simulation.pedestrians import look
from crowdbench.simulation.reward import judge
from crowdbench.simulation.routes import routes_of
from crowdbench.simulation.sensing import DrawnMaps, ScanNoise, observe, outline
from crowdbench.simulation.setting_out import set_out
from crowdbench.simulation.substeps import body_speed, physics
from crowdbench.simulation.walking import make_walking_model

Lanes = NDArray[np.int64]


class Worlds:
    """L worlds, with an episode each once it has begun.

    Attributes:
        state: of all lanes, as compiled functions know it.
        episodes: (L,) the present ones.
        drawn: the robots' obstacle maps, where they are asked for.
    """

    def __init__(
        self,
        lanes: int,
        scenarios: Sequence[Scenario],
        obstacle_map: MapGeometry | None = None,
    ) -> None:
        """Make room for any of the scenarios in every lane; robots and LiDAR have to be alike."""
        self.state = allocate(lanes, scenarios)
        self.drawn: DrawnMaps | None = None
        if obstacle_map is not None:
            self.drawn = DrawnMaps(lanes, scenarios[0], obstacle_map)
        self.episodes: list[Episode | None] = [None] * lanes
        self._beams = beam_table(lidar_angles(scenarios[0]))
        self._prepared: dict[int, Prepared] = {}
        self._kernels: list[Callable[..., None] | None] = [None] * lanes
        self._noise = ScanNoise(lanes, scenarios[0])
        on_map = any(scenario.arena.kind == "map" for scenario in scenarios)
        self._guidance = Guidance(lanes, scenarios) if on_map else None
        self._habits = HabitLanes(lanes)
        self._recorded: set[int] = set()
        self._drifting: set[int] = set()

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
        layout = place(scenario, seed, prepared.places, prepared.routes)
        state = self.state
        state.worlds[lane] = prepared.world
        state.obstacles[lane, : len(layout.obstacles)] = layout.obstacles
        state.walls[lane, : len(layout.walls)] = layout.walls
        self._place_robots(lane, layout, prepared)
        if self._guidance is not None:
            self._guidance.begin(lane, prepared.places, state.robots)
        drawing = set_out(state, lane, layout, seed, scenario.pedestrians, prepared.routes)
        bodies = Bodies(
            layout.robot_pose,
            prepared.corners,
            layout.pedestrian_position,
            layout.traits.radius,
            layout.obstacles,
            layout.walls,
            state.contacts[lane],
            apart=layout.tracks is not None,
        )
        state.worlds["space"][lane] = bodies.space
        if layout.tracks is not None:  # the episode keeps them
            state.worlds["tracks"][lane] = layout.tracks.position.ctypes.data
            state.worlds["moments"][lane] = len(layout.tracks.position)
            people = state.people[lane, : scenario.pedestrians.count]
            for p in np.flatnonzero(~people["present"]).tolist():
                bodies.keep_still(p)
        state.robots["body"][lane] = bodies.addresses[: state.robots.shape[1]]
        state.people["body"][lane, : scenario.pedestrians.count] = bodies.addresses[
            state.robots.shape[1] :
        ]
        drifting = [
            DriftingOdometry(scenario.robots.odometry, pose, streams.odometry(seed, r))
            for r, pose in enumerate(layout.robot_pose if prepared.drifts else ())
        ]
        self._noise.begin(lane, scenario, seed)
        if self.drawn is not None:
            self.drawn.reset(lane)
        before = self.episodes[lane]
        self._kernels[lane] = walking.kernel_of(model)
        self._habits.note(lane, scenario.pedestrians)
        (self._recorded.add if layout.tracks else self._recorded.discard)(lane)
        (self._drifting.add if drifting else self._drifting.discard)(lane)
        self.episodes[lane] = Episode(prepared, seed, layout, bodies, model, drawing, drifting)
        if before is not None:
            before.bodies.free()
        if self._kernels[lane] is None:
            look(state.worlds[lane], state.robots[lane], state.people[lane], state.sees[lane])
            model.reset(crowd_of(state, lane, self.episode(lane)), streams.walking(seed))

    def ways(self, lane: int) -> NDArray[np.float64]:
        """(P, POINTS, 2) next points of people's ways, the last one repeated; else goals [m]."""
        prepared = self.episode(lane).prepared
        return legs.ways(lane, self.state, prepared.scenario.pedestrians.count, prepared.routes)

    def choose(self, lanes: Lanes) -> None:
        """Let all pedestrians decide from the same snapshot how to walk.

        Raises:
            ScenarioError: a walking model returns no velocities.
        """
        s = self.state
        self._habits.act(BEFORE_LEGS, lanes, s)
        on_legs = lanes
        if self._recorded:
            on_legs = lanes[[lane not in self._recorded for lane in lanes.tolist()]]
        routes = [self.episode(lane).prepared.routes for lane in on_legs.tolist()]
        if legs.choose_legs(on_legs, s, routes):
            self._draw()
        self._habits.act(BEFORE_CHOICE, lanes, s)
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
            commands: (M, R, 2) actions within the drive's bounds, which act after the robots'
                latency; those of robots that have left the scene are ignored.

        Raises:
            ScenarioError: somebody is far too fast.
        """
        s = self.state
        self._habits.act(AFTER_CHOICE, lanes, s)
        if s.under_way.shape[2]:
            commands = self._delay(lanes, commands)
        stuck = move(lanes, commands, s.worlds, s.robots, s.people, FUNCTIONS)
        if stuck >= 0:
            scenario = self.episode(stuck).prepared.scenario
            physics(scenario, float(s.worlds["bias"][stuck]))
        for i in np.flatnonzero(s.worlds["drive"][lanes] == kinematics.OTHER).tolist():
            self._move_by_drive(int(lanes[i]), commands[i])
        self._habits.act(AFTER_MOTION, lanes, s)

    def observe(self, lanes: Lanes) -> None:
        """Write what robots see, and how near the nearest thing is, into ``state``."""
        s = self.state
        if s.robots.shape[1] > 1:
            outline(lanes, s.worlds, s.robots)
        observe(lanes, s.worlds, s.robots, s.people, s.obstacles, s.walls, self._beams, s.seen)
        if self._guidance is not None:
            self._guidance.observe(lanes, s.robots, s.seen)
        self._noise.add(lanes, s.robots, s.seen)
        for lane in self._drifting.intersection(lanes.tolist()):
            robots = s.robots[lane]
            for r in np.flatnonzero(robots["active"]).tolist():
                odometry = self.episode(lane).odometry[r]
                odometry.update(robots["pose"][r])
                s.seen[lane, r, ODOMETRY] = odometry.wrapped()
        if self.drawn is not None:
            period = s.worlds["period"]
            self.drawn.update(lanes, s.seen, s.robots["active"], s.under_way, period)

    def judge(self, lanes: Lanes) -> None:
        """Write reward terms and outcomes of a step that has been observed into ``state``."""
        s = self.state
        judge(lanes, s.worlds, s.robots, s.people, s.contacts)
        if self._guidance is not None:
            self._guidance.judge(lanes, s.worlds, s.robots)

    def remove(self, lane: int, robot: int) -> None:
        """Take a robot out of the scene; one that has left stays where it is."""
        robots = self.state.robots[lane]
        if robots["active"][robot]:
            robots["active"][robot] = robots["reserves"][robot] = False
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
                scenario.robots.odometry != Odometry(),
                places_of(scenario),
                routes_of(scenario),
            )
        return self._prepared[id(scenario)]

    def _place_robots(self, lane: int, layout: Layout, prepared: Prepared) -> None:
        robots = self.state.robots[lane]
        robots["pose"] = robots["origin"] = layout.robot_pose
        robots["goal"] = layout.robot_goal
        robots["velocity"] = 0.0
        self.state.under_way[lane] = 0.0
        robots["active"] = robots["reserves"] = True
        ways = layout.robot_goal - layout.robot_pose[:, :2]
        robots["distance"] = np.linalg.norm(ways, axis=1)
        self._note_travel(lane, prepared)

    def _delay(self, lanes: Lanes, commands: NDArray[np.float64]) -> NDArray[np.float64]:
        """The commands (M, R, 2) that act now; the given ones join those under way."""
        queue = self.state.under_way[lanes]
        acting = queue[:, :, 0].copy()
        queue[:, :, :-1] = queue[:, :, 1:]
        queue[:, :, -1] = commands
        self.state.under_way[lanes] = queue
        return acting

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
        crowd = crowd_of(self.state, lane, episode)
        chosen = episode.model.velocities(crowd, float(self.state.worlds["time"][lane]))
        scenario = episode.prepared.scenario
        people = self.state.people[lane, : scenario.pedestrians.count]
        people["chosen"] = walking.checked_velocities(scenario, chosen)

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
