"""Walls of a scenario's place, all of them as segments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Scenario
from crowdbench.scenario.recorded import load, origin


def walls_of(scenario: Scenario) -> NDArray[np.float64]:
    """(S, 4) x1, y1, x2, y2 [m].

    A corridor has a wall on either long side, reaching beyond it; a map its own, then the edges of
    its polygons; open arenas none. Those of a recording are added.
    """
    arena = scenario.arena
    if arena.kind == "corridor":
        x, y = arena.length / 2 + scenario.lidar.range, arena.width / 2
        return np.array([[-x, -y, x, -y], [-x, y, x, y]])
    edges = [
        (*begin, *end)
        for polygon in arena.polygons
        for begin, end in zip(polygon, (*polygon[1:], polygon[0]), strict=True)
    ]
    if scenario.pedestrians.recording.file:
        recording, _ = load(scenario.pedestrians.recording)
        edges += (recording.segments - np.tile(origin(recording, arena), 2)).tolist()
    return np.array([*arena.walls, *edges], dtype=np.float64).reshape(-1, 4)
