"""One control period of motion: robots as their drives say, pedestrians as they chose."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.simulation.chipmunk import (
    GET_POSITION,
    GET_VELOCITY,
    SET_BIAS,
    SET_TURN_RATE,
    SET_VELOCITY,
    STEP,
    set_number,
    set_vector,
    vector_of,
)
from crowdbench.simulation.kinematics import DIFFERENTIAL, OTHER, advance, travel
from crowdbench.simulation.substeps import steps_and_bias


@compiled()
def move(
    lanes: NDArray[np.int64],
    commands: NDArray[np.float64],
    worlds: NDArray[np.void],
    robots: NDArray[np.void],
    people: NDArray[np.void],
    calls: NDArray[np.uint64],
) -> int:
    """Move everybody in the lanes whose drive is compiled; the others are left alone.

    Args:
        lanes: (M,) which.
        commands: (M, R, 2) actions within the drive's bounds.
        worlds, robots, people: of all lanes, see ``State``.
        calls: Chipmunk's functions.

    Returns:
        -1, or the first lane in which somebody is too fast, whose ``bias`` is then that speed;
        nobody has moved.
    """
    for i in range(len(lanes)):
        world = worlds[lanes[i]]
        if world.drive != OTHER:
            speed = _set_off(world, commands[i], robots[lanes[i]], people[lanes[i]])
            world.steps, world.bias = steps_and_bias(
                speed, world.period, world.half_extent, world.least_steps
            )
            if world.steps == 0:
                world.bias = speed
                return lanes[i]
    for i in range(len(lanes)):
        world = worlds[lanes[i]]
        if world.drive != OTHER:
            _advance(world, robots[lanes[i]], people[lanes[i]], calls)
    return -1


@compiled()
def limit_changes(
    lanes: NDArray[np.int64], worlds: NDArray[np.void], people: NDArray[np.void]
) -> None:
    """Bring velocities that were chosen as near as people's accelerations let them come.

    Args:
        lanes: (M,) which, of scenarios with such a limit.
        worlds, people: of all lanes, see ``State``.
    """
    for i in range(len(lanes)):
        world = worlds[lanes[i]]
        for p in range(world.people):
            person = people[lanes[i], p]
            x = person.chosen[0] - person.velocity[0]
            y = person.chosen[1] - person.velocity[1]
            change, most = math.hypot(x, y), person.acceleration * world.period
            if change > most:
                person.chosen[0] = person.velocity[0] + most / change * x
                person.chosen[1] = person.velocity[1] + most / change * y


@compiled(inline="always")
def _set_off(world, commands, robots, people):  # type: ignore[no-untyped-def]
    """Take the commands as far as the drive follows them; the fastest body's speed [m/s]."""
    fastest = 0.0
    for p in range(world.people):
        fastest = max(fastest, math.hypot(people[p].chosen[0], people[p].chosen[1]))
    for r in range(len(robots)):
        robot = robots[r]
        v, w = robot.velocity[0], robot.velocity[1]
        v = min(max(commands[r, 0], v - world.reach[0]), v + world.reach[0])
        w = min(max(commands[r, 1], w - world.reach[1]), w + world.reach[1])
        if not robot.active:
            v, w = 0.0, 0.0
        robot.velocity[0], robot.velocity[1] = v, w
        _, _, speed = travel(world.drive, 0.0, v, w)
        robot.turn_rate = w if world.drive == DIFFERENTIAL else 0.0
        fastest = max(fastest, abs(speed) + world.corner * abs(robot.turn_rate))
    return fastest


@compiled(inline="always")
def _advance(world, robots, people, calls):  # type: ignore[no-untyped-def]
    """Take all physics steps of a lane's control period, and read where everybody is."""
    set_number(calls[SET_BIAS], world.space, world.bias)
    for p in range(world.people):
        person = people[p]
        if person.present:
            set_vector(calls[SET_VELOCITY], person.body, person.chosen[0], person.chosen[1])
    duration = world.period / world.steps
    for _ in range(world.steps):
        for r in range(len(robots)):
            robot = robots[r]
            if robot.active:
                x, y, robot.pose[2] = advance(
                    world.drive, robot.pose[2], robot.velocity[0], robot.velocity[1], duration
                )
                set_vector(calls[SET_VELOCITY], robot.body, x, y)
                set_number(calls[SET_TURN_RATE], robot.body, robot.turn_rate)
        set_number(calls[STEP], world.space, duration)
    world.time += world.period
    for r in range(len(robots)):
        robot = robots[r]
        if robot.active:
            robot.pose[0], robot.pose[1] = vector_of(calls[GET_POSITION], robot.body)
        x, y, speed = travel(world.drive, robot.pose[2], robot.velocity[0], robot.velocity[1])
        robot.direction[0], robot.direction[1], robot.speed = x, y, speed
        robot.world_velocity[0], robot.world_velocity[1] = speed * x, speed * y
    for p in range(world.people):
        person = people[p]
        if person.present:
            person.position[0], person.position[1] = vector_of(calls[GET_POSITION], person.body)
            person.velocity[0], person.velocity[1] = vector_of(calls[GET_VELOCITY], person.body)
