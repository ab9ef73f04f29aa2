from __future__ import annotations

import numpy as np
import pytest
from scenes import RADIUS, pillar_scene, random_scene

from crowdbench.simulation.clearance import sees
from crowdbench.simulation.visibility import cell_at
from crowdbench.simulation.ways import Ways


def listed(network, x, y):
    """Way points that may be seen from a place."""
    visibility = network.visibility
    cell = cell_at(x, y, visibility)
    return visibility.seen[visibility.begin[cell] : visibility.begin[cell + 1]].tolist()


def seen(network, x, y):
    """Those that are, one by one."""
    fixed = network.cores, network.reach, 1.0
    return [k for k, node in enumerate(network.nodes) if sees(x, y, *node, *fixed)]


@pytest.mark.parametrize("scene", [random_scene, pillar_scene])
@pytest.mark.parametrize("seed", range(10))
def test_nothing_that_is_seen_is_left_out(scene, seed):
    network = Ways(*scene(seed), RADIUS).network
    rng = np.random.default_rng(seed)
    corner, side = network.visibility.corner, network.visibility.side
    places = rng.uniform([-0.5, -2.5], [4.5, 2.5], (40, 2))
    places[::2] = corner + side * np.round((places[::2] - corner) / side)  # corners of cells
    # Just off walls, where who is nearer than its reach may leave.
    beside = network.cores[:, :2] + rng.normal(0, 0.02, (len(network.cores), 2))
    for x, y in [*places, *beside]:
        assert set(seen(network, x, y)) <= set(listed(network, x, y))


def test_most_of_what_walls_hide_is_left_out():
    found = np.zeros(3)
    for seed in range(5):
        network = Ways(*pillar_scene(seed), RADIUS).network
        for x, y in np.random.default_rng(seed).uniform([0, -2], [4, 2], (40, 2)):
            near = listed(network, x, y)
            assert near == sorted(near)
            found += len(seen(network, x, y)), len(near), len(network.nodes)
    visible, listed_ones, all_of_them = found
    assert listed_ones - visible < 0.5 * (all_of_them - visible)


def test_from_outside_of_all_cells_everything_may_be_seen():
    network = Ways(*pillar_scene(0), RADIUS).network
    assert listed(network, 1e6, 0.0) == listed(network, 0.0, -1e6)
    assert listed(network, 1e6, 0.0) == list(range(len(network.nodes)))


def test_without_walls_there_is_nothing_to_see():
    network = Ways(np.empty((0, 4)), np.empty((0, 3)), RADIUS).network
    assert listed(network, 0.0, 0.0) == []
