"""The state of many worlds side by side: arrays of records, whose leading axis is the lane.

Compiled functions are given these and the lanes to work on. Lanes may differ in their scenario as
long as robots and LiDAR are alike; there are rows for the largest of everything, and those that a
lane has not are never read. Lengths are in metres, times in seconds, angles in radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Scenario
from crowdbench.scenario.room import robot_radius
from crowdbench.scenario.streams import MOST_VIA
from crowdbench.simulation.chipmunk import CONTACT
from crowdbench.simulation.kinematics import Drive
from crowdbench.simulation.routes import has_routes
from crowdbench.simulation.substeps import half_extent
from crowdbench.simulation.walls import walls_of

CANDIDATES = 16
"""Places that are drawn for either goal of a leg."""
DRAWS = 4 * CANDIDATES + 3
"""Numbers that a leg takes from its pedestrian's stream."""
LEGS_AHEAD = 4
"""Legs whose draws are held ready."""
ENTRIES = 8
"""Places that are drawn for a person in a stream to enter at."""
POINTS = 8
"""Points of a way that are held ready."""

OUTCOMES = ("running", "success", "collision", "timeout")
RUNNING, SUCCESS, COLLISION, TIMEOUT = range(len(OUTCOMES))
TERMS = ("goal", "collision", "social")
"""Terms of the reward, in the order in which they are added."""
PROPRIOCEPTION = 7
"""Numbers of an observation before the scan: velocity (2), goal (2), odometry (3)."""
ODOMETRY = slice(4, 7)
"""Where odometry is among them."""

_WHOLE, _REAL, _FLAG, _ADDRESS = np.int64, np.float64, np.bool_, np.uint64

WORLD = np.dtype(
    [
        # Of the scenario, in the order of its fields.
        ("period", _REAL),
        ("least_steps", _WHOLE),  # physics steps of a control period, at least
        ("half_length", _REAL),  # of the area in which pedestrians have their goals
        ("half_width", _REAL),
        ("drive", _WHOLE),  # which compiled one
        ("robot_length", _REAL),
        ("robot_width", _REAL),
        ("mount", _REAL, 3),  # pose of the LiDAR on the robot
        ("robot_radius", _REAL),  # of the circle around the footprint, as pedestrians see it
        ("corner", _REAL),  # the same circle, as substeps are chosen by it
        ("reach", _REAL, 2),  # how far the velocity can change in a control period
        ("full_speed", _REAL),
        ("goal_tolerance", _REAL),
        ("range", _REAL),
        ("obstacles", _WHOLE),
        ("walls", _WHOLE),
        ("people", _WHOLE),
        ("largest_radius", _REAL),  # of a pedestrian
        ("half_view", _REAL),
        ("responsibility", _REAL),
        ("switch_probability", _REAL),  # 0 where goals are unimodal
        ("leg", _REAL),
        ("from_goal", _FLAG),  # legs start from the last goal
        ("centre", _REAL, 2),  # of the area
        ("entry_gap", _REAL),  # from a robot's centre to those who enter a stream
        ("attentive_for", _REAL, 2),  # how long those who look away at times look around
        ("away_for", _REAL, 2),
        ("stop_share", _REAL),  # of the legs
        ("stop_for", _REAL, 2),
        ("half_extent", _REAL),  # of the smallest body that moves
        ("arrival", _REAL),
        ("progress", _REAL),
        ("collision", _REAL),
        ("proximity", _REAL),
        ("proximity_range", _REAL),
        ("social", _REAL),
        ("social_radius", _REAL),
        ("social_horizon", _REAL),
        # Of the episode.
        ("time", _REAL),  # since it began
        ("space", _ADDRESS),  # where Chipmunk keeps it
        ("steps", _WHOLE),  # physics steps of this control period
        ("bias", _REAL),  # share of an overlap that is left after a second
        ("tracks", _ADDRESS),  # of recorded people, (moments, people, 2), see Tracks
        ("moments", _WHOLE),  # control periods that these know
    ],
    align=True,
)

ROBOT = np.dtype(
    [
        ("pose", _REAL, 3),  # x, y, heading
        ("velocity", _REAL, 2),  # what the drive is doing, e.g. v, w
        ("direction", _REAL, 2),  # unit vector along which the robot travels, in the world
        ("speed", _REAL),  # along it, negative backwards
        ("world_velocity", _REAL, 2),  # direction times speed
        ("active", _FLAG),  # still in the scene
        ("reserves", _FLAG),  # nobody enters near it; as active, but see World.reserve
        ("goal", _REAL, 2),
        ("origin", _REAL, 3),  # pose at which odometry is zero
        ("distance", _REAL),  # to the goal
        ("body", _ADDRESS),  # Chipmunk's
        ("turn_rate", _REAL),
        ("outline", _REAL, (4, 4)),  # edges of the footprint, where there are several robots
        ("nearest", _REAL),  # least true LiDAR distance
        ("terms", _REAL, len(TERMS)),  # of the reward
        ("outcome", _WHOLE),  # index into OUTCOMES
    ],
    align=True,
)

PERSON = np.dtype(
    [
        ("position", _REAL, 2),
        ("velocity", _REAL, 2),
        ("heading", _REAL),  # direction of the last step walked
        ("goal", _REAL, 2),
        ("start", _REAL, 2),  # of the leg
        ("next_goal", _REAL, 2),  # after a switch
        ("speed", _REAL),  # preferred, never exceeded
        ("acceleration", _REAL),  # limit on the change of velocity, inf without one
        ("radius", _REAL),
        ("intent", _WHOLE),  # index into INTENTS
        ("switch_time", _REAL),  # when the leg is interrupted, inf when it is kept
        ("deadline", _REAL),  # when the leg is given up
        ("present", _FLAG),  # in the scene; others are kept far away from it
        ("held", _FLAG),  # could not appear, at least once, since a robot was in the way
        ("reactive", _FLAG),  # sees the robots
        ("preferred", _REAL, 2),  # velocity if nobody was in the way
        ("chosen", _REAL, 2),  # velocity for this control period
        ("drawn", _WHOLE),  # legs begun of those whose draws are held ready
        ("walks_on", _FLAG),  # on arrival
        ("key", _ADDRESS),  # of what is drawn besides
        ("attentive", _FLAG),  # does not look away now
        ("attention_time", _REAL),  # when that changes, inf for never
        ("looks", _WHOLE),  # changes so far
        ("stop_time", _REAL),  # when the stop on this leg begins, inf without one
        ("stop_end", _REAL),
        ("stop_leg", _REAL),  # deadline of the leg that these belong to
        ("stops", _WHOLE),  # legs so far, stops or none
        ("group", _WHOLE),  # -1 for none
        ("leader", _WHOLE),  # of the group, its first; -1 for none
        ("arrived", _FLAG),  # somebody of the group that this person leads
        ("entered", _FLAG),  # in a stream anew, and not all of its group yet
        ("along", _REAL, 2),  # unit vector along which the group of a leader walks
        ("queue", _WHOLE),  # that the person belongs to, -1 for none
        ("place", _WHOLE),  # in it, from 0, -1 while the person is somewhere else
        ("served_time", _REAL),  # when the first one leaves, inf before it is served
        ("served", _WHOLE),  # how often so far
        ("body", _ADDRESS),  # Chipmunk's
    ],
    align=True,
)

WALK = np.dtype(
    [
        ("stream", _WHOLE),  # -1 without one
        ("stage", _WHOLE),  # regions on the way that lie behind
        ("last", _WHOLE),  # regions on the way
        ("waiting", _WHOLE),  # how often entering has been tried in vain
        ("intent", _WHOLE),  # of the leg, see PERSON
        ("when", _REAL),  # share of the leg after which it is interrupted
        ("stops", _REAL, (MOST_VIA + 1, 2)),  # places in the regions on the way, then the goal
        ("entries", _REAL, (ENTRIES, 2)),  # places where the leg may begin
        ("points", _REAL, (POINTS, 2)),  # of the way, from the person on
        ("count", _WHOLE),  # how many of them there are
        ("at", _WHOLE),  # the one that the person heads for
        ("whole", _FLAG),  # they lead to the end of the way
    ],
    align=True,
)
"""What people with routes have beside PERSON (``crowdbench.simulation.following``)."""


QUEUE = np.dtype(
    [
        ("head", _REAL, 2),  # the first place
        ("facing", _REAL, 2),  # unit vector
        ("spacing", _REAL),
        ("service", _REAL, 2),  # how long it lasts, at least and at most
        ("last", _WHOLE),  # place in it
    ],
    align=True,
)


class State(NamedTuple):
    """Everything that compiled functions work on; L lanes, R robots and P pedestrians in each.

    Attributes:
        worlds: (L,) records WORLD.
        robots: (L, R) records ROBOT.
        people: (L, P) records PERSON.
        walks: (L, P) records WALK; (L, 0) where nobody has routes.
        queues: (L, Q) records QUEUE.
        obstacles: (L, K, 3) x, y, radius [m].
        walls: (L, S, 4) x1, y1, x2, y2 [m].
        sees: (L, P, R) which pedestrian sees which robot now.
        draws: (L, P, LEGS_AHEAD, DRAWS) in [0, 1), for the legs to come.
        contacts: (L, R, CONTACT) what each robot has touched first.
        under_way: (L, R, latency, 2) commands that do not act yet, the next to act first.
        seen: (L, R, PROPRIOCEPTION + beams) what robots observe.
    """

    worlds: NDArray[np.void]
    robots: NDArray[np.void]
    people: NDArray[np.void]
    walks: NDArray[np.void]
    queues: NDArray[np.void]
    obstacles: NDArray[np.float64]
    walls: NDArray[np.float64]
    sees: NDArray[np.bool_]
    draws: NDArray[np.float64]
    contacts: NDArray[np.float64]
    under_way: NDArray[np.float64]
    seen: NDArray[np.float32]


def allocate(lanes: int, scenarios: Sequence[Scenario]) -> State:
    """Enough of everything for any of the scenarios in every lane."""
    robots, beams = scenarios[0].robots.count, scenarios[0].lidar.beams
    people = max(scenario.pedestrians.count for scenario in scenarios)
    obstacles = max(scenario.obstacles.count for scenario in scenarios)

    def make(kind: Any, *shape: int) -> NDArray[Any]:
        return np.zeros((lanes, *shape), dtype=kind)

    return State(
        worlds=make(WORLD),
        robots=make(ROBOT, robots),
        people=make(PERSON, people),
        walks=make(WALK, people if any(map(has_routes, scenarios)) else 0),
        queues=make(QUEUE, max(len(scenario.pedestrians.queues) for scenario in scenarios)),
        obstacles=make(_REAL, obstacles, 3),
        walls=make(_REAL, max(len(walls_of(scenario)) for scenario in scenarios), 4),
        sees=make(_FLAG, people, robots),
        draws=make(_REAL, people, LEGS_AHEAD, DRAWS),
        contacts=make(_REAL, robots, CONTACT),
        under_way=make(_REAL, robots, scenarios[0].robots.latency, 2),
        seen=make(np.float32, robots, PROPRIOCEPTION + beams),
    )


def world_of(scenario: Scenario, drive: Drive, kind: int) -> NDArray[np.void]:
    """A record WORLD, before any episode, with a drive of which ``kind`` is the compiled one."""
    people, robots, arena = scenario.pedestrians, scenario.robots, scenario.arena
    values = {
        "period": scenario.control_period,
        "least_steps": scenario.substeps,
        "half_length": arena.length / 2 - people.radii[1],
        "half_width": arena.width / 2 - people.radii[1],
        "drive": kind,
        "robot_length": robots.length,
        "robot_width": robots.width,
        "mount": scenario.lidar.mount,
        "robot_radius": np.hypot(robots.length, robots.width) / 2,
        "corner": robot_radius(robots),
        "reach": np.array(robots.acceleration or (np.inf, np.inf)) * scenario.control_period,
        "full_speed": drive.full_speed,
        "goal_tolerance": robots.goal_tolerance,
        "range": scenario.lidar.range,
        "obstacles": scenario.obstacles.count,
        "walls": len(walls_of(scenario)),
        "people": people.count,
        "largest_radius": people.radii[1],
        "half_view": np.deg2rad(people.field_of_view) / 2,
        "responsibility": people.responsibility,
        "switch_probability": people.switch_probability if people.goals == "multimodal" else 0.0,
        "leg": people.leg,
        "from_goal": people.leg_from == "goal",
        "centre": np.array(arena.centre),
        "entry_gap": robot_radius(robots) + people.spawn_clearance,
        "attentive_for": np.array(people.attention.every),
        "away_for": np.array(people.attention.away_for),
        "stop_share": people.stops.share,
        "stop_for": np.array(people.stops.duration),
        "half_extent": half_extent(scenario),
        **scenario.reward.model_dump(),
    }
    world = np.zeros((), dtype=WORLD)
    for name, value in values.items():
        world[name] = value
    return world[()]
