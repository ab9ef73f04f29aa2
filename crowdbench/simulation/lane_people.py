"""People of a lane: how they begin, how recorded ones come and go, what walking models see."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.simulation import legs, streams
from crowdbench.simulation.habits import begin_habits
from crowdbench.simulation.lane_episode import Episode, Prepared
from crowdbench.simulation.lanes import DRAWS, LEGS_AHEAD, State
from crowdbench.simulation.layout import Layout
from crowdbench.simulation.pedestrians import KEEP
from crowdbench.simulation.recorded import Recorded, Tracks, away
from crowdbench.simulation.traits import preferred_speeds
from crowdbench.simulation.walking import Crowd


def place_people(
    s: State, lane: int, layout: Layout, seed: int, prepared: Prepared
) -> list[np.random.Generator]:
    """Begin the first legs in a lane; returns where later ones are drawn from."""
    settings = prepared.scenario.pedestrians
    people = s.people[lane, : settings.count]
    drawing = [streams.pedestrian(seed, p) for p in range(settings.count)]
    draws = np.empty((settings.count, 1 + LEGS_AHEAD * DRAWS))
    for row, stream in zip(draws, drawing, strict=True):
        stream.random(out=row)
    people["speed"] = preferred_speeds(settings, draws[:, 0])
    people["acceleration"] = settings.acceleration or np.inf
    s.draws[lane, : settings.count] = draws[:, 1:].reshape(-1, LEGS_AHEAD, DRAWS)
    people["drawn"] = 0
    people["present"], people["preferred"] = True, 0.0
    people["position"] = people["next_goal"] = layout.pedestrian_position
    people["reactive"] = layout.pedestrian_reactive
    people["radius"] = layout.traits.radius
    if layout.tracks is not None:
        _follow(people, layout.tracks)
        begin_habits(people, s.queues[lane], layout, settings)
        return drawing
    legs.begin(lane, s, layout.pedestrian_stage, layout.traits.first, prepared.routes)
    ahead = legs.ways(lane, s, settings.count, prepared.routes)[:, 0] - people["position"]
    people["heading"] = heading = np.arctan2(ahead[:, 1], ahead[:, 0])
    directions = np.column_stack([np.cos(heading), np.sin(heading)])
    people["velocity"] = people["preferred"] = people["speed"][:, None] * directions
    begin_habits(people, s.queues[lane], layout, settings)
    return drawing


def _follow(people: NDArray[np.void], tracks: Tracks) -> None:
    """Begin as recorded."""
    people["start"], people["goal"], people["speed"] = tracks.ways()
    people["next_goal"], people["intent"] = people["goal"], KEEP
    people["switch_time"] = people["deadline"] = np.inf
    people["velocity"] = tracks.velocity(0)
    people["present"] = np.isfinite(tracks.at(0)[:, 0])
    people["heading"] = [math.atan2(y, x) for x, y in people["velocity"].tolist()]


def come_and_go(s: State, lane: int, episode: Episode) -> None:
    """Let a lane's recorded people appear and leave, at the end of a control period."""
    people = s.people[lane]
    assert isinstance(episode.model, Recorded)
    tracks = episode.model.tracks
    step = round(float(s.worlds["time"][lane]) / episode.prepared.scenario.control_period)
    present = episode.model.present(crowd_of(s, lane, episode), step)
    places = np.where(present[:, None], tracks.at(step), away(len(present)))
    for p in np.flatnonzero(present != people["present"][: len(present)]).tolist():
        people["present"][p] = present[p]
        people["position"][p] = places[p]
        people["velocity"][p] = tracks.velocity(step)[p] if present[p] else 0.0
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
