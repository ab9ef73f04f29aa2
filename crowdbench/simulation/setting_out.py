"""Setting out: everybody of a lane, as an episode begins."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Pedestrians
from crowdbench.simulation import legs, streams
from crowdbench.simulation.habits import begin_habits
from crowdbench.simulation.lanes import DRAWS, LEGS_AHEAD, State
from crowdbench.simulation.layout import Layout
from crowdbench.simulation.pedestrians import KEEP
from crowdbench.simulation.recorded import Tracks
from crowdbench.simulation.routes import Routes
from crowdbench.simulation.traits import preferred_speeds


def set_out(
    state: State,
    lane: int,
    layout: Layout,
    seed: int,
    settings: Pedestrians,
    routes: Routes | None,
) -> list[np.random.Generator]:
    """Place the people of a lane and begin their first legs.

    Args:
        state: of all lanes.
        lane: which; obstacles and walls have their places.
        layout: where everybody begins.
        seed: of the episode.
        settings: of the scenario.
        routes: of the scenario, where people have any.

    Returns:
        Where each person's later legs are drawn from; nothing for recorded ones.
    """
    people = state.people[lane, : settings.count]
    people["acceleration"] = settings.acceleration or np.inf
    people["drawn"] = 0
    people["present"], people["preferred"] = True, 0.0
    people["position"] = people["next_goal"] = layout.pedestrian_position
    people["reactive"] = layout.pedestrian_reactive
    people["radius"] = layout.traits.radius
    drawing: list[np.random.Generator] = []
    if layout.tracks is None:
        drawing = [streams.pedestrian(seed, p) for p in range(settings.count)]
        draws = np.empty((settings.count, 1 + LEGS_AHEAD * DRAWS))
        for row, stream in zip(draws, drawing, strict=True):
            stream.random(out=row)
        people["speed"] = preferred_speeds(settings, draws[:, 0])
        state.draws[lane, : settings.count] = draws[:, 1:].reshape(-1, LEGS_AHEAD, DRAWS)
        legs.begin(lane, state, layout.pedestrian_stage, layout.traits.first, routes)
        ahead = legs.ways(lane, state, settings.count, routes)[:, 0] - people["position"]
        people["heading"] = headings = [math.atan2(y, x) for x, y in ahead.tolist()]
        directions = np.array([(math.cos(a), math.sin(a)) for a in headings]).reshape(-1, 2)
        people["velocity"] = people["preferred"] = people["speed"][:, None] * directions
    else:
        _follow(people, layout.tracks)
    begin_habits(people, state.queues[lane], layout, settings)
    return drawing


def _follow(people: NDArray[np.void], tracks: Tracks) -> None:
    """Begin as recorded."""
    people["start"], people["goal"], people["speed"] = tracks.ways()
    people["next_goal"], people["intent"] = people["goal"], KEEP
    people["switch_time"] = people["deadline"] = np.inf
    people["velocity"] = tracks.velocity(0)
    people["present"], people["held"] = np.isfinite(tracks.at(0)[:, 0]), False
    people["heading"] = [math.atan2(y, x) for x, y in people["velocity"].tolist()]
