"""Alternating minimisation: distances and slopes against geometry, plans against their promises."""

import numpy as np
import pytest
import shapely
from crowdbench_agents.neupan.dune import Footprint
from crowdbench_agents.neupan.nrmp import Limits, Weights
from crowdbench_agents.neupan.pan import FAR, Pan, Scene

PERIOD, HORIZON = 0.2, 8
ROBOT = np.array([[0.2, 0.15], [-0.2, 0.15], [-0.2, -0.15], [0.2, -0.15]])
FOOTPRINT = Footprint.from_corners(ROBOT)
LIMITS = Limits(np.array([0.0, -1.5]), np.array([1.0, 1.5]), None)
WEIGHTS = Weights(
    q_position=0.5, q_heading=0.3, p_speed=1.0, proximal=0.1, smooth=0.1, eta=2.5, rho=4000.0,
    d_min=0.1, d_max=0.5,
)  # fmt: skip


def planner(step_points=3, iterations=2, line_search=True, moving_scale=1.0):
    return Pan(
        FOOTPRINT, FOOTPRINT, PERIOD, LIMITS, WEIGHTS, HORIZON, step_points, iterations, 0.01,
        line_search, moving_scale,
    )  # fmt: skip


def scene(points, velocity=None):
    """Points around a robot that wants to go straight ahead at 1 m/s, and does."""
    points = np.array(points, dtype=float).reshape(-1, 2)
    reference = np.zeros((HORIZON, 3))
    reference[:, 0] = PERIOD * np.arange(1, HORIZON + 1)
    velocity = np.zeros_like(points) if velocity is None else np.array(velocity, dtype=float)
    return Scene(points, velocity, reference, np.ones(HORIZON), np.array([1.0, 0.0]))


def body(state):
    x, y, heading = state
    c, s = np.cos(heading), np.sin(heading)
    return shapely.Polygon(ROBOT @ np.array([[c, s], [-s, c]]) + [x, y])


def drives(count, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield np.column_stack([rng.uniform(0, 1, HORIZON), rng.uniform(-1.5, 1.5, HORIZON)])


def crowd(seed=1, count=20):
    rng = np.random.default_rng(seed)
    return rng.uniform([0.6, -1.5], [2.5, 1.5], (count, 2)), rng.normal(0, 0.4, (count, 2))


def test_distances_are_those_to_the_nearest_points_where_they_will_be():
    points, velocity = crowd()
    for controls in drives(10):
        plan = planner()._evaluate(scene(points, velocity), controls)
        for t, state in enumerate(plan.states[1:]):
            places = shapely.points(points + (t + 1) * PERIOD * velocity)
            truth = np.sort(shapely.distance(body(state), places))[:3]
            outside = truth > 0
            assert plan.distances[t][outside] == pytest.approx(truth[outside], abs=1e-9)
            assert np.all(plan.distances[t][~outside] <= 0)


def test_distances_to_moving_points_count_less():
    """Each point alone: 0.6 times its distance where it moves, all of it where it stands."""
    points, velocity = crowd(count=12)
    velocity[::2] = 0.0
    controls = next(drives(1))
    for k, (point, v) in enumerate(zip(points, velocity, strict=True)):
        whole = planner(1)._evaluate(scene(point, v[None]), controls)
        scaled = planner(1, moving_scale=0.6)._evaluate(scene(point, v[None]), controls)
        factor = 0.6 if k % 2 else 1.0
        assert scaled.distances == pytest.approx(factor * whole.distances)
        assert scaled.slopes == pytest.approx(factor * whole.slopes)


@pytest.mark.parametrize("moving_scale", [1.0, 0.6])
def test_slopes_are_what_the_distance_changes_by_with_the_state(moving_scale):
    pan = planner(1, moving_scale=moving_scale)
    checked = 0
    for controls, seed in zip(drives(10), range(10), strict=True):
        point, velocity = crowd(seed, count=1)
        plan = pan._evaluate(scene(point, velocity), controls)
        for t, state in enumerate(plan.states[1:]):
            place = shapely.Point(*(point[0] + (t + 1) * PERIOD * velocity[0]))
            for k in range(3):
                step = np.zeros(3)
                step[k] = 1e-5
                up, down = (body(state + d).distance(place) for d in (step, -step))
                if up == 0 or down == 0:
                    continue
                rate = moving_scale * (up - down) / 2e-5
                assert plan.slopes[t, 0, k] == pytest.approx(rate, abs=1e-3)
                checked += 1
    assert checked > 150


def test_where_there_are_fewer_points_than_the_qp_takes_the_rest_is_far():
    plan = planner(step_points=3)._evaluate(scene([[1.0, 0.0]]), np.zeros((HORIZON, 2)))
    assert plan.distances == pytest.approx(np.tile([0.8, FAR, FAR], (HORIZON, 1)))
    assert not plan.slopes[:, 1:].any()


def test_no_plan_is_worse_than_what_it_started_from():
    for seed, controls in enumerate(drives(20)):
        here = scene(*crowd(seed))
        pan = planner()
        plan = pan.plan(here, [controls])
        assert plan.cost <= pan._evaluate(here, controls).cost


def test_the_cheapest_of_several_starts_is_driven():
    """Somebody stands ahead, a little to the right: passing on the left is shorter."""
    here = scene([[1.0, -0.05], [1.05, -0.15], [1.1, -0.2]])
    left = np.tile([1.0, 0.6], (HORIZON, 1))
    starts = [left, left * [1, -1], np.zeros((HORIZON, 2))]
    pan = planner()
    best = pan.plan(here, starts)
    assert best.states[-1, 1] > 0.3
    costs = [pan.plan(here, [start]).cost for start in starts]
    assert max(costs) > min(costs) + 0.1
    assert best.cost == pytest.approx(min(costs), abs=1e-6)
    assert pan.plan(here, starts[::-1]).cost == pytest.approx(best.cost, rel=1e-3)


def test_alternating_stops_once_the_controls_settle():
    """In the open, one problem solves everything and the second finds nothing left to change."""
    pan = planner(iterations=50)
    solved = 0
    solve = pan._nrmp.solve

    def count():
        nonlocal solved
        solved += 1
        return solve()

    pan._nrmp.solve = count
    plan = pan.plan(scene(np.empty((0, 2))), [np.zeros((HORIZON, 2))])
    assert solved < 10
    assert plan.controls == pytest.approx(np.tile([1.0, 0.0], (HORIZON, 1)), abs=0.02)


def test_when_a_later_problem_fails_the_plan_before_it_stands():
    pan = planner()
    solve, calls = pan._nrmp.solve, []

    def fail_second():
        calls.append(None)
        return solve() if len(calls) == 1 else None

    pan._nrmp.solve = fail_second
    plan = pan.plan(scene([[0.8, 0.1]]), [np.zeros((HORIZON, 2))])
    assert len(calls) == 2
    assert plan is not None
    assert pan.failed_solves == 1


def test_without_any_solution_there_is_no_plan():
    pan = planner()
    pan._nrmp.solve = lambda: None
    assert pan.plan(scene([[0.8, 0.1]]), list(drives(3))) is None
    assert pan.failed_solves == 3
