"""Walking models: how pedestrians avoid others, found by the name that ``pedestrians.model`` gives.

A model chooses the velocities of the whole crowd at once, from one snapshot. Where everybody wants
to go is not its matter (``crowdbench.simulation.pedestrians``).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.extensions import WALKING_MODELS
from crowdbench.registry import UnknownNameError
from crowdbench.scenario import Scenario, ScenarioError
from crowdbench.simulation.orca import orca_velocities
from crowdbench.simulation.pedestrians import read_robots
from crowdbench.simulation.recorded import walk_as_recorded
from crowdbench.simulation.social_force import social_force_velocities


@dataclass(frozen=True)
class Crowd:
    """One moment of P pedestrians among R robots, K obstacles and S walls, in world coordinates.

    Arrays are float64 (masks bool), C-contiguous, and not to be written to.

    Attributes:
        position: (P, 2) centres [m].
        velocity: (P, 2) as they walk now [m/s].
        heading: (P,) direction of the last step walked [rad].
        goal: (P, 2) where each is going [m]; among walls the next point of the way there.
        preferred_speed: (P,) never to be exceeded [m/s].
        preferred_velocity: (P, 2) how each would walk if nobody was there, along its way [m/s].
        radius: (P,) of the discs that they are [m].
        present: (P,) bool, who is in the scene.
        sees_robot: (P, R) bool, which pedestrian sees which robot now: a reactive one, with the
            robot in its field of view.
        robot_position: (R, 2) [m].
        robot_velocity: (R, 2) [m/s].
        robot_radius: of the circle around a robot's footprint [m].
        responsibility: share of an evasion that a pedestrian takes on when meeting a robot.
        obstacles: (K, 3) x, y, radius of static discs [m].
        walls: (S, 4) segments x1, y1, x2, y2 [m].
        period: time until the next decision [s].
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    heading: NDArray[np.float64]
    goal: NDArray[np.float64]
    preferred_speed: NDArray[np.float64]
    preferred_velocity: NDArray[np.float64]
    radius: NDArray[np.float64]
    present: NDArray[np.bool_]
    sees_robot: NDArray[np.bool_]
    robot_position: NDArray[np.float64]
    robot_velocity: NDArray[np.float64]
    robot_radius: float
    responsibility: float
    obstacles: NDArray[np.float64]
    walls: NDArray[np.float64]
    period: float

    def only(self, chosen: NDArray[np.bool_]) -> Crowd:
        """The same moment without the other pedestrians; ``chosen`` is a mask (P,)."""
        rows = "position velocity heading goal preferred_speed preferred_velocity radius present"
        names = [*rows.split(), "sees_robot"]
        kept = {name: getattr(self, name)[chosen] for name in names}
        return replace(self, **kept)


class WalkingModel(ABC):
    """How a crowd walks. Every episode has an object of its own."""

    def reset(self, crowd: Crowd, rng: np.random.Generator) -> None:  # noqa: B027 - may stay so
        """Begin the episode; by default there is nothing to do.

        Args:
            crowd: the starting state.
            rng: where all randomness of the model comes from.
        """

    @abstractmethod
    def velocities(self, crowd: Crowd, time: float) -> NDArray[np.float64]:
        """Choose how everybody walks until the next decision.

        Args:
            crowd: the present state.
            time: since the episode began [s].

        Returns:
            (P, 2) velocities [m/s]; rows of those who are not present are ignored.
        """


class Straight(WalkingModel):
    """Everybody goes straight to the goal and avoids nobody."""

    def velocities(self, crowd: Crowd, time: float) -> NDArray[np.float64]:
        """Return the preferred velocities."""
        return crowd.preferred_velocity


class _Solved(WalkingModel):
    """A model whose velocities one compiled function computes, for those who are present."""

    solve: Callable[..., None]

    def velocities(self, crowd: Crowd, time: float) -> NDArray[np.float64]:
        """Return what the function writes."""
        if np.count_nonzero(crowd.present) < len(crowd.present):
            velocities = np.zeros_like(crowd.position)
            velocities[crowd.present] = self.velocities(crowd.only(crowd.present), time)
            return velocities
        out = np.empty_like(crowd.position)
        type(self).solve(
            crowd.position,
            crowd.velocity,
            crowd.preferred_velocity,
            crowd.preferred_speed,
            crowd.radius,
            crowd.sees_robot,
            crowd.robot_position,
            crowd.robot_velocity,
            crowd.robot_radius,
            crowd.responsibility,
            crowd.obstacles,
            crowd.walls,
            crowd.period,
            out,
        )
        return out


class Orca(_Solved):
    """Optimal reciprocal collision avoidance (``crowdbench.simulation.orca``)."""

    solve = staticmethod(orca_velocities)


class SocialForce(_Solved):
    """Social forces (``crowdbench.simulation.social_force``)."""

    solve = staticmethod(social_force_velocities)


class Recorded(WalkingModel):
    """As recorded (``crowdbench.simulation.recorded``): only lanes know the recording."""

    def velocities(self, crowd: Crowd, time: float) -> NDArray[np.float64]:
        """Refuse to say: a crowd has no recording.

        Raises:
            ScenarioError: always; what ``walk_as_recorded`` does no crowd can.
        """
        raise ScenarioError(
            "pedestrians.model 'recorded': no crowd can walk as recorded, only the simulation has "
            "the recording"
        )


def make_walking_model(scenario: Scenario) -> WalkingModel:
    """A new object of the walking model that a scenario names.

    Raises:
        ScenarioError: it cannot be loaded.
    """
    name = scenario.pedestrians.model
    where = f"scenario {scenario.name!r}: pedestrians.model"
    try:
        return WALKING_MODELS[name]()
    except UnknownNameError as error:
        raise ScenarioError(f"{where}: {error}") from error


def kernel_of(model: WalkingModel) -> Callable[..., None] | None:
    """What computes this model for many lanes at once; None for one from elsewhere."""
    return _KERNELS.get(type(model))


def checked_velocities(scenario: Scenario, velocities: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a walking model has returned, as an array of its own.

    Raises:
        ScenarioError: not finite numbers (P, 2).
    """
    array = np.array(velocities, dtype=np.float64)
    expected = (scenario.pedestrians.count, 2)
    # The sum of squares is finite when all are, and takes one call.
    if array.shape != expected or not math.isfinite(np.vdot(array, array)):
        got = f"shape {array.shape}" if array.shape != expected else "numbers that are not finite"
        raise ScenarioError(
            f"scenario {scenario.name!r}: pedestrians.model {scenario.pedestrians.model!r}: "
            f"expected finite velocities of shape {expected}, got {got}"
        )
    return array


@compiled()
def _walk_straight(lanes, worlds, robots, people, obstacles, walls, sees):  # type: ignore[no-untyped-def]
    for i in range(len(lanes)):
        for p in range(worlds[lanes[i]].people):
            for axis in range(2):
                people[lanes[i], p].chosen[axis] = people[lanes[i], p].preferred[axis]


# The next two differ in one call: numba's cache does not find a function that closes over another.
@compiled()
def _walk_by_orca(lanes, worlds, robots, people, obstacles, walls, sees):  # type: ignore[no-untyped-def]
    most, number = people.shape[1], robots.shape[1]
    position, velocity, preferred = np.empty((most, 2)), np.empty((most, 2)), np.empty((most, 2))
    speed, radius, chosen = np.empty(most), np.empty(most), np.empty((most, 2))
    robot_position, robot_velocity = np.empty((number, 2)), np.empty((number, 2))
    for i in range(len(lanes)):
        lane = lanes[i]
        world = worlds[lane]
        count = world.people
        _read_people(people[lane], count, position, velocity, preferred, speed, radius)
        read_robots(robots[lane], robot_position, robot_velocity)
        orca_velocities(
            position[:count],
            velocity[:count],
            preferred[:count],
            speed[:count],
            radius[:count],
            sees[lane],
            robot_position,
            robot_velocity,
            world.robot_radius,
            world.responsibility,
            obstacles[lane, : world.obstacles],
            walls[lane, : world.walls],
            world.period,
            chosen[:count],
        )
        _write_chosen(people[lane], count, chosen)


@compiled()
def _walk_by_social_force(lanes, worlds, robots, people, obstacles, walls, sees):  # type: ignore[no-untyped-def]
    most, number = people.shape[1], robots.shape[1]
    position, velocity, preferred = np.empty((most, 2)), np.empty((most, 2)), np.empty((most, 2))
    speed, radius, chosen = np.empty(most), np.empty(most), np.empty((most, 2))
    robot_position, robot_velocity = np.empty((number, 2)), np.empty((number, 2))
    for i in range(len(lanes)):
        lane = lanes[i]
        world = worlds[lane]
        count = world.people
        _read_people(people[lane], count, position, velocity, preferred, speed, radius)
        read_robots(robots[lane], robot_position, robot_velocity)
        social_force_velocities(
            position[:count],
            velocity[:count],
            preferred[:count],
            speed[:count],
            radius[:count],
            sees[lane],
            robot_position,
            robot_velocity,
            world.robot_radius,
            world.responsibility,
            obstacles[lane, : world.obstacles],
            walls[lane, : world.walls],
            world.period,
            chosen[:count],
        )
        _write_chosen(people[lane], count, chosen)


@compiled(inline="always")
def _read_people(people, count, position, velocity, preferred, speed, radius):  # type: ignore[no-untyped-def]
    for p in range(count):
        person = people[p]
        speed[p], radius[p] = person.speed, person.radius
        position[p, 0], position[p, 1] = person.position[0], person.position[1]
        velocity[p, 0], velocity[p, 1] = person.velocity[0], person.velocity[1]
        preferred[p, 0], preferred[p, 1] = person.preferred[0], person.preferred[1]


@compiled(inline="always")
def _write_chosen(people, count, chosen):  # type: ignore[no-untyped-def]
    for p in range(count):
        people[p].chosen[0], people[p].chosen[1] = chosen[p, 0], chosen[p, 1]


_KERNELS: dict[type[WalkingModel], Callable[..., None]] = {
    Straight: _walk_straight,
    Orca: _walk_by_orca,
    SocialForce: _walk_by_social_force,
    Recorded: walk_as_recorded,
}
