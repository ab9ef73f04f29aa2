"""Social force: what the equations promise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench.simulation import social_force

RADIUS = 0.25
STEP = 0.2


def solve(
    position, velocity, preferred, *, robot=None, share=0.5, limit=2.0, step=STEP, radius=RADIUS,
    **static,
):  # fmt: skip
    position, velocity, preferred = (
        np.atleast_2d(a).astype(float) for a in (position, velocity, preferred)
    )
    out = np.full_like(position, np.nan)
    robots = np.zeros((0, 2)) if robot is None else np.array([robot[0]], float)
    moving = np.zeros((0, 2)) if robot is None else np.array([robot[1]], float)
    social_force.social_force_velocities(
        position,
        velocity,
        preferred,
        np.full(len(position), limit),
        np.broadcast_to(radius, len(position)).copy(),
        np.ones((len(position), len(robots)), bool),
        robots,
        moving,
        RADIUS,
        share,
        static.get("obstacles", np.zeros((0, 3))),
        static.get("walls", np.zeros((0, 4))),
        step,
        out,
    )
    return out


def test_alone_a_pedestrian_relaxes_to_the_preferred_velocity():
    velocity = np.zeros((1, 2))
    errors = []
    for _ in range(30):
        velocity = solve([0, 0], velocity, [0.8, -0.3])
        errors.append(np.linalg.norm(velocity - [0.8, -0.3]))
    # Each step leaves the share 1 - step / tau of the difference.
    assert errors[1] / errors[0] == pytest.approx(1 - STEP / social_force.RELAXATION_TIME)
    assert errors[-1] < 1e-5


def test_one_neighbour_by_hand():
    """Nobody moves: D = e_ij and theta = 0, so both back off along the line between them."""
    out = solve([[0, 0], [1.2, 0.8]], np.zeros((2, 2)), np.zeros((2, 2)), step=1.0, limit=9.0)
    distance = np.hypot(1.2, 0.8)
    force = -4.5 * np.exp(-distance / 0.35) * np.array([1.2, 0.8]) / distance
    np.testing.assert_allclose(out[0], force, rtol=1e-12)
    np.testing.assert_allclose(out[1], -force, rtol=1e-12)


def test_a_larger_neighbour_is_nearer_by_what_its_radius_exceeds_ones_own():
    """The parameters hold for people of one size: the gap between surfaces decides."""
    place, still = [[0, 0], [1.2, 0.8]], np.zeros((2, 2))
    out = solve(place, still, still, step=1.0, limit=9.0, radius=[0.2, 0.35])
    distance = np.hypot(1.2, 0.8)
    for p, larger in ((0, 0.15), (1, -0.15)):
        force = 4.5 * np.exp(-(distance - larger) / 0.35)
        assert np.linalg.norm(out[p]) == pytest.approx(force)


def test_a_neighbour_to_the_side_by_hand():
    """Walking along x at 1 m/s, somebody stands at (0, 1): D = (2, 1), theta = atan(2)."""
    out = solve([[0, 0], [0, 1]], [[1, 0], [0, 0]], [[1, 0], [0, 0]], step=1.0, limit=9.0)
    theta, B = np.arctan(2.0), 0.35 * np.sqrt(5.0)
    strength = 4.5 * np.exp(-1.0 / B)
    t = np.array([2.0, 1.0]) / np.sqrt(5.0)
    n = np.array([-t[1], t[0]])
    force = -strength * (np.exp(-((3 * B * theta) ** 2)) * t + np.exp(-((2 * B * theta) ** 2)) * n)
    np.testing.assert_allclose(out[0], np.array([1.0, 0.0]) + force, rtol=1e-12)


def test_a_head_on_meeting_is_symmetric():
    out = solve([[-1, 0.1], [1, -0.1]], [[1, 0], [-1, 0]], [[1, 0], [-1, 0]])
    np.testing.assert_allclose(out[0], -out[1], atol=1e-12)
    assert out[0, 1] > 0.01  # each to the side on which it has more room


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_mirrored_scenes_have_mirrored_velocities(seed):
    rng = np.random.default_rng(seed)
    position, velocity, preferred = rng.uniform(-3, 3, (3, 5, 2))
    obstacles, walls = rng.uniform(0.1, 3, (2, 3)), rng.uniform(-4, 4, (2, 4))
    mirror = np.array([1.0, -1.0])
    direct = solve(position, velocity, preferred, obstacles=obstacles, walls=walls)
    flipped = solve(
        position * mirror,
        velocity * mirror,
        preferred * mirror,
        obstacles=obstacles * [1, -1, 1],
        walls=walls * [1, -1, 1, -1],
    )
    np.testing.assert_allclose(flipped, direct * mirror, atol=1e-9)
    assert np.linalg.norm(direct, axis=1).max() <= 2.0 + 1e-12


@pytest.mark.parametrize("y", [0.3, 0.5, -0.3])
def test_walls_repel_the_more_the_nearer(y):
    wall = np.array([[-5.0, 0.0, 5.0, 0.0]])
    near = solve([0, y], [0, 0], [0, 0], walls=wall)[0]
    far = solve([0, 1.5 * y], [0, 0], [0, 0], walls=wall)[0]
    assert near[0] == pytest.approx(0.0)
    assert near[1] * np.sign(y) > far[1] * np.sign(y) > 0


def test_the_wall_force_at_contact_by_hand():
    wall = np.array([[-5.0, 0.0, 5.0, 0.0]])
    out = solve([0, RADIUS + 0.1], [0, 0], [0, 0], walls=wall, step=1.0)
    np.testing.assert_allclose(out, [[0, 3.0 * np.exp(-1.0)]])


@given(
    st.floats(-6, 6), st.floats(0.01, 1), st.lists(st.integers(-19, 19), max_size=6, unique=True)
)
@settings(max_examples=40, deadline=None)
def test_a_wall_in_pieces_repels_as_often_as_a_whole_one(x, y, cuts):
    ends = np.array([-5.0, *sorted(cut / 4 for cut in cuts), 5.0])
    pieces = np.column_stack([ends[:-1], 0 * ends[1:], ends[1:], 0 * ends[1:]])
    pieces[::2] = pieces[::2, [2, 3, 0, 1]]
    whole = solve([x, y], [0, 0], [0, 0], walls=np.array([[-5.0, 0.0, 5.0, 0.0]]))
    np.testing.assert_allclose(solve([x, y], [0, 0], [0, 0], walls=pieces), whole, atol=1e-12)


@pytest.mark.parametrize("turned", [0, 1, 2, 3])
def test_a_corner_repels_once_from_outside_and_by_both_walls_from_inside(turned):
    corners = np.roll([[0, 0], [2, 0], [2, 2], [0, 2]], turned, axis=0)
    square = np.hstack([corners, np.roll(corners, -1, axis=0)]).astype(float)
    outside = solve([-0.3, -0.4], [0, 0], [0, 0], walls=square, step=1.0)
    far = 3.0 * np.exp(-(0.5 - RADIUS) / 0.1) * np.array([[-0.6, -0.8]])
    np.testing.assert_allclose(outside, far, atol=1e-12)
    inside = solve([0.3, 0.3], [0, 0], [0, 0], walls=square, step=1.0, limit=9.0)
    near, across = np.exp(-(0.3 - RADIUS) / 0.1), np.exp(-(1.7 - RADIUS) / 0.1)
    np.testing.assert_allclose(inside, np.full((1, 2), 3.0 * (near - across)), atol=1e-12)


def test_an_obstacle_repels_like_a_wall_at_the_same_gap():
    obstacle = solve([0, 1.0], [0, 0], [0, 0], obstacles=np.array([[0.0, 0.0, 0.4]]))
    wall = solve([0, 1.0], [0, 0], [0, 0], walls=np.array([[-5.0, 0.4, 5.0, 0.4]]))
    np.testing.assert_allclose(obstacle, wall, atol=1e-12)


def test_a_robot_with_share_one_half_is_treated_like_a_person():
    person = solve([[0, 0], [1.5, 0.1]], [[0.8, 0], [-0.7, 0]], [[0.8, 0], [-0.7, 0]])[0]
    robot = solve([0, 0], [0.8, 0], [0.8, 0], robot=([1.5, 0.1], [-0.7, 0]))[0]
    ignored = solve([0, 0], [0.8, 0], [0.8, 0], robot=([1.5, 0.1], [-0.7, 0]), share=0.0)[0]
    np.testing.assert_allclose(robot, person)
    np.testing.assert_allclose(ignored, [0.8, 0])
    assert np.linalg.norm(robot - ignored) > 0.01
