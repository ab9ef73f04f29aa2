"""The border of the world: observations, the state, actions as they come in, results, spaces."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from crowdbench.messages import short
from crowdbench.scenario import Scenario
from crowdbench.scenario.recorded import AHEAD
from crowdbench.scenario.streams import MOST_STREAMS, MOST_VIA
from crowdbench.simulation.contact import INTENTS
from crowdbench.simulation.kinematics import Drive
from crowdbench.simulation.lanes import OUTCOMES, POINTS, RUNNING, TERMS, TIMEOUT
from crowdbench.simulation.obstacle_map import MapGeometry
from crowdbench.simulation.routes import routes_of
from crowdbench.simulation.sensing import as_observation
from crowdbench.simulation.walls import walls_of
from crowdbench.simulation.world import Lane, World


def agent_spaces(
    scenario: Scenario,
    drive: Drive,
    robots: list[str],
    walkers: list[str],
    top_speed: float,
    obstacle_map: MapGeometry | None = None,
) -> tuple[dict[str, spaces.Space[Any]], dict[str, spaces.Space[Any]]]:
    """Action and observation spaces by agent; agents of a kind share theirs."""
    body = scenario.robots
    low, high = drive.low.astype(np.float32), drive.high.astype(np.float32)
    act = spaces.Box(low, high, dtype=np.float32)
    walk = spaces.Box(-top_speed, top_speed, (2,), dtype=np.float32)
    rest_low, rest_high = np.minimum(low, 0), np.maximum(high, 0)
    parts: dict[str, spaces.Space[Any]] = {
        "lidar": spaces.Box(0.0, scenario.lidar.range, (scenario.lidar.beams,), np.float32),
        "velocity": spaces.Box(rest_low, rest_high, dtype=np.float32),
        "goal": _unbounded(2),
        "pose": _unbounded(3),
    }
    if obstacle_map is not None:
        parts["map"] = spaces.Box(0, 255, (obstacle_map.cells, obstacle_map.cells), np.uint8)
    sense = spaces.Dict(parts)
    others = max(0, scenario.pedestrians.count - 1)
    look = spaces.Dict(
        {
            "velocity": _unbounded(2),
            "goal": _unbounded(2),
            "robots": _unbounded(body.count, 4),
            "pedestrians": _unbounded(others, 4),
        }
    )
    actions: dict[str, spaces.Space[Any]] = dict.fromkeys(robots, act)
    seen: dict[str, spaces.Space[Any]] = dict.fromkeys(robots, sense)
    return actions | dict.fromkeys(walkers, walk), seen | dict.fromkeys(walkers, look)


def state_space(scenario: Scenario) -> spaces.Dict:
    """Space of ``CrowdEnv.state()``: R robots, P pedestrians, K obstacles, S walls.

    Positions of pedestrians who are not there are NaN.
    """
    r, p, k = scenario.robots.count, scenario.pedestrians.count, scenario.obstacles.count
    walls, routes = len(walls_of(scenario)), routes_of(scenario)

    def real(*shape: int) -> spaces.Box:
        return spaces.Box(-np.inf, np.inf, shape, np.float64)

    recorded: dict[str, spaces.Space[Any]] = {}
    if scenario.pedestrians.recording.file:
        steps = round(AHEAD / scenario.control_period)
        recorded = {
            "recorded_ahead": real(steps, p, 2),
            "recorded_held": spaces.Box(0, 1, (p,), np.bool_),
        }
    return spaces.Dict(
        {
            "time": real(),
            "robot_pose": real(r, 3),
            "robot_velocity": real(r, 2),
            "robot_under_way": real(r, scenario.robots.latency, 2),
            "robot_speed": real(r),
            "robot_world_velocity": real(r, 2),
            "robot_goal": real(r, 2),
            "robot_active": spaces.Box(0, 1, (r,), np.bool_),
            "pedestrian_position": real(p, 2),
            "pedestrian_velocity": real(p, 2),
            "pedestrian_heading": real(p),
            "pedestrian_goal": real(p, 2),
            "pedestrian_start": real(p, 2),
            "pedestrian_speed": real(p),
            "pedestrian_acceleration": real(p),
            "pedestrian_radius": real(p),
            "pedestrian_intent": spaces.Box(0, len(INTENTS) - 1, (p,), np.int64),
            "pedestrian_switch_time": real(p),
            "pedestrian_next_goal": real(p, 2),
            "pedestrian_way": real(p, POINTS, 2),
            "pedestrian_stream": spaces.Box(-1, MOST_STREAMS - 1, (p,), np.int64),
            "pedestrian_stage": spaces.Box(-1, MOST_VIA, (p,), np.int64),
            "pedestrian_reactive": spaces.Box(0, 1, (p,), np.bool_),
            "pedestrian_attentive": spaces.Box(0, 1, (p,), np.bool_),
            "pedestrian_attention_time": real(p),
            "pedestrian_group": spaces.Box(-1, p, (p,), np.int64),
            "pedestrian_queue": spaces.Box(-1, p, (p,), np.int64),
            "pedestrian_place": spaces.Box(-1, p, (p,), np.int64),
            "pedestrian_served_time": real(p),
            "pedestrian_stop_time": real(p),
            "pedestrian_stop_end": real(p),
            "pedestrian_walks_on": spaces.Box(0, 1, (p,), np.bool_),
            "bounds": real(4),
            "goal_area": real(2),
            "least_leg": real(),
            "switch_probability": real(),
            "stop_share": real(),
            "stop_duration": real(2),
            "stream_places": real(*((0, 0, 0, 3) if routes is None else routes.places.shape)),
            "field_of_view": real(),
            "responsibility": real(),
            "way_clearance": real(),
            "obstacles": real(k, 3),
            "walls": real(walls, 4),
            **recorded,
        }
    )


def state(world: Lane) -> dict[str, NDArray[Any]]:
    """Copies of everything in the world, keyed as in ``state_space``."""
    people = world.pedestrians
    there = people.present[:, None]
    return {
        "time": np.array(world.time),
        "robot_pose": world.pose.copy(),
        "robot_velocity": world.velocity.copy(),
        "robot_under_way": world.under_way.copy(),
        "robot_speed": world.speed.copy(),
        "robot_world_velocity": world.world_velocity.copy(),
        "robot_goal": world.goals.copy(),
        "robot_active": world.active.copy(),
        "pedestrian_position": np.where(there, people.position, np.nan),
        "pedestrian_velocity": people.velocity.copy(),
        "pedestrian_heading": people.heading.copy(),
        "pedestrian_goal": people.goal.copy(),
        "pedestrian_start": people.start.copy(),
        "pedestrian_speed": people.speed.copy(),
        "pedestrian_acceleration": people.acceleration.copy(),
        "pedestrian_radius": people.radius.copy(),
        "pedestrian_intent": people.intent.copy(),
        "pedestrian_switch_time": people.switch_time.copy(),
        "pedestrian_next_goal": people.next_goal.copy(),
        "pedestrian_way": world.ways,
        "pedestrian_stream": world.stream,
        "pedestrian_stage": world.stage,
        "pedestrian_reactive": people.reactive.copy(),
        "pedestrian_attentive": people.attentive.copy(),
        "pedestrian_attention_time": people.attention_time.copy(),
        "pedestrian_group": people.group.copy(),
        "pedestrian_queue": people.queue.copy(),
        "pedestrian_place": people.place.copy(),
        "pedestrian_served_time": people.served_time.copy(),
        "pedestrian_stop_time": people.stop_time.copy(),
        "pedestrian_stop_end": people.stop_end.copy(),
        "pedestrian_walks_on": people.walks_on.copy(),
        "bounds": world.bounds,
        "goal_area": world.goal_area,
        "least_leg": np.array(world.least_leg),
        "switch_probability": np.array(world.switch_probability),
        "stop_share": np.array(world.stop_share),
        "stop_duration": world.stop_duration,
        "stream_places": world.stream_places,
        "field_of_view": np.array(world.field_of_view),
        "responsibility": np.array(world.responsibility),
        "way_clearance": np.array(world.way_clearance),
        "obstacles": world.layout.obstacles.copy(),
        "walls": world.layout.walls.copy(),
        **world.recorded(),
    }


def observe_robots(world: World, robots: list[str]) -> dict[str, dict[str, Any]]:
    """Observations of the robots that are there, as arrays of their own, by their names."""
    world.observe()
    maps = [None] * len(robots) if world.maps is None else world.maps.copy()
    rows = zip(robots, world.seen, maps, world.active.tolist(), strict=True)
    return {name: as_observation(row.copy(), image) for name, row, image, there in rows if there}


def final_goal(world: World, robot: int) -> tuple[float, float]:
    """A robot's goal in the frame of its odometry [m]."""
    x, y, heading = world.layout.robot_pose[robot].tolist()
    goal_x, goal_y = world.layout.robot_goal[robot].tolist()
    x, y, cosine, sine = goal_x - x, goal_y - y, math.cos(heading), math.sin(heading)
    return cosine * x + sine * y, cosine * y - sine * x


def observe_pedestrians(world: World, walkers: Mapping[str, int]) -> dict[str, dict[str, Any]]:
    """Observations of the pedestrians that are agents, relative to each, in world axes.

    Rows of robots that have left the scene are zero; nobody else can be at offset zero.
    """
    if not walkers:
        return {}
    people, ways = world.pedestrians, world.ways
    robots, present = np.hstack([world.pose[:, :2], world.world_velocity]), world.active[:, None]
    crowd = np.hstack([people.position, people.velocity])
    seen = {}
    for name, p in walkers.items():
        seen[name] = {
            "velocity": people.velocity[p].astype(np.float32),
            "goal": (ways[p, 0] - people.position[p]).astype(np.float32),
            "robots": np.where(present, robots - crowd[p], 0.0).astype(np.float32),
            "pedestrians": (np.delete(crowd, p, axis=0) - crowd[p]).astype(np.float32),
        }
    return seen


def results(
    world: World, robots: Mapping[str, int], late: bool
) -> tuple[dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]]:
    """Rewards, terminations, truncations and infos of the robots that have acted.

    Args:
        world: after the step, judged.
        robots: their places by name.
        late: the time is up.
    """
    rewards: dict[str, float] = {}
    terminations: dict[str, bool] = {}
    truncations: dict[str, bool] = {}
    infos: dict[str, Any] = {}
    contacts = world.contacts
    for name, r in robots.items():
        outcome = int(world.outcome[r])
        terminations[name] = outcome != RUNNING
        truncations[name] = late and outcome == RUNNING
        by_name = dict(zip(TERMS, world.terms[r].tolist(), strict=True))
        rewards[name] = float(sum(by_name.values()))
        infos[name] = {
            "outcome": OUTCOMES[TIMEOUT if truncations[name] else outcome],
            "reward_terms": by_name,
            "contact": contacts.get(r),
        }
    return rewards, terminations, truncations, infos


def progress(
    world: World, before: NDArray[np.float64], walkers: Mapping[str, int]
) -> dict[str, float]:
    """How much nearer pedestrian agents have come to their goals [m].

    Args:
        world: after the step.
        before: (P, 2) where pedestrians were before it [m].
        walkers: their places by name.
    """
    if not walkers:
        return {}
    # To its present goal: a new one, further away, is no loss.
    targets, after = world.ways[:, 0], world.pedestrians.position
    return {
        name: math.dist(targets[p], before[p]) - math.dist(targets[p], after[p])
        for name, p in walkers.items()
    }


def read_actions(
    world: World, actions: Mapping[str, Any], robots: list[str], walkers: Mapping[str, int]
) -> tuple[NDArray[np.float64], dict[int, NDArray[np.float64]]]:
    """What robots (R, 2) and steered pedestrians (2,) are to do, not limited yet.

    Raises:
        ValueError: a missing or bad action, or one for an unknown agent; the message names it.
    """
    for name in actions:
        if name not in robots and name not in walkers:
            live = [name for r, name in enumerate(robots) if world.active[r]]
            raise ValueError(f"action for unknown agent {name!r}; live: {[*live, *walkers]}")
    commands = np.zeros((len(robots), 2))
    for r, name in enumerate(robots):
        if not world.active[r]:
            continue
        if name not in actions:
            raise ValueError(f"no action for agent {name!r}")
        commands[r] = checked_action(name, actions[name])
    steered = {name: p for name, p in walkers.items() if actions.get(name) is not None}
    return commands, {p: checked_action(name, actions[name]) for name, p in steered.items()}


def checked_action(name: str, action: Any) -> NDArray[np.float64]:
    """An agent's action as an array (2,).

    Raises:
        ValueError: not two finite numbers; the message names the agent.
    """
    try:
        array = as_numbers(action)
    except (TypeError, ValueError) as error:
        raise ValueError(f"action of agent {name!r}: {short(action)} is not numeric") from error
    if array.shape != (2,):
        raise ValueError(f"action of agent {name!r}: expected shape (2,), got {array.shape}")
    if not (math.isfinite(array[0]) and math.isfinite(array[1])):
        raise ValueError(f"action of agent {name!r}: expected finite numbers, got {array}")
    return array


def as_numbers(value: Any) -> NDArray[np.float64]:
    """A copy as an array; truth values count as 0 and 1, and text never as the number it names.

    Raises:
        TypeError, ValueError: no array, or not one of real numbers.
    """
    array = np.asarray(value)
    # NumPy would read text, count dates, and leave imaginary parts out.
    kind = array.dtype.kind
    real = kind == "O" and all(isinstance(item, numbers.Real) for item in array.flat)
    if kind not in "biuf" and not real:
        raise TypeError("not numeric")
    try:
        return np.array(value, dtype=np.float64)
    except OverflowError as error:
        raise ValueError(str(error)) from error


def _unbounded(*shape: int) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape, np.float32)
