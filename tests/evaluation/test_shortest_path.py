from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import GOAL, RADIUS, START, grid_search, pillar_scene, random_scene

from crowdbench.evaluation.shortest_path import shortest_path, shortest_route


def length(walls=(), obstacles=(), start=START, goal=GOAL):
    return shortest_path(
        np.asarray(start, dtype=float),
        np.asarray(goal, dtype=float),
        np.array(walls, dtype=float).reshape(-1, 4),
        np.array(obstacles, dtype=float).reshape(-1, 3),
        RADIUS,
    )


def around(distance, radius):
    """Tangent, arc, tangent about a disc midway between two points ``2 distance`` apart."""
    return 2 * (
        math.sqrt(distance**2 - radius**2) + radius * (math.pi / 2 - math.acos(radius / distance))
    )


def test_nothing_in_the_way():
    assert length() == pytest.approx(4.0)


def test_start_is_goal():
    assert length(goal=START) == 0.0


def test_an_obstacle_beside_the_line_does_not_matter():
    assert length(obstacles=[[2.0, 1.0, 0.85]]) == pytest.approx(4.0)
    assert length(obstacles=[[2.0, 1.0, 0.86]]) > 4.0


def test_two_tangents_and_an_arc_around_one_disc():
    expected = 2 * math.sqrt(3) + math.pi / 3
    assert length(obstacles=[[2.0, 0.0, 0.85]]) == pytest.approx(expected)
    assert around(2.0, 1.0) == pytest.approx(expected)


def route(walls=(), obstacles=(), start=START, goal=GOAL):
    shaped = np.array(walls, dtype=float).reshape(-1, 4), np.array(obstacles).reshape(-1, 3)
    return shortest_route(start, np.asarray(goal, dtype=float), *shaped, RADIUS)


def test_a_route_tells_where_it_sets_out_and_how_far_it_turns():
    assert route(goal=[1.0, 1.0]) == pytest.approx((math.sqrt(2), math.pi / 4, 0.0))
    # The disc lies a bit below the line: left at 30 degrees at first, then right by 60.
    found = route(obstacles=[[2.0, -1e-9, 0.85]])
    assert (found.heading, found.turning) == pytest.approx((math.pi / 6, math.pi / 3))
    # A wall that ends above the line, midway: as far back as it was turned away.
    found = route(walls=[[2.0, -9.0, 2.0, 1.0]])
    assert found.turning == pytest.approx(2 * found.heading)
    nowhere = route(goal=START)
    assert (nowhere.length, nowhere.turning) == (0.0, 0.0) and math.isnan(nowhere.heading)


def test_the_nearer_side_of_a_disc_is_taken():
    aside = length(obstacles=[[2.0, 0.2, 0.85]])
    assert aside == pytest.approx(length(obstacles=[[2.0, -0.2, 0.85]]))
    assert aside < around(2.0, 1.0)


def test_between_two_discs_on_opposite_sides_the_path_crosses_over():
    # Point-symmetric about (2, 0): from the start a tangent to the first disc (left of it), an
    # arc, then an inner tangent through the centre of symmetry.
    first = np.array([1.2, 0.5])
    second = np.array([2.8, -0.5])
    radius = 0.6
    to_start, to_middle = np.linalg.norm(first), np.linalg.norm(first - [2.0, 0.0])
    # Angle at the disc's centre between start and middle, on the side that the path passes.
    inner = math.atan2(-first[1], -first[0]), math.atan2(-first[1], 2.0 - first[0])
    arc = (inner[1] - inner[0]) % (2 * math.pi)
    arc -= math.acos(radius / to_start) + math.acos(radius / to_middle)
    half = math.sqrt(to_start**2 - radius**2) + math.sqrt(to_middle**2 - radius**2) + radius * arc
    discs = [[*first, radius - RADIUS], [*second, radius - RADIUS]]
    assert length(obstacles=discs) == pytest.approx(2 * half)


def test_around_the_end_of_a_wall():
    # The wall's end is a disc of the clearance about (2, 1).
    to_end = math.hypot(2.0, 1.0)
    beyond = math.acos(RADIUS / to_end)
    towards_start = math.atan2(-1.0, -2.0) % (2 * math.pi)
    towards_goal = math.atan2(-1.0, 2.0) % (2 * math.pi)
    over = 2 * math.pi - (towards_goal - towards_start)
    expected = 2 * math.sqrt(to_end**2 - RADIUS**2) + RADIUS * (over - 2 * beyond)
    assert length(walls=[[2.0, -3.0, 2.0, 1.0]]) == pytest.approx(expected)


def test_a_wall_in_two_pieces_is_the_same_wall():
    whole = length(walls=[[2.0, -3.0, 2.0, 1.0]])
    assert length(walls=[[2.0, -3.0, 2.0, -1.0], [2.0, -1.0, 2.0, 1.0]]) == pytest.approx(whole)


def test_along_a_wall_that_is_touched():
    assert length(walls=[[1.0, -RADIUS, 3.0, -RADIUS]]) == pytest.approx(4.0)


def test_a_gap_wider_than_the_robot_is_passed_and_a_narrower_one_is_not():
    open_wall = [[2.0, -9.0, 2.0, -0.16], [2.0, 0.16, 2.0, 9.0]]
    narrow = [[2.0, -9.0, 2.0, -0.14], [2.0, 0.14, 2.0, 9.0]]
    assert length(walls=open_wall) == pytest.approx(4.0)
    assert length(walls=narrow) > 18.0


def test_overlapping_discs_are_passed_on_the_outside():
    pair = [[2.0, 0.4, 0.85], [2.0, -0.4, 0.85]]
    assert length(obstacles=pair) > length(obstacles=pair[:1])
    assert length(obstacles=pair) == pytest.approx(length(obstacles=pair[::-1]))


@pytest.mark.parametrize(
    "walls",
    [
        [[2.0, -1.6, 2.0, 1.6]],  # through the disc
        [[2.0, 1.05, 2.0, 1.6], [2.0, -1.05, 2.0, -1.6]],  # ending outside, too near to pass
        [[2.0, -0.9, 2.0, 0.9]],  # ending inside, too near to the edge
        [[1.5, 1.1, 2.5, 1.1], [1.5, -1.1, 2.5, -1.1]],  # beside the disc
    ],
)
def test_a_wall_at_a_disc_closes_the_way_along_its_edge(walls):
    disc = [[2.0, 0.0, 0.85]]
    exact = length(walls, disc)
    assert exact > around(2.0, 1.0) + 1e-3
    grid = grid_search(np.array(walls), np.array(disc))
    assert exact - 1e-3 <= grid <= exact * 1.015 + 0.03


BOX = [[-1, -1, 1, -1], [1, -1, 1, 1], [1, 1, -1, 1], [-1, 1, -1, -1]]


@pytest.mark.parametrize(
    "scene",
    [
        {"walls": BOX},
        {"obstacles": [[0.0, 0.1, 0.3]]},  # the start is inside
        {"obstacles": [[4.0, 0.1, 0.3]]},  # the goal is inside
        {"obstacles": [(1.2 * math.cos(a), 1.2 * math.sin(a), 0.45) for a in range(7)]},
    ],
)
def test_no_path_is_infinitely_long(scene):
    assert length(**scene) == math.inf


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), angle=st.floats(-math.pi, math.pi))
def test_the_length_is_the_same_backwards_and_in_a_turned_frame(seed, angle):
    walls, discs = random_scene(seed)
    there = length(walls, discs)
    assert length(walls, discs, start=GOAL, goal=START) == pytest.approx(there)
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    turned = np.concatenate([walls[:, :2] @ turn, walls[:, 2:] @ turn], axis=1)
    discs = np.concatenate([discs[:, :2] @ turn, discs[:, 2:]], axis=1)
    assert length(turned, discs, START @ turn, GOAL @ turn) == pytest.approx(there)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_an_obstacle_more_never_shortens_the_path(seed):
    walls, discs = random_scene(seed)
    assert length(walls, discs) >= length(walls, discs[:-1]) - 1e-9
    assert length(walls, discs) >= length(walls[:-1], discs) - 1e-9


@pytest.mark.parametrize("seed", range(12))
def test_a_search_on_a_fine_grid_finds_the_same_length(seed):
    """The grid's path is a real path, so never shorter, and at most 1.5 % and 3 cm longer.

    Its 32 directions cost at most 1.3 % on a straight line, its spacing of 2.5 cm the rest.
    """
    walls, discs = random_scene(seed)
    exact = length(walls, discs)
    grid = grid_search(walls, discs)
    assert exact - 1e-3 <= grid <= exact * 1.015 + 0.03


def test_among_pillars_of_many_edges_too():
    """On a coarser grid, whose spacing of 5 cm costs up to 6 cm."""
    walls, discs = pillar_scene(seed=7)
    assert len(walls) == 58
    exact = length(walls, discs)
    assert exact > 4.9
    grid = grid_search(walls, discs, spacing=0.05)
    assert exact - 1e-3 <= grid <= exact * 1.015 + 0.06


def test_edges_of_a_polygon_are_not_doubled_where_they_meet():
    square = np.array([[1.5, -0.5], [2.5, -0.5], [2.5, 0.5], [1.5, 0.5]])
    edges = np.hstack([square, np.roll(square, -1, axis=0)])
    # Around two corners, by a quarter of a turn and two tangents each.
    tangent = math.sqrt(1.5**2 + 0.5**2 - RADIUS**2)
    bend = math.atan2(0.5, 1.5) + math.asin(RADIUS / math.hypot(1.5, 0.5))
    assert length(edges) == pytest.approx(2 * tangent + 2 * RADIUS * bend + 1.0)


def test_the_random_scenes_are_in_the_way():
    lengths = [length(*random_scene(seed)) for seed in range(12)]
    assert sum(value > 4.05 for value in lengths) >= 6
    assert all(math.isfinite(value) for value in lengths)
