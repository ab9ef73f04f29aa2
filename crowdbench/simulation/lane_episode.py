"""What a lane keeps in Python: of its scenario, and of its present episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Scenario
from crowdbench.simulation.chipmunk import Bodies
from crowdbench.simulation.kinematics import Drive
from crowdbench.simulation.layout import Layout
from crowdbench.simulation.map_layout import Places
from crowdbench.simulation.odometry import DriftingOdometry
from crowdbench.simulation.routes import Routes
from crowdbench.simulation.walking import WalkingModel


class Prepared(NamedTuple):
    """What the episodes of a scenario share."""

    scenario: Scenario
    drive: Drive
    world: NDArray[np.void]
    corners: list[tuple[float, float]]
    drifts: bool
    places: Places | None
    routes: Routes | None


@dataclass
class Episode:
    """What a lane keeps in Python.

    Attributes:
        prepared: of its scenario.
        seed: that fixes it.
        layout: where everything began.
        bodies: what Chipmunk moves.
        model: how pedestrians walk.
        streams: of the pedestrians' legs.
        odometry: of the robots, where it drifts.
    """

    prepared: Prepared
    seed: int
    layout: Layout
    bodies: Bodies
    model: WalkingModel
    streams: list[np.random.Generator]
    odometry: list[DriftingOdometry]
