"""Metrics of the robot's way, each a pure function of an Episode: whether it arrives, how, by what.

``docs/metrics.md`` has formulas and figures worked by hand. What is not defined is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from crowdbench.evaluation.episode import Episode
from crowdbench.evaluation.metric import mean
from crowdbench.evaluation.shortest_path import shortest_path
from crowdbench.libm import atan2
from crowdbench.simulation.contact import ContactKind

STALLED_SPEED = 0.05
"""Speed below which the robot makes no headway [m/s]."""
BARN_RANGE = (2.0, 8.0)
"""Times as long as the fastest between which BARN's score tells the arrivals apart."""
_STANDS = 1e-3
"""Chords shorter than this have no direction [m]."""


def success(episode: Episode) -> float:
    """1 when the goal was reached within tolerance, in time and without any contact."""
    return float(episode.outcome == "success")


def spl(episode: Episode) -> float:
    """Success weighted by path length, S L* / max(L, L*) (Anderson et al. 2018).

    L* is the ``shortest_way``. NaN when the robot arrived although there is none.
    """
    if episode.outcome != "success":
        return 0.0
    return path_efficiency(_shortest(episode), path_length(episode))


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


def stl(episode: Episode) -> float:
    """Success weighted by time length, S T* / max(T, T*) (iGibson Challenge 2021).

    T* is the time of the shortest path at top speed, which no real drive undercuts.
    """
    if episode.outcome != "success":
        return 0.0
    return path_efficiency(_fastest(episode), time_in_scene(episode))


def barn_score(episode: Episode) -> float:
    """S / min(max(T / T*, 2), 8), as the BARN Challenge ranks by; NaN as ``spl``."""
    if episode.outcome != "success":
        return 0.0
    fastest = _fastest(episode)
    if math.isinf(fastest):
        return math.nan
    ratio = time_in_scene(episode) / fastest if fastest > 0 else math.inf
    return 1 / float(np.clip(ratio, *BARN_RANGE))


def progress(episode: Episode) -> float:
    """Share of the shortest path that the robot has put behind it; NaN where there is none.

    What remains is measured from the last state from which a path leads to the goal: a robot that
    has touched something may be too near to it for any.
    """
    if episode.outcome == "success":
        return 1.0
    whole = _shortest(episode)
    if math.isinf(whole) or whole == 0:
        return math.nan
    remaining = (_length_from(episode, place) for place in episode.robot_pose[::-1, :2])
    left = next((length for length in remaining if math.isfinite(length)), whole)
    return max(0.0, 1.0 - left / whole)


def smoothness(episode: Episode) -> float:
    """1 / (T - 1) sum_{t=1}^{T-1} |a_t - a_{t-1}|^2 (paper, section IV.B); NaN if T < 2."""
    return mean(np.sum(np.diff(episode.actions, axis=0) ** 2, axis=1))


def inference_s(episode: Episode) -> float:
    """Mean wall-clock time inside ``act`` per step [s]; NaN without steps."""
    return mean(episode.inference_s)


def collision_with(kind: ContactKind) -> Callable[[Episode], float]:
    """The metric that is 1 when the episode ended in contact with one kind of thing."""

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


def collisions_caused_per_km(episode: Episode) -> float:
    """Collisions in which the robot drove into the other, by its path [1/km]; NaN if it stays."""
    return _per_km(episode, robot_at_fault(episode) == 1.0)


def collisions_suffered_per_km(episode: Episode) -> float:
    """Collisions in which the other came into the robot, by its path [1/km]; NaN if it stays."""
    return _per_km(episode, robot_at_fault(episode) == 0.0)


def timeout(episode: Episode) -> float:
    """1 when the time limit ended the episode."""
    return float(episode.outcome == "timeout")


def time_in_scene(episode: Episode) -> float:
    """From the start to the end, however that came [s]."""
    return episode.steps * episode.control_period


def time_to_goal(episode: Episode) -> float:
    """Time until arrival [s]; NaN unless the episode is a success."""
    arrived = episode.outcome == "success"
    return time_in_scene(episode) if arrived else math.nan


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
    return mean(np.linalg.norm(change, axis=1))


def heading_changes(episode: Episode) -> float:
    """How far the robot turns in all, left and right added up [rad]."""
    return float(np.abs(_wrapped(np.diff(episode.robot_pose[:, 2]))).sum())


def curvature(episode: Episode) -> float:
    """Turning of the path by its length [rad/m]; NaN unless it has two chords.

    A corner between two chords counts for half of both; the robot stands in chords below 1 mm.
    """
    chords = np.diff(episode.robot_pose[:, :2], axis=0)
    length = np.linalg.norm(chords, axis=1)
    chords, length = chords[length >= _STANDS], length[length >= _STANDS]
    if len(chords) < 2:
        return math.nan
    turns = _wrapped(np.diff(atan2(chords[:, 1], chords[:, 0])))
    return float(np.abs(turns).sum() / ((length[:-1] + length[1:]) / 2).sum())


def path_irregularity(episode: Episode) -> float:
    """Turning beyond what the shortest path needs, by the path driven [rad/m] (Guzzi et al. 2013).

    NaN where there is no shortest path, and for a robot that stays where it is.
    """
    length, route = path_length(episode), episode.route
    if length == 0 or math.isinf(route.length):
        return math.nan
    needed = route.turning
    if route.length > 0:
        needed += abs(float(_wrapped(np.array(route.heading - episode.robot_pose[0, 2]))))
    return max(0.0, heading_changes(episode) - needed) / length


def _shortest(episode: Episode) -> float:
    """L* [m]."""
    return max(episode.route.length - episode.goal_tolerance, 0.0)


def _fastest(episode: Episode) -> float:
    """T*, L* at top speed [s]."""
    shortest = _shortest(episode)
    if episode.top_speed == 0:
        return math.inf if shortest > 0 else 0.0
    return shortest / episode.top_speed


def _length_from(episode: Episode, place: NDArray[np.float64]) -> float:
    """As L* from another place [m]."""
    return shortest_way(
        place, episode.goal, episode.walls, episode.obstacles, episode.footprint,
        episode.goal_tolerance,
    )  # fmt: skip


def _per_km(episode: Episode, collided: bool) -> float:
    length = path_length(episode)
    return 1000 * float(collided) / length if length > 0 else math.nan


def _wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles between -pi and pi [rad]."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
