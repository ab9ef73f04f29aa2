"""The world: bodies and contacts, and one control step of everybody in it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pymunk
from numpy.typing import NDArray
from pymunk import batch

from crowdbench.scenario import Scenario
from crowdbench.simulation.contact import Contact, ContactKind
from crowdbench.simulation.kinematics import make_drive
from crowdbench.simulation.layout import Layout, place
from crowdbench.simulation.pedestrians import Pedestrians
from crowdbench.simulation.substeps import body_speed, physics

_ROBOT = 1
_WALL_THICKNESS = 0.0
_STATE = batch.BodyFields.POSITION | batch.BodyFields.VELOCITY


class World:
    """Robots, pedestrians, obstacles and walls of one episode.

    Built anew for every episode: a reused physics space would remember old contacts.

    Attributes:
        time: since the episode began [s].
        pose: (R, 3) robots' x, y [m], heading [rad].
        velocity: (R, 2) what the robots' drive is doing, e.g. v [m/s], w [rad/s].
        direction: (R, 2) unit vectors along which the robots travel, in the world.
        speed: (R,) along these, negative backwards [m/s].
        world_velocity: (R, 2) direction times speed [m/s].
        active: (R,) robots still in the scene.
        goals: (R, 2) [m].
        contacts: what each robot has touched, by robot.
        pedestrians: everybody who walks.
        drive: how the robots move.
        layout: where everything began.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        """Place everything.

        Raises:
            ScenarioError: the scenario has no room for what it asks for, or its drive or walking
                model cannot be used.
        """
        self._scenario = scenario
        self.layout: Layout = place(scenario, seed)
        layout = self.layout
        self.time = 0.0
        self.pose = layout.robot_pose.copy()
        self.drive = make_drive(scenario)
        self.velocity = np.zeros((len(self.pose), 2))
        self.direction, self.speed = np.zeros((len(self.pose), 2)), np.zeros(len(self.pose))
        self._travel()
        self.active = np.ones(len(self.pose), dtype=np.bool_)
        self.goals = layout.robot_goal
        self.contacts: dict[int, Contact] = {}
        self.pedestrians = Pedestrians(
            scenario,
            seed,
            layout.pedestrian_position,
            layout.pedestrian_reactive,
            layout.obstacles,
            layout.walls,
        )
        self.pedestrians.begin(self)
        self._build()

    def step(
        self,
        commands: NDArray[np.float64],
        walking: dict[int, NDArray[np.float64]] | None = None,
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
        people, period = self.pedestrians, self._scenario.control_period
        people.advance_legs(self.time)
        self._walking = people.walk(self, self.time)
        for p, wanted in (walking or {}).items():
            self._walking[p] = wanted
        self._drive(commands)
        self._set_velocities()
        substeps, self._space.collision_bias = physics(self._scenario, self._fastest())
        for _ in range(substeps):
            self._move_robots(period / substeps)
            self._space.step(period / substeps)
        self.time += period
        self._read()

    def remove(self, robot: int) -> None:
        """Take a robot out of the scene."""
        self.active[robot] = False
        body = self._bodies[robot]
        self._space.remove(*body.shapes, body)
        self._map_rows()

    def _build(self) -> None:
        scenario, layout = self._scenario, self.layout
        self._space = space = pymunk.Space(threaded=False)
        space.collision_slop = 0.0
        self._bodies: list[pymunk.Body] = []
        self._touchable: dict[pymunk.Shape, tuple[ContactKind, int]] = {}
        half_length, half_width = scenario.robots.length / 2, scenario.robots.width / 2
        corners = [(half_length, half_width), (-half_length, half_width)]
        corners += [(-half_length, -half_width), (half_length, -half_width)]
        for r, (x, y, heading) in enumerate(self.pose.tolist()):
            body = self._add_body(50.0, x, y)
            body.angle = heading
            self._add_shape(pymunk.Poly(body, corners), "robot", r)
        for p, (x, y) in enumerate(self.pedestrians.position.tolist()):
            body = self._add_body(70.0, x, y)
            self._add_shape(pymunk.Circle(body, scenario.pedestrians.radius), "pedestrian", p)
        for k, (x, y, radius) in enumerate(layout.obstacles.tolist()):
            self._add_shape(pymunk.Circle(space.static_body, radius, (x, y)), "obstacle", k)
        for s, (x1, y1, x2, y2) in enumerate(layout.walls.tolist()):
            wall = pymunk.Segment(space.static_body, (x1, y1), (x2, y2), _WALL_THICKNESS)
            self._add_shape(wall, "wall", s)
        space.on_collision(_ROBOT, None, begin=self._touch)
        self._walking = np.zeros((len(self.pedestrians.position), 2))
        self._output = batch.Buffer()
        self._map_rows()

    def _add_body(self, mass: float, x: float, y: float) -> pymunk.Body:
        body = pymunk.Body(mass, float("inf"))
        body.position = x, y
        self._space.add(body)
        self._bodies.append(body)
        return body

    def _add_shape(self, shape: pymunk.Shape, kind: ContactKind, index: int) -> None:
        shape.collision_type = _ROBOT if kind == "robot" else 0
        self._space.add(shape)
        self._touchable[shape] = (kind, index)

    def _map_rows(self) -> None:
        """Find the row of each body in a batch, and size the input buffer."""
        buffer = batch.Buffer()
        batch.get_space_bodies(self._space, batch.BodyFields.BODY_ID, buffer)
        ids = np.frombuffer(buffer.int_buf(), dtype=np.uintp).tolist()
        rows = {identity: row for row, identity in enumerate(ids)}
        robots, people = self._bodies[: len(self.pose)], self._bodies[len(self.pose) :]
        self._rows = np.array([rows[body.id] for body in people], dtype=np.intp)
        self._robot_rows = [(r, rows[b.id]) for r, b in enumerate(robots) if self.active[r]]
        self._wanted = np.zeros((len(ids), 2))
        self._input = batch.Buffer()
        self._input.set_float_buf(self._wanted)

    def _set_velocities(self) -> None:
        """Give pedestrians what they chose; robots get theirs substep by substep."""
        self._wanted[self._rows] = self._walking
        batch.set_space_bodies(self._space, batch.BodyFields.VELOCITY, self._input)

    def _drive(self, commands: NDArray[np.float64]) -> None:
        """Take the commands, as far as the drive follows them."""
        doing = self.drive.limit(commands, self.velocity, self._scenario.control_period)
        self.velocity = np.where(self.active[:, None], doing, 0.0)
        velocities = self.velocity.tolist()
        self._driving = [(r, velocities[r]) for r, _ in self._robot_rows]
        for r, velocity in self._driving:
            self._bodies[r].angular_velocity = self.drive.turn_rate(velocity)

    def _fastest(self) -> float:
        """Speed of the fastest body in this control period [m/s]."""
        walking = np.hypot(self._walking[:, 0], self._walking[:, 1]).max(initial=0.0)
        driving = (body_speed(self._scenario, self.drive, doing) for _, doing in self._driving)
        return max(float(walking), *driving, 0.0)

    def _move_robots(self, duration: float) -> None:
        """Set body velocities so that one physics step goes where the drive says."""
        for r, velocity in self._driving:
            x, y, heading = self.drive.advance(float(self.pose[r, 2]), velocity, duration)
            self._bodies[r].velocity = x, y
            self.pose[r, 2] = heading

    def _travel(self) -> None:
        """Derive where the robots are going; nothing else derives it again."""
        self.world_velocity = np.empty_like(self.velocity)
        for r, velocity in enumerate(self.velocity.tolist()):
            x, y, speed = self.drive.travel(float(self.pose[r, 2]), velocity)
            self.direction[r, 0], self.direction[r, 1], self.speed[r] = x, y, speed
            self.world_velocity[r, 0], self.world_velocity[r, 1] = speed * x, speed * y

    def _read(self) -> None:
        self._output.clear()
        batch.get_space_bodies(self._space, _STATE, self._output)
        rows = np.frombuffer(self._output.float_buf()).reshape(-1, 4)
        mine = rows[self._rows]
        self.pedestrians.position = mine[:, :2].copy()
        self.pedestrians.velocity = mine[:, 2:].copy()
        for r, row in self._robot_rows:
            self.pose[r, :2] = rows[row, :2]
        self._travel()

    def _touch(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:
        """Record the first thing each robot touches."""
        first, second = arbiter.shapes
        # Chipmunk's normal points from the first shape to the second.
        normal = arbiter.normal
        for mine, other, towards in ((first, second, normal), (second, first, -normal)):
            kind, index = self._touchable[mine]
            if kind != "robot" or index in self.contacts:
                continue
            assert mine.body is not None
            assert other.body is not None
            self.contacts[index] = Contact(
                *self._touchable[other],
                robot_speed=float(mine.body.velocity.dot(towards)),
                other_speed=float(-other.body.velocity.dot(towards)),
            )
