from __future__ import annotations

import numpy as np
import pytest
import shapely
from scenes import RADIUS, random_scene

from crowdbench.simulation.clearance import find_clear, gap_between, sees
from crowdbench.simulation.ways import Ways


@pytest.mark.parametrize("seed", range(5))
def test_gaps_between_segments_are_shapelys(seed):
    ends = np.random.default_rng(seed).uniform(-1, 1, (200, 8))
    lines = shapely.linestrings(ends.reshape(-1, 2, 2, 2))
    expected = shapely.distance(lines[:, 0], lines[:, 1])
    assert [gap_between(*row) for row in ends] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_a_place_is_seen_where_the_straight_line_keeps_its_distance(share):
    seen = 0
    for seed in range(20):
        walls, discs = random_scene(seed)
        network = Ways(walls, discs, RADIUS).network
        solids = [
            *shapely.linestrings(walls.reshape(-1, 2, 2)),
            *shapely.points(discs[:, :2]),
        ]
        for a, b in np.random.default_rng(seed).uniform([0, -2], [4, 2], (30, 2, 2)):
            gaps = shapely.distance(shapely.LineString([a, b]), solids)
            ends = [shapely.distance(shapely.Point(end), solids) for end in (a, b)]
            # Who is nearer than that may leave, as near as it is.
            free = (gaps >= np.minimum(share * network.reach, np.minimum(*ends)) - 1e-9).all()
            assert sees(*a, *b, network.cores, network.reach, share) == free
            seen += free
    assert 50 < seen < 550


@pytest.mark.parametrize("seed", range(5))
def test_clear_lines_are_those_that_shapely_finds_far_enough_away(seed):
    rng = np.random.default_rng(seed)
    begin, cores, reach = rng.uniform(-3, 3, (300, 2)), rng.uniform(-3, 3, (8, 4)), np.full(8, 0.2)
    end = begin + rng.normal(0, 1, begin.shape)
    cores[:2, 2:] = cores[:2, :2]  # round ones
    low, high = np.minimum(cores[:, :2], cores[:, 2:]), np.maximum(cores[:, :2], cores[:, 2:])
    clear = np.empty(len(begin), dtype=np.bool_)
    find_clear(begin, end, np.hstack([cores, low - 0.2, high + 0.2]), reach, clear)
    lines, walls = shapely.linestrings(np.stack([begin, end], 1)), cores.reshape(-1, 2, 2)
    expected = shapely.distance(lines[:, None], [*map(shapely.LineString, walls.tolist())]) >= 0.2
    assert clear.tolist() == expected.all(axis=1).tolist()
    assert 0 < clear.sum() < len(clear)
