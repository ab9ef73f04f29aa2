"""Metrics: one pure function of an Episode each; docs/metrics.md has formulas and fixtures.

``METRICS`` at the end says all that has to be known of them. A value that is not defined for an
episode (the smoothness of one action, a distance to pedestrians where there are none) is NaN and
leaves that episode out of the metric's mean. "Steps" are the T states after each action.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from crowdbench.evaluation import interactions
from crowdbench.evaluation.episode import Episode
from crowdbench.evaluation.metric import Direction, Metric, MetricError
from crowdbench.evaluation.shortest_path import shortest_path
from crowdbench.registry import Registry
from crowdbench.simulation.contact import ContactKind

TTC_LIMIT = 1.0
"""[s]"""
STALLED_SPEED = 0.05
"""Speed below which the robot makes no headway [m/s]."""
INTIMATE_SPACE = 0.45
PERSONAL_SPACE = 1.2
"""Hall's zones around a person, between surfaces [m]."""


def metrics(episode: Episode) -> dict[str, float]:
    """Every metric of an episode by name, in the order of ``METRICS``.

    Raises:
        MetricError: one that cannot be computed.
        UnknownNameError: one of another package that cannot be loaded.
    """
    for name, metric in METRICS.items():
        if metric.weight and metric.weight not in METRICS:
            raise MetricError(f"metric {name!r}: weight: {METRICS.unknown(metric.weight)}")
    return {name: metric.measure(name, episode) for name, metric in METRICS.items()}


def success(episode: Episode) -> float:
    """1 when the goal was reached within tolerance, in time and without any contact."""
    return float(episode.outcome == "success")


def spl(episode: Episode) -> float:
    """Success weighted by path length, S L* / max(L, L*) (Anderson et al. 2018).

    L* is the ``shortest_way``. NaN when the robot arrived although there is none.
    """
    if episode.outcome != "success":
        return 0.0
    shortest = shortest_way(
        episode.robot_pose[0, :2], episode.goal, episode.walls, episode.obstacles,
        episode.footprint, episode.goal_tolerance,
    )  # fmt: skip
    return path_efficiency(shortest, path_length(episode))


def shortest_way(
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
    walls: NDArray[np.float64],
    obstacles: NDArray[np.float64],
    footprint: tuple[float, float],
    goal_tolerance: float,
) -> float:
    """L* [m]: the shortest path among walls and static obstacles, less the goal tolerance.

    It keeps half the footprint's lesser side away from them, which is the least distance any pose
    needs. Infinite when no such path leads to the goal's centre.
    """
    to_centre = shortest_path(start, goal, walls, obstacles, clearance=min(footprint) / 2)
    return max(to_centre - goal_tolerance, 0.0)


def path_efficiency(shortest: float, driven: float) -> float:
    """L* / max(L, L*) of a way that has arrived; NaN where there is no L*."""
    if math.isinf(shortest):
        return math.nan
    longer = max(driven, shortest)
    return shortest / longer if longer > 0 else 1.0


def smoothness(episode: Episode) -> float:
    """1 / (T - 1) sum_{t=1}^{T-1} |a_t - a_{t-1}|^2 (paper, section IV.B); NaN if T < 2."""
    return _mean(np.sum(np.diff(episode.actions, axis=0) ** 2, axis=1))


def inference_s(episode: Episode) -> float:
    """Mean wall-clock time inside ``act`` per step [s]; NaN without steps."""
    return _mean(episode.inference_s)


def cutoff(episode: Episode) -> float:
    """How often the robot crossed close ahead of a walking pedestrian."""
    return float(len(interactions.cut_offs(crossing_gaps(episode), episode.control_period)))


def min_dist(episode: Episode) -> float:
    """Least distance between the robot's centre and a pedestrian's [m]; NaN without any."""
    distance = interactions.centre_distance(episode.robot_pose[:, :2], episode.pedestrian_position)
    return float(distance.min()) if distance.size else math.nan


def min_clearance(episode: Episode) -> float:
    """Least distance between the robot's footprint and a pedestrian [m]; NaN without any."""
    distance = _clearance(episode)
    return float(distance.min()) if distance.size else math.nan


def ttc_below_1s(episode: Episode) -> float:
    """Share of steps at which some pedestrian is less than a second from collision."""
    return _mean(np.any(time_to_collision(episode) < TTC_LIMIT, axis=1))


def _collision_with(kind: ContactKind) -> Callable[[Episode], float]:
    def collision(episode: Episode) -> float:
        contact = episode.contact if episode.outcome == "collision" else None
        return float(contact is not None and contact.kind == kind)

    collision.__name__ = f"collision_{kind}"
    collision.__doc__ = f"1 when the episode ended in contact with a {kind}."
    return collision


def robot_at_fault(episode: Episode) -> float:
    """1 when the robot drove into the other, 0 when the other did; NaN without a collision.

    Whoever closed in faster is at fault, the robot in a tie; what does not approach never is.
    """
    contact = episode.contact
    if episode.outcome != "collision" or contact is None:
        return math.nan
    return float(contact.other_speed <= 0 or contact.robot_speed >= contact.other_speed)


def timeout(episode: Episode) -> float:
    """1 when the time limit ended the episode."""
    return float(episode.outcome == "timeout")


def time_to_goal(episode: Episode) -> float:
    """Time until arrival [s]; NaN unless the episode is a success."""
    arrived = episode.outcome == "success"
    return episode.steps * episode.control_period if arrived else math.nan


def path_length(episode: Episode) -> float:
    """Length of the robot's path, straight between states [m]."""
    return float(np.linalg.norm(np.diff(episode.robot_pose[:, :2], axis=0), axis=1).sum())


def stalled_time(episode: Episode) -> float:
    """Time with a speed below ``STALLED_SPEED`` [s]."""
    stalled = np.abs(episode.robot_speed[1:]) < STALLED_SPEED
    return float(np.count_nonzero(stalled) * episode.control_period)


def jerk(episode: Episode) -> float:
    """Mean of |v_{t+1} - 2 v_t + v_{t-1}| / dt^2, v the velocity vector [m/s^3]; NaN if T < 3."""
    change = np.diff(episode.robot_world_velocity[1:], n=2, axis=0) / episode.control_period**2
    return _mean(np.linalg.norm(change, axis=1))


def intimate_space_share(episode: Episode) -> float:
    """Share of steps with a pedestrian's surface nearer than 0.45 m."""
    return _mean(np.any(_clearance(episode)[1:] < INTIMATE_SPACE, axis=1))


def personal_space_share(episode: Episode) -> float:
    """Share of steps with a pedestrian's surface nearer than 1.2 m."""
    return _mean(np.any(_clearance(episode)[1:] < PERSONAL_SPACE, axis=1))


def crossing_gaps(episode: Episode) -> NDArray[np.float64]:
    """(T, P) time gap wherever the robot crosses a pedestrian's path, else infinite [s]."""
    return interactions.crossing_gaps(
        episode.robot_pose[:, :2],
        episode.pedestrian_position,
        episode.pedestrian_velocity,
        episode.control_period,
        _reach(episode),
    )


def time_to_collision(episode: Episode) -> NDArray[np.float64]:
    """(T, P) time to collision with each pedestrian after each action [s]."""
    return interactions.time_to_collision(
        episode.pedestrian_position[1:] - episode.robot_pose[1:, None, :2],
        episode.pedestrian_velocity[1:] - episode.robot_world_velocity[1:, None],
        _reach(episode),
    )


def _clearance(episode: Episode) -> NDArray[np.float64]:
    """(T + 1, P) distance between footprint and pedestrians [m]."""
    return interactions.clearance(
        episode.robot_pose,
        episode.footprint,
        episode.pedestrian_position,
        episode.pedestrian_radius,
    )


def _reach(episode: Episode) -> float:
    """Radius of the circle around the footprint plus a pedestrian's radius [m]."""
    return math.hypot(*episode.footprint) / 2 + episode.pedestrian_radius


def _mean(values: NDArray[np.floating] | NDArray[np.bool_]) -> float:
    return float(values.mean()) if values.size else math.nan


def _proportion(
    function: Callable[[Episode], float], better: Direction, definition: str, main: bool = False
) -> Metric:
    return Metric(function, "", better, definition, "proportion", main, digits=3)


def _share_of_steps(function: Callable[[Episode], float], what: str, main: bool = False) -> Metric:
    definition = f"share of steps {what}"
    return Metric(
        function, "", "lower", definition, "mean", main, printed_unit="%", scale=100, digits=1
    )


_BUILT_IN = {
    "success": _proportion(
        success, "higher", "goal reached in time without any contact", main=True
    ),
    "spl": Metric(
        spl, "", "higher", "success weighted by shortest over driven path length", "mean",
        main=True, label="SPL", digits=3,
    ),
    "smoothness": Metric(
        smoothness, "m²/s² + rad²/s²", "lower", "mean squared change between actions",
        "mean", main=True, digits=3,
    ),
    "inference_s": Metric(
        inference_s, "s", "lower", "mean wall-clock time in act per step", "mean", main=True,
        label="inference", printed_unit="ms", scale=1000,
    ),
    "cutoff": Metric(
        cutoff, "events", "lower", "crossings ahead of a walking pedestrian with a gap below 2 s",
        "count", main=True, digits=2,
    ),
    "min_dist": Metric(
        min_dist, "m", "higher", "least distance to a pedestrian, centres", "mean", main=True,
        digits=3,
    ),
    "min_clearance": Metric(
        min_clearance, "m", "higher", "least distance to a pedestrian, surfaces", "mean", digits=3
    ),
    "ttc_below_1s": _share_of_steps(
        ttc_below_1s, "with a time to collision below 1 s", main=True
    ),
    "collision_pedestrian": _proportion(
        _collision_with("pedestrian"), "lower", "ended in contact with a pedestrian"
    ),
    "collision_obstacle": _proportion(
        _collision_with("obstacle"), "lower", "ended in contact with a static obstacle"
    ),
    "collision_wall": _proportion(
        _collision_with("wall"), "lower", "ended in contact with a wall"
    ),
    "collision_robot": _proportion(
        _collision_with("robot"), "lower", "ended in contact with another robot"
    ),
    "robot_at_fault": _proportion(
        robot_at_fault, "lower", "of the collisions, those the robot drove into"
    ),
    "timeout": _proportion(timeout, "lower", "ended by the time limit"),
    "time_to_goal": Metric(
        time_to_goal, "s", "lower", "time until arrival, successes only", "mean", digits=1
    ),
    "path_length": Metric(
        path_length, "m", "lower", "length of the driven path", "mean", digits=2
    ),
    "stalled_time": Metric(
        stalled_time, "s", "lower", "time slower than 0.05 m/s", "mean", digits=2
    ),
    "jerk": Metric(
        jerk, "m/s³", "lower", "mean second difference of the velocity vector", "mean", digits=2
    ),
    "intimate_space_share": _share_of_steps(
        intimate_space_share, "within 0.45 m of a pedestrian, surfaces"
    ),
    "personal_space_share": _share_of_steps(
        personal_space_share, "within 1.2 m of a pedestrian, surfaces"
    ),
}  # fmt: skip

METRICS: Registry[Metric] = Registry("metric", "crowdbench.metrics", _BUILT_IN, of=Metric)
"""Every metric by name: crowdbench's own in the order of the tables, then those of packages."""
