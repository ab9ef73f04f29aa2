"""ORCA against an independent implementation, linear programming and what it guarantees."""

import numpy as np
import pyrvo
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from crowdbench.simulation import orca

RADIUS = 0.25
STEP = 0.2
NOTHING = {"obstacles": np.zeros((0, 3)), "walls": np.zeros((0, 4))}


def solve(position, velocity, preferred, max_speed, radius=RADIUS, robot=None, share=0.5, **static):
    """Our velocities; ``robot`` is (position, velocity), seen by everybody."""
    out = np.full_like(position, np.nan)
    robots = np.zeros((0, 2)) if robot is None else np.array([robot[0]], float)
    moving = np.zeros((0, 2)) if robot is None else np.array([robot[1]], float)
    static = NOTHING | static
    orca.orca_velocities(
        position,
        velocity,
        preferred,
        max_speed,
        np.broadcast_to(radius, len(position)).copy(),
        np.ones((len(position), len(robots)), bool),
        robots,
        moving,
        RADIUS,
        share,
        static["obstacles"],
        static["walls"],
        STEP,
        out,
    )
    return out


def solve_pyrvo(position, velocity, preferred, max_speed, radius=(), walls=()):
    simulator = pyrvo.RVOSimulator(
        STEP, orca.NEIGHBOUR_DISTANCE, 100, orca.AGENT_HORIZON, orca.STATIC_HORIZON, RADIUS, 1.0
    )
    for p in range(len(position)):
        agent = simulator.add_agent(tuple(position[p]))
        simulator.set_agent_velocity(agent, tuple(velocity[p]))
        simulator.set_agent_pref_velocity(agent, tuple(preferred[p]))
        simulator.set_agent_max_speed(agent, max_speed[p])
    for agent, around in enumerate(radius):
        simulator.set_agent_radius(agent, around)
    for wall in walls:
        simulator.add_obstacle([tuple(wall[:2]), tuple(wall[2:])])
    if len(walls):
        simulator.process_obstacles()
    simulator.do_step()
    new = [simulator.get_agent_velocity(p) for p in range(len(position))]
    return np.array([(v.x, v.y) for v in new])


def random_scene(rng, people, size):
    return (
        rng.uniform(-size / 2, size / 2, (people, 2)),
        rng.uniform(-1, 1, (people, 2)),
        rng.uniform(-1, 1, (people, 2)),
        rng.uniform(1.0, 1.5, people),
    )


def spaced_scene(rng, people, size):
    """A random scene without overlaps."""
    while True:
        scene = random_scene(rng, people, size)
        gaps = np.linalg.norm(scene[0][:, None] - scene[0], axis=2) + 9 * np.eye(people)
        if gaps.min() > 2 * RADIUS:
            return scene


@pytest.mark.parametrize("size", [3.0, 5.0, 8.0])
def test_velocities_equal_pyrvo_where_nobody_overlaps(size):
    rng = np.random.default_rng(int(size))
    for _ in range(100):
        scene = spaced_scene(rng, 7, size)
        np.testing.assert_allclose(solve(*scene), solve_pyrvo(*scene), atol=1e-4)


def test_velocities_equal_pyrvo_between_walls():
    rng = np.random.default_rng(1)
    walls = np.array([[-50.0, -2.0, 50.0, -2.0], [50.0, 2.0, -50.0, 2.0]])
    for _ in range(100):
        scene = spaced_scene(rng, 5, 3.4)
        ours, theirs = solve(*scene, walls=walls), solve_pyrvo(*scene, walls=walls)
        np.testing.assert_allclose(ours, theirs, atol=1e-4)


def test_velocities_equal_pyrvo_where_people_are_of_different_sizes():
    rng = np.random.default_rng(4)
    walls = np.array([[-50.0, -2.5, 50.0, -2.5], [50.0, 2.5, -50.0, 2.5]])
    for _ in range(100):
        scene = (*spaced_scene(rng, 6, 4.2), rng.uniform(0.1, RADIUS, 6))
        ours, theirs = solve(*scene, walls=walls), solve_pyrvo(*scene, walls=walls)
        np.testing.assert_allclose(ours, theirs, atol=1e-4)


def test_velocities_nearly_equal_pyrvo_in_a_crush():
    """Where bodies overlap everything is infeasible; pyrvo's float32 limits the agreement."""
    rng = np.random.default_rng(2)
    errors = []
    for _ in range(200):
        scene = random_scene(rng, 8, 2.0)
        errors.append(np.abs(solve(*scene) - solve_pyrvo(*scene)).max(axis=1))
    assert np.quantile(errors, 0.99) < 1e-4


def test_the_fallback_is_the_least_violation():
    """Against scipy's linear programming, with the speed limit as a polygon."""
    rng = np.random.default_rng(3)
    angles = np.linspace(0, 2 * np.pi, 256, endpoint=False)
    compared = 0
    for _ in range(60):
        count = 8
        normals = rng.normal(size=(count, 2))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        points = normals * rng.uniform(0.2, 1.5, (count, 1))
        lines = np.column_stack([points, normals[:, 1], -normals[:, 0]])
        failed, x, y = orca._nearest_velocity(lines, count, 1.0, 0.3, 0.1, False)
        if failed == count:
            continue
        compared += 1
        x, y = orca._least_violation(lines, count, 0, failed, 1.0, x, y, np.empty_like(lines))
        ours = np.max(np.sum(normals * (points - [x, y]), axis=1))
        best = linprog(
            [0, 0, 1],
            A_ub=np.vstack(
                [
                    np.column_stack([-normals, -np.ones(count)]),
                    np.column_stack([np.cos(angles), np.sin(angles), np.zeros(256)]),
                ]
            ),
            b_ub=np.concatenate([-np.sum(normals * points, axis=1), np.ones(256)]),
            bounds=[(None, None)] * 3,
        )
        assert np.hypot(x, y) <= 1 + 1e-9
        assert best.fun - 1e-9 <= ours + 2e-4 and ours <= best.fun + 2e-4
    assert compared > 20


def test_alone_a_pedestrian_has_its_preferred_velocity():
    out = solve(np.zeros((1, 2)), np.zeros((1, 2)), np.array([[0.6, 0.2]]), np.array([1.0]))
    np.testing.assert_allclose(out, [[0.6, 0.2]])


def test_the_speed_limit_holds():
    out = solve(np.zeros((1, 2)), np.zeros((1, 2)), np.array([[3.0, 4.0]]), np.array([1.0]))
    np.testing.assert_allclose(out, [[0.6, 0.8]])


def test_a_robot_with_share_one_half_is_treated_like_a_person():
    here, there = np.array([[0.0, 0.0]]), np.array([1.5, 0.1])
    mine, its = np.array([[0.8, 0.0]]), np.array([-0.7, 0.1])
    with_robot = solve(here, mine, mine, np.array([1.0]), robot=(there, its))
    with_person = solve(
        np.vstack([here, there]), np.vstack([mine, its]), np.vstack([mine, its]), np.ones(2)
    )
    np.testing.assert_allclose(with_robot[0], with_person[0])
    assert abs(with_robot[0, 1]) > 0.01


def test_a_larger_share_of_responsibility_means_a_larger_evasion():
    mine = np.array([[0.8, 0.0]])
    evasions = [
        np.linalg.norm(
            solve(
                np.zeros((1, 2)),
                mine,
                mine,
                np.ones(1),
                robot=([1.5, 0.1], [-0.7, 0.0]),
                share=share,
            )
            - mine
        )
        for share in (0.0, 0.25, 0.5, 1.0)
    ]
    assert evasions[0] == pytest.approx(0.0, abs=1e-12)
    assert np.all(np.diff(evasions) > 0.01)


def test_an_unseen_robot_changes_nothing():
    mine, out = np.array([[0.8, 0.0]]), np.empty((1, 2))
    orca.orca_velocities(
        np.zeros((1, 2)),
        mine,
        mine,
        np.ones(1),
        np.full(1, RADIUS),
        np.zeros((1, 1), bool),
        np.array([[0.8, 0.0]]),
        np.array([[-1.0, 0.0]]),
        RADIUS,
        0.5,
        *NOTHING.values(),
        STEP,
        out,
    )
    np.testing.assert_array_equal(out, mine)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_mirrored_scenes_have_mirrored_velocities(seed):
    rng = np.random.default_rng(seed)
    position, velocity, preferred, max_speed = spaced_scene(rng, 5, 5.0)
    obstacles, walls = rng.uniform(4, 5, (2, 3)), rng.uniform(-6, -5, (2, 4))
    obstacles[:, 2] = 0.4
    mirror = np.array([1.0, -1.0])
    flipped = solve(
        position * mirror,
        velocity * mirror,
        preferred * mirror,
        max_speed,
        obstacles=obstacles * [1, -1, 1],
        walls=walls * [1, -1, 1, -1],
    )
    direct = solve(position, velocity, preferred, max_speed, obstacles=obstacles, walls=walls)
    np.testing.assert_allclose(flipped, direct * mirror, atol=1e-7)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_nobody_walks_into_a_wall_or_an_obstacle(seed):
    """Whatever the crowd wants: surfaces stay apart during the whole step."""
    rng = np.random.default_rng(seed)
    walls = np.array([[-4.0, -1.5, 4.0, -1.5], [-4.0, 1.5, 4.0, 1.5], [1.0, 1.5, 1.0, 0.9]])
    obstacles = np.array([[-1.0, 0.0, 0.3], [2.5, 0.2, 0.3]])
    position, velocity, preferred, max_speed = spaced_scene(rng, 4, 2.2)
    position[:, 0] -= 2.7
    for _ in range(40):
        preferred = rng.uniform(-1.5, 1.5, preferred.shape)
        preferred[:, 0] += 0.6
        velocity = solve(position, velocity, preferred, max_speed, obstacles=obstacles, walls=walls)
        position = position + STEP * velocity
        assert wall_gaps(position, walls).min() > RADIUS - 1e-6
        gaps = np.linalg.norm(position[:, None] - obstacles[:, :2], axis=2) - obstacles[:, 2]
        assert gaps.min() > RADIUS - 1e-6


def wall_gaps(position, walls):
    points = shapely.points(position)
    return np.array(
        [[shapely.LineString(w.reshape(2, 2)).distance(p) for w in walls] for p in points]
    )


def test_a_wall_does_not_slow_those_who_walk_along_it():
    walls = np.array([[-10.0, 0.0, 10.0, 0.0]])
    along = np.array([[1.0, 0.0]])
    out = solve(np.array([[0.0, 0.26]]), along, along, np.ones(1), walls=walls)
    np.testing.assert_allclose(out, along, atol=1e-12)


def test_a_wall_end_is_a_corner_one_can_walk_around():
    walls = np.array([[0.0, 0.0, 0.0, -5.0]])
    position, velocity, goal = np.array([[-2.0, -0.2]]), np.zeros((1, 2)), np.array([[2.0, 0.3]])
    for _ in range(60):
        velocity = solve(position, velocity, goal - position, np.ones(1), walls=walls)
        position = position + STEP * velocity
        assert wall_gaps(position, walls).min() > RADIUS - 1e-6
    np.testing.assert_allclose(position, goal, atol=0.01)
