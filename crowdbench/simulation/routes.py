"""Routes: the places that people walk between, and the ways there, of a whole scenario.

People have routes on maps and where there are streams. Elsewhere nothing is in the way that is not
avoided on the spot.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Scenario, ScenarioError
from crowdbench.scenario.places import corners
from crowdbench.scenario.streams import MOST_VIA, Stream, stream_sizes
from crowdbench.simulation.ground import Ground, Mask
from crowdbench.simulation.traits import places_in_line
from crowdbench.simulation.walls import walls_of
from crowdbench.simulation.ways import Network, Ways

MARGINS = (0.2, 0.1, 0.05, 0.0)
"""What people like to keep from walls beside their radius, where passages are wide enough [m]."""
SQUARE = 0.25
"""Side of the squares in which people who draw nothing are told of places [m]."""
_SAMPLE = 12
"""Places of a region between which ways are looked for."""

Reals = NDArray[np.float64]
Wholes = NDArray[np.int64]


class Regions(NamedTuple):
    """What people may draw, as compiled functions take it.

    A *table* is the places of a region that one stream may draw; the last one is those that people
    without a stream may.

    Attributes:
        corner: (C, 2) lower left corners of squares in which places lie, of all tables [m].
        side: of the squares [m].
        outline: (Q, 2) corners of the tables' regions [m].
        tables: (T + 1, 2) where in ``corner`` and in ``outline`` each table begins.
        streams: (N, 4 + MOST_VIA) connected area of each, number of its stops, table of its start,
            tables of its stops: regions on the way, then the goal.
    """

    corner: Reals
    side: float
    outline: Reals
    tables: Wholes
    streams: Wholes


class Routes(NamedTuple):
    """All of a scenario.

    Attributes:
        network: where the ways lead.
        regions: what may be drawn.
        member: (P,) stream of every person, -1 without one.
        places: (N, S, K, 3) the same as squares of 0.25 m, for each stream and each of its start,
            regions on the way and goal: x, y of the middle of what may be drawn of each [m], and
            its share of the region; zeros where there are fewer regions or squares.
    """

    network: Network
    regions: Regions
    member: Wholes
    places: Reals


def has_routes(scenario: Scenario) -> bool:
    """Whether people follow ways."""
    people = scenario.pedestrians
    if not people.count or people.recording.file:
        return False
    return scenario.arena.kind == "map" or bool(people.streams)


def routes_of(scenario: Scenario) -> Routes | None:
    """Of a scenario; None where people need none.

    Raises:
        ScenarioError: a region of a stream has no room, or no way leads through its regions or to
            a queue; the message names the field and what is allowed.
    """
    return _routes(_Same(scenario)) if has_routes(scenario) else None


class _Same:
    """A scenario as a key: equal to those with the same arena, robots and people."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        parts = scenario.arena, scenario.robots, scenario.pedestrians
        self._key = "".join(part.model_dump_json() for part in parts)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


@lru_cache(maxsize=64)
def _routes(same: _Same) -> Routes:
    scenario = same.scenario
    arena, people = scenario.arena, scenario.pedestrians
    walls = walls_of(scenario)
    radius = people.radii[1]
    ground = Ground(arena, walls, radius)
    # What is connected here is wide enough for people for certain, whatever their ways touch.
    from scipy import ndimage  # here, since few scenarios have routes

    areas = np.asarray(ndimage.label(ground.free(radius))[0])
    tables: list[Mask] = []
    outlines: list[Reals] = []
    streams = np.zeros((len(people.streams), 4 + MOST_VIA), dtype=np.int64)
    for i, stream in enumerate(people.streams):
        names = [stream.start, *stream.via, stream.goal]
        regions = [ground.within(arena.regions[name]) for name in names]
        area = _common_area(scenario, ground, i, stream, [areas[region] for region in regions])
        streams[i, 0], streams[i, 1] = area, len(names) - 1
        streams[i, 2 : 2 + len(names)] = len(tables) + np.arange(len(names))
        tables += [region & (areas == area) for region in regions]
        outlines += [np.array(corners(arena.regions[name])) for name in names]
    tables.append(areas == _main_area(scenario, ground, areas))
    _require_reached(scenario, ground, tables[-1])
    outlines.append(np.empty((0, 2)))
    spots = [ground.spots(table) for table in tables]
    begins = [np.cumsum([0, *map(len, rows)]) for rows in ([s.corner for s in spots], outlines)]
    lowest = [spot.corner for spot in spots]
    return Routes(
        network=_ways(scenario, walls, streams, lowest).network,
        regions=Regions(
            corner=np.concatenate([spot.corner for spot in spots]),
            side=ground.side,
            outline=np.concatenate(outlines),
            tables=np.column_stack(begins),
            streams=streams,
        ),
        member=_members(scenario),
        places=_places(streams, [corner + ground.side / 2 for corner in lowest]),
    )


def _common_area(
    scenario: Scenario,
    ground: Ground,
    index: int,
    stream: Stream,
    areas: list[NDArray[np.int32]],
) -> int:
    """The connected area in which a stream walks: of those in all its regions the largest.

    Raises:
        ScenarioError: there is none.
    """
    where = f"scenario {scenario.name!r}: pedestrians.streams.{index}"
    radius = scenario.pedestrians.radii[1]
    fields = ["start", *["via"] * len(stream.via), "goal"]
    common = np.unique(areas[0][areas[0] > 0])
    for field, name, found in zip(
        fields, [stream.start, *stream.via, stream.goal], areas, strict=True
    ):
        if not (found > 0).any():
            raise ScenarioError(
                f"{where}.{field}: the region {name!r} has no room for a person; allowed: "
                f"with a place in it, {ground.holding:.2f} m wide, at least {radius:g} m from "
                "walls, polygons and the border"
            )
        common = np.intersect1d(common, found)
        if not len(common):
            wide = ground.joining(radius + ground.margin)
            raise ScenarioError(
                f"{where}.{field}: no way leads to {name!r} from {stream.start!r}; allowed: "
                f"passages {wide:.2f} m wide or more, for people of pedestrians.radius {radius:g} m"
            )
    sizes = [(areas[0] == area).sum() for area in common]
    return int(common[np.argmax(sizes)])


def _main_area(scenario: Scenario, ground: Ground, areas: NDArray[np.int32]) -> int:
    """The connected area in which people walk who are in no stream: the robots', or the largest."""
    start = scenario.robots.start
    found = areas
    if start is not None:
        regions = scenario.arena.regions
        found = areas[ground.within(regions[start]) if isinstance(start, str) else ground.at(start)]
    counts = np.bincount(found[found > 0])
    return int(np.argmax(counts)) if len(counts) else 1


def _require_reached(scenario: Scenario, ground: Ground, main: Mask) -> None:
    """Refuse queues to which no way leads from where people walk who are in no stream.

    Raises:
        ScenarioError: there is one.
    """
    radius = scenario.pedestrians.radii[1]
    walkable = ground.connected(radius)  # in line people may be nearer to walls than they walk
    reached = np.unique(walkable[main])
    wide = ground.joining(radius + ground.margin)
    for q, queue in enumerate(scenario.pedestrians.queues):
        for k, (x, y) in enumerate(queue.places()):
            if not np.isin(walkable[ground.at((x, y))], reached).any():
                raise ScenarioError(
                    f"scenario {scenario.name!r}: pedestrians.queues: no way leads to place "
                    f"{k + 1} of queue {q + 1}, ({x:.2f}, {y:.2f}), from where people walk; "
                    f"allowed: passages {wide:.2f} m wide or more, for people of "
                    f"pedestrians.radius {radius:g} m"
                )


def _ways(scenario: Scenario, walls: Reals, streams: Wholes, places: list[Reals]) -> Ways:
    """Ways with the largest margin that leaves a way wherever there is one without it."""
    pairs = [
        (places[a], places[b]) for row in streams.tolist() for a, b in pairwise(row[2 : 3 + row[1]])
    ]
    if scenario.arena.kind == "map":
        pairs.append((places[-1], places[-1]))
    if scenario.pedestrians.queues:
        pairs.append((places[-1], places_in_line(scenario.pedestrians)))
    for margin in MARGINS:
        ways = Ways(
            walls,
            np.empty((0, 3)),
            scenario.pedestrians.radii[1] + margin,
            scenario.arena.bounds,
        )
        if all(_connected(ways, *pair) for pair in pairs):
            break
    return ways


def _connected(ways: Ways, starts: Reals, goals: Reals) -> bool:
    """Whether ways lead from some of the starts to some of the goals."""
    some = np.linspace(0, len(starts) - 1, _SAMPLE).astype(np.int64)
    others = np.linspace(0, len(goals) - 1, _SAMPLE).astype(np.int64)
    return all(
        ways.length(start, goal) < math.inf
        for start, goal in zip(starts[some], goals[others[::-1]], strict=True)
    )


def _places(streams: Wholes, tables: list[Reals]) -> Reals:
    """(N, S, K, 3) see ``Routes``, from the middles (C, 2) of all small squares of each table."""
    regions = [[_squares(tables[t]) for t in row[2 : 3 + row[1]]] for row in streams.tolist()]
    most = max((len(squares) for stops in regions for squares in stops), default=0)
    places = np.zeros((len(regions), max(map(len, regions), default=0), most, 3))
    for i, stops in enumerate(regions):
        for k, squares in enumerate(stops):
            places[i, k, : len(squares)] = squares
    return places


def _squares(middles: Reals) -> Reals:
    """(K, 3) mean and share of those of the points (C, 2) that lie in the same square."""
    cells = np.floor(middles / SQUARE)
    _, which, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    mean = [np.bincount(which.ravel(), axis) / count for axis in middles.T]
    return np.column_stack([*mean, count / len(middles)])


def _members(scenario: Scenario) -> Wholes:
    """(P,) stream of every person: after those of queues the first ones walk in the first one."""
    member = np.full(scenario.pedestrians.count, -1, dtype=np.int64)
    first = sum(queue.count + 1 for queue in scenario.pedestrians.queues)
    for i, size in enumerate(stream_sizes(scenario.pedestrians)):
        member[first : first + size] = i
        first += size
    return member
