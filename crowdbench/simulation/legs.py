"""Legs of people in some lanes, with routes and without."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from crowdbench.simulation.chipmunk import FUNCTIONS
from crowdbench.simulation.following import begin_routes, follow
from crowdbench.simulation.lanes import POINTS, State
from crowdbench.simulation.pedestrians import begin_legs, decide
from crowdbench.simulation.routes import Routes


def begin(
    lane: int,
    state: State,
    stage: NDArray[np.int64],
    first: NDArray[np.int64],
    routes: Routes | None,
) -> None:
    """Begin the first leg of everybody in a lane.

    Args:
        lane: which; its people have places and draws.
        state: of all lanes.
        stage: (P,) regions on the way of its stream that each has passed.
        first: (P,) the person with whom each walks, itself or the first of its group.
        routes: of the lane's scenario.
    """
    if routes is None:
        begin_legs(lane, state.worlds, state.people, state.obstacles, state.draws)
        return
    walks = state.walks[lane, : len(stage)]
    walks["stream"], walks["stage"], walks["waiting"] = routes.member[first], stage, 0
    begin_routes(
        lane,
        state.worlds,
        state.people,
        state.walks,
        state.obstacles,
        state.draws,
        routes.network,
        routes.regions,
    )


def ways(lane: int, state: State, count: int, routes: Routes | None) -> NDArray[np.float64]:
    """(count, POINTS, 2) next points of people's ways, the last one repeated; else goals [m]."""
    if routes is None:
        return np.repeat(state.people["goal"][lane, :count, None], POINTS, axis=1)
    walks = state.walks[lane, :count]
    which = np.minimum(walks["at"][:, None] + np.arange(POINTS), walks["count"][:, None] - 1)
    return np.asarray(np.take_along_axis(walks["points"], which[..., None], axis=1))


def choose_legs(lanes: NDArray[np.int64], state: State, routes: Sequence[Routes | None]) -> bool:
    """Switch, finish and begin legs that are due, and say how everybody would like to walk.

    Args:
        lanes: (M,) which.
        state: of all lanes.
        routes: of each of these lanes.

    Returns:
        Somebody has no draws left for another leg.
    """
    exhausted = False
    for one in {id(one): one for one in routes}.values():
        which = lanes[np.array([other is one for other in routes])]
        common = which, state.worlds, state.robots, state.people, state.obstacles
        rest = state.sees, state.draws
        if one is None:
            exhausted |= decide(*common, *rest)
        else:
            exhausted |= follow(*common, state.walks, *rest, FUNCTIONS, one.network, one.regions)
    return exhausted
