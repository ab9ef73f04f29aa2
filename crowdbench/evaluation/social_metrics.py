"""Metrics of what happens between the robot and people, each a pure function of an Episode.

``docs/metrics.md`` has formulas and figures worked by hand. What is not defined is NaN; "steps" are
the T states after each action.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from crowdbench.evaluation import interactions
from crowdbench.evaluation.episode import Episode
from crowdbench.evaluation.metric import mean
from crowdbench.evaluation.social_work import social_work as work_of

TTC_LIMIT = 1.0
"""[s]"""
INTIMATE_SPACE = 0.45
PERSONAL_SPACE = 1.2
"""Hall's zones around a person, between surfaces [m]."""
TOGETHER = 3.0
"""Nearer than this to the centre of their group, people are together [m]."""
SEVERE_GAP = 1.0
"""A cut-off with a shorter gap is severe [s]."""


def disturbance(name: str, chance: bool = False) -> Callable[[Episode], float]:
    """The metric of one number of ``crowdbench.evaluation.disturbance.Shift``.

    Args:
        name: of the number.
        chance: of people who are pushed by a millimetre, instead of those who meet the robot.
    """

    def metric(episode: Episode) -> float:
        found = episode.source.disturbance if episode.source else None
        if found is None:
            return math.nan
        return float(getattr(found.noise_floor if chance else found.by_robot, name))

    return metric


def cutoff(episode: Episode) -> float:
    """How often the robot crossed close ahead of a walking pedestrian."""
    return float(len(interactions.cut_offs(episode.crossing_gaps, episode.control_period)))


def cutoffs_per_min(episode: Episode) -> float:
    """``cutoff`` by the time in the scene [1/min]; NaN without steps."""
    return _per_minute(episode, cutoff(episode))


def severe_cutoffs_per_min(episode: Episode) -> float:
    """The same with gaps below ``SEVERE_GAP`` [1/min]."""
    events = interactions.cut_offs(episode.crossing_gaps, episode.control_period, SEVERE_GAP)
    return _per_minute(episode, len(events))


def near_misses_per_min(episode: Episode) -> float:
    """How often the robot and a pedestrian came close fast without touching [1/min]."""
    closing = interactions.closing_speed(
        episode.pedestrian_position - episode.robot_pose[:, None, :2],
        episode.pedestrian_velocity - episode.robot_world_velocity[:, None],
    )
    contact = episode.contact if episode.outcome == "collision" else None
    touched = contact.index if contact is not None and contact.kind == "pedestrian" else None
    events = interactions.near_misses(episode.clearance, closing, touched)
    return _per_minute(episode, len(events))


def min_dist(episode: Episode) -> float:
    """Least distance between the robot's centre and a pedestrian's [m]; NaN without any."""
    return _least(
        interactions.centre_distance(episode.robot_pose[:, :2], episode.pedestrian_position)
    )


def min_clearance(episode: Episode) -> float:
    """Least distance between the robot's footprint and a pedestrian [m]; NaN without any."""
    return _least(episode.clearance)


def ttc_below_1s(episode: Episode) -> float:
    """Share of steps at which some pedestrian is less than a second from collision."""
    return mean(np.any(time_to_collision(episode) < TTC_LIMIT, axis=1))


def intimate_space_share(episode: Episode) -> float:
    """Share of steps with a pedestrian's surface nearer than 0.45 m."""
    return mean(np.any(episode.clearance[1:] < INTIMATE_SPACE, axis=1))


def personal_space_share(episode: Episode) -> float:
    """Share of steps with a pedestrian's surface nearer than 1.2 m."""
    return mean(np.any(episode.clearance[1:] < PERSONAL_SPACE, axis=1))


def group_space_share(episode: Episode) -> float:
    """Share of steps in which the robot is among the people of a group; NaN without groups."""
    among = np.zeros(episode.steps, dtype=np.bool_)
    groups = np.unique(episode.pedestrian_group[episode.pedestrian_group >= 0])
    if not len(groups):
        return math.nan
    for group in groups:
        people = episode.pedestrian_position[1:, episode.pedestrian_group == group]
        gap = interactions.hull_distance(episode.robot_pose[1:, :2], people)
        far = np.linalg.norm(people - people.mean(axis=1, keepdims=True), axis=2).max(axis=1)
        among |= (gap < math.hypot(*episode.footprint) / 2) & (far < TOGETHER)
    return mean(among)


def social_work(episode: Episode) -> float:
    """Mean over steps of the social forces between the robot and all others [m/s^2]; NaN if T = 0.

    After HuNavSim, with the mean in place of the sum.
    """
    if not episode.steps:
        return math.nan
    work = work_of(
        episode.robot_pose[1:, :2],
        episode.robot_world_velocity[1:],
        math.hypot(*episode.footprint) / 2,
        episode.pedestrian_position[1:],
        episode.pedestrian_velocity[1:],
        episode.walls,
        episode.obstacles,
    )
    return float(work.mean())


def time_to_collision(episode: Episode) -> NDArray[np.float64]:
    """(T, P) time to collision with each pedestrian after each action [s]."""
    return interactions.time_to_collision(
        episode.pedestrian_position[1:] - episode.robot_pose[1:, None, :2],
        episode.pedestrian_velocity[1:] - episode.robot_world_velocity[1:, None],
        episode.reach,
    )


def _least(distance: NDArray[np.float64]) -> float:
    """Of those who are there; NaN without any."""
    there = distance[np.isfinite(distance)]
    return float(there.min()) if there.size else math.nan


def _per_minute(episode: Episode, events: float) -> float:
    seconds = episode.steps * episode.control_period
    return 60 * events / seconds if seconds else math.nan
