"""People of a lane: how recorded ones come and go, and what walking models see."""

from __future__ import annotations

import numpy as np

from crowdbench.simulation import legs
from crowdbench.simulation.lane_episode import Episode
from crowdbench.simulation.lanes import State
from crowdbench.simulation.recorded import Recorded, away
from crowdbench.simulation.walking import Crowd


def come_and_go(s: State, lane: int, episode: Episode) -> None:
    """Let a lane's recorded people appear and leave, at the end of a control period."""
    people = s.people[lane, : episode.prepared.scenario.pedestrians.count]
    robots = s.robots[lane]
    assert isinstance(episode.model, Recorded)
    tracks = episode.model.tracks
    step = round(float(s.worlds["time"][lane]) / episode.prepared.scenario.control_period)
    in_scene = robots["pose"][robots["active"], :2]
    reach = float(episode.prepared.world["robot_radius"]) + people["radius"]
    present = episode.model.present(people["present"], reach, in_scene, step)
    changed = np.flatnonzero(present != people["present"]).tolist()
    if not changed:
        return
    places = np.where(present[:, None], tracks.at(step), away(len(present)))
    velocity = tracks.velocity(step)
    for p in changed:
        people["present"][p] = present[p]
        people["position"][p] = places[p]
        people["velocity"][p] = velocity[p] if present[p] else 0.0
        episode.bodies.place(p, *places[p].tolist())


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
