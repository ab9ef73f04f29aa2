"""People of a lane as walking models see them."""

from __future__ import annotations

import numpy as np

from crowdbench.simulation import legs
from crowdbench.simulation.lane_episode import Episode
from crowdbench.simulation.lanes import State
from crowdbench.simulation.walking import Crowd


def crowd_of(s: State, lane: int, episode: Episode) -> Crowd:
    """A lane as walking models see it: copies, which they may keep."""
    robots, scenario = s.robots[lane], episode.prepared.scenario
    count = scenario.pedestrians.count
    people = s.people[lane, :count]
    return Crowd(
        position=people["position"].copy(),
        velocity=people["velocity"].copy(),
        heading=people["heading"].copy(),
        goal=np.ascontiguousarray(legs.ways(lane, s, count, episode.prepared.routes)[:, 0]),
        preferred_speed=people["speed"].copy(),
        preferred_velocity=people["preferred"].copy(),
        radius=people["radius"].copy(),
        present=people["present"].copy(),
        sees_robot=s.sees[lane, :count].copy(),
        robot_position=robots["pose"][:, :2].copy(),
        robot_velocity=robots["world_velocity"].copy(),
        robot_radius=float(episode.prepared.world["robot_radius"]),
        responsibility=scenario.pedestrians.responsibility,
        obstacles=episode.layout.obstacles,
        walls=episode.layout.walls,
        period=scenario.control_period,
    )
