"""Where a disc has room, against shapely."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from map_scenarios import hall

from crowdbench.scenario import Arena
from crowdbench.simulation.ground import Ground
from crowdbench.simulation.walls import walls_of

METRES = st.floats(-3, 3)
WALLS = st.lists(st.tuples(METRES, METRES, METRES, METRES), max_size=4)
BOXES = st.lists(st.tuples(METRES, METRES, st.floats(0.1, 2), st.floats(0.1, 2)), max_size=3)


def box(x, y, length, width):
    return ((x, y), (x + length, y), (x + length, y + width), (x, y + width))


def solids(arena):
    """Everything that a disc must not touch, the border included."""
    lines = [shapely.LineString([wall[:2], wall[2:]]) for wall in arena.walls]
    shapes = [shapely.Polygon(polygon) for polygon in arena.polygons]
    return shapely.union_all([*lines, *shapes, shapely.box(*arena.bounds).exterior])


@settings(max_examples=40, deadline=None)
@given(WALLS, BOXES, st.floats(0.05, 0.6), METRES)
@example([(0.0, 0.0, 0.0, 1e-192)], [], 0.5, 0.0)
def test_a_disc_fits_wherever_a_place_is_drawn_and_cells_that_are_left_out_are_too_near(
    walls, boxes, radius, x
):
    walls = [wall for wall in walls if wall[:2] != wall[2:]]
    arena = Arena(
        kind="map", length=6, width=5, walls=walls, polygons=[box(*b) for b in boxes], centre=(x, 1)
    )
    scenario = hall().model_copy(update={"arena": arena})
    ground = Ground(arena, walls_of(scenario), 0.6)
    free, blocked = ground.free(radius), solids(arena)
    spots = ground.spots(free)
    if len(spots.corner):
        places = spots.draw(np.random.default_rng(0), 200)
        assert shapely.distance(blocked, shapely.points(places)).min() >= radius - 1e-9
        assert shapely.box(*arena.bounds).contains(shapely.MultiPoint(places))
    others = ground.spots(~free)
    if len(others.corner):
        centres = others.corner + others.side / 2
        assert shapely.distance(blocked, shapely.points(centres)).max() < radius + others.side


def test_a_large_area_has_larger_cells():
    arena = Arena(kind="map", length=200, width=200)
    ground = Ground(arena, np.array([[-50.0, 0.0, 50.0, 0.0]]), 0.5)
    assert ground.side == pytest.approx(200 / np.sqrt(2_000_000))
    assert ground.gap.size <= 2_000_000


@pytest.mark.parametrize(("gap", "rooms"), [(0.62, 2), (0.48, 3)])
def test_rooms_are_connected_where_a_disc_passes(gap, rooms):
    walls = np.array([[0, -2, 0, -gap / 2], [0, gap / 2, 0, 2], [1, -2, 1, 2]], dtype=float)
    labels = Ground(Arena(kind="map", length=6, width=4), walls, 0.3).connected(0.25)
    assert labels.max() == rooms


def test_a_region_holds_the_cells_that_lie_in_it_as_a_whole():
    ground = Ground(Arena(kind="map", length=4, width=4), np.empty((0, 4)), 0.1)
    assert ground.within((-1.0, 0.0, 1.0, 0.5)).sum() == 40 * 10
    triangle = ((-1.0, 0.0), (1.0, 0.0), (1.0, 2.0))
    corner = ground.spots(ground.within(triangle)).corner
    shape = shapely.Polygon(triangle)
    for dx, dy in ((0, 0), (0.05, 0), (0, 0.05), (0.05, 0.05)):
        assert shapely.distance(shape, shapely.points(corner + [dx, dy])).max() < 1e-9
    assert len(corner) * 0.05**2 == pytest.approx(shape.area, rel=0.05)


def test_places_are_spread_evenly():
    ground = Ground(Arena(kind="map", length=4, width=4), np.empty((0, 4)), 0.1)
    spots = ground.spots(ground.within((-1.0, -1.0, 1.0, 1.0)))
    places = spots.draw(np.random.default_rng(0), 4000)
    counts, _, _ = np.histogram2d(*places.T, bins=4, range=[[-1, 1], [-1, 1]])
    assert counts.sum() == 4000
    assert abs(counts - 250).max() < 5 * np.sqrt(250)


def ground_of(polygons):
    arena = Arena(kind="map", length=8, width=8, polygons=polygons)
    return Ground(arena, walls_of(hall().model_copy(update={"arena": arena})), 0.6)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(METRES, METRES), min_size=2, max_size=4), st.floats(0.05, 0.5))
@example([(-2.0, 2.0), (2.0, -2.0)], 0.35)
@example([(-2.0, 0.01), (2.0, 0.01)], 0.35)
def test_a_passage_as_wide_as_is_said_joins_its_ends_however_it_bends(bends, gap):
    assume(len(set(bends)) == len(bends))
    passage = shapely.LineString(bends).buffer(ground_of([]).joining(gap) / 2, quad_segs=32)
    block = shapely.box(-3.9, -3.9, 3.9, 3.9).difference(passage)
    # Cut in two, since polygons have no holes.
    halves = [block.intersection(shapely.box(x, -4, x + 4, 4)) for x in (-4, 0)]
    parts = [p for half in halves for p in shapely.get_parts(half) if p.geom_type == "Polygon"]
    whole = [part.exterior.coords[:-1] for part in parts if not part.interiors]
    assume(len(whole) == len(parts) and len(whole) > 0)
    ground = ground_of(whole)
    areas = ground.connected(gap)
    first, last = (areas[ground.at(bends[k])] for k in (0, -1))
    assert np.intersect1d(first[first > 0], last[last > 0]).size


@settings(max_examples=40, deadline=None)
@given(METRES, METRES, st.floats(0.05, 0.5), st.floats(0.0, 1.5))
@example(0.0, 0.0, 0.35, 0.0)
def test_a_place_as_wide_as_is_said_has_room(x, y, radius, turn):
    across = ground_of([]).holding / 2
    side = across / np.cos(np.pi / 12) * (1 + 1e-9)
    angles = turn + np.arange(12) * np.pi / 6
    region = np.column_stack([x + side * np.cos(angles), y + side * np.sin(angles)])
    edge = across + radius  # of a room around the place
    boxes = [(x - edge - 0.5, y - edge, 0.5, 2 * edge), (x + edge, y - edge, 0.5, 2 * edge)]
    boxes += [(x - edge, y - edge - 0.5, 2 * edge, 0.5), (x - edge, y + edge, 2 * edge, 0.5)]
    ground = ground_of([box(*one) for one in boxes])
    assert (ground.within(tuple(map(tuple, region.tolist()))) & ground.free(radius)).any()
