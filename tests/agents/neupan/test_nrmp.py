"""NRMP: dynamics against integration, the QP against a second solver, controls by reason."""

import copy

import numpy as np
import pytest
from crowdbench_agents.neupan.agent import Neupan
from crowdbench_agents.neupan.nrmp import Limits, Nrmp, Weights, rollout, sensitivity, wrap
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

import crowdbench

PERIOD = 0.2
WEIGHTS = Weights(
    q_position=0.5, q_heading=0.3, p_speed=1.0, proximal=0.1, smooth=0.1, eta=5.0, rho=4000.0,
    d_min=0.1, d_max=0.5,
)  # fmt: skip
FREE = Limits(np.array([0.0, -1.5]), np.array([1.0, 1.5]), None)
SLUGGISH = Limits(FREE.low, FREE.high, np.array([1.0, 2.0]))


def straight_ahead(nrmp, horizon, points=5, velocity=(0.0, 0.0), distances=50.0, slopes=None):
    """A problem around driving straight ahead at 0.5 m/s, wanting 1 m/s."""
    controls = np.tile([0.5, 0.0], (horizon, 1))
    reference = np.zeros((horizon, 3))
    reference[:, 0] = PERIOD * np.arange(1, horizon + 1)
    return nrmp.update(
        rollout(controls, PERIOD),
        controls,
        reference,
        np.ones(horizon),
        np.zeros((horizon, points, 3)) if slopes is None else slopes,
        np.broadcast_to(distances, (horizon, points)).astype(float),
        np.array(velocity),
    )


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-1.5, 1.5)), min_size=1, max_size=8))
def test_rollout_agrees_with_fine_integration(controls):
    controls = np.array(controls)
    state = np.zeros(3)
    pieces = 300
    for v, w in controls:
        for _ in range(pieces):
            middle = state[2] + w * PERIOD / pieces / 2
            state += PERIOD / pieces * np.array([v * np.cos(middle), v * np.sin(middle), w])
    assert rollout(controls, PERIOD)[-1] == pytest.approx(state, abs=1e-6)


@pytest.mark.parametrize("turn", [0.0, 1e-6, 0.7])
def test_sensitivity_agrees_with_finite_differences(turn):
    rng = np.random.default_rng(0)
    controls = np.column_stack([rng.uniform(0, 1, 6), turn * rng.uniform(-1, 1, 6)])
    found = sensitivity(rollout(controls, PERIOD), controls, PERIOD)
    for j in range(controls.size):
        step = np.zeros(controls.size)
        step[j] = 1e-6
        up = rollout(controls + step.reshape(-1, 2), PERIOD)[1:]
        down = rollout(controls - step.reshape(-1, 2), PERIOD)[1:]
        assert found[:, :, j] == pytest.approx((up - down) / 2e-6, abs=1e-7)


def recorded(scenario, seed, steps=12, **overrides):
    """Problems and solutions of an episode's first steps."""
    env = crowdbench.parallel_env(scenario, **overrides)
    agent, cases = Neupan(), []
    observations, _ = env.reset(seed=seed)
    agent.reset(env.robot_spec(), 0)
    nrmp = agent._pan._nrmp
    solve = nrmp.solve

    def keep():
        solution = solve()
        cases.append((copy.deepcopy(nrmp.problem), solution))
        return solution

    nrmp.solve = keep
    for _ in range(steps):
        observation = crowdbench.Observation(**observations["robot_0"])
        observations, *_ = env.step({"robot_0": agent.act(observation)})
        if not env.agents:
            break
    return cases[:: max(1, len(cases) // 12)]


def second_opinion(p):
    """The same problem by sequential quadratic programming, with the hinges in the cost."""
    ramps = {
        "type": "ineq",
        "fun": lambda z: np.concatenate([p.c + p.ramp - p.C @ z, p.C @ z - p.c + p.ramp]),
        "jac": lambda z: np.concatenate([-p.C, p.C]),
    }
    solution = minimize(
        p.cost,
        np.maximum(0.0, p.low),
        jac=lambda z: p.H @ z + p.f + p.rho * p.A.T @ np.maximum(0.0, p.A @ z - p.b),
        method="SLSQP",
        bounds=list(zip(p.low, p.high, strict=True)),
        constraints=[ramps] if len(p.c) else [],
        options={"ftol": 1e-15, "maxiter": 2000},
    )
    return solution.x


@pytest.mark.parametrize(
    ("scenario", "overrides"),
    [
        ("multimodal_fast_nonreactive", {}),
        ("corridor_very_dense", {}),
        ("corridor_very_dense", {"robots": {"acceleration": [1.0, 2.0]}}),
    ],
)
def test_the_optimum_is_the_one_a_second_solver_finds(scenario, overrides):
    cases = recorded(scenario, 900_007, **overrides)
    assert len(cases) >= 10
    for problem, solution in cases:
        assert solution is not None
        z = np.concatenate([solution[0].ravel(), solution[1]])
        other = second_opinion(problem)
        assert problem.cost(z) == pytest.approx(problem.cost(other), rel=1e-6, abs=1e-6)
        assert z == pytest.approx(other, abs=1e-4)
        assert np.all((z >= problem.low - 1e-6) & (z <= problem.high + 1e-6))
        assert np.all(np.abs(problem.C @ z - problem.c) <= problem.ramp + 1e-6)


def test_without_points_the_path_is_followed_at_the_speed_wanted():
    nrmp = Nrmp(10, 5, PERIOD, FREE, WEIGHTS._replace(smooth=0.0, proximal=0.0))
    straight_ahead(nrmp, 10)
    controls, distances = nrmp.solve()
    assert controls == pytest.approx(np.tile([1.0, 0.0], (10, 1)), abs=1e-6)
    assert distances == pytest.approx(np.full(10, WEIGHTS.d_max))


def test_the_first_control_is_tied_to_the_current_velocity():
    nrmp = Nrmp(10, 5, PERIOD, SLUGGISH, WEIGHTS._replace(smooth=0.0))
    straight_ahead(nrmp, 10, velocity=(0.3, 0.9))
    controls, _ = nrmp.solve()
    # 1 m/s^2 and 2 rad/s^2 for 0.2 s; the turn wanted is none.
    assert controls[0] == pytest.approx([0.5, 0.5], abs=1e-6)
    changes = np.abs(np.diff(controls, axis=0))
    assert np.all(changes <= np.array([0.2, 0.4]) + 1e-6)


def test_a_point_ahead_slows_the_robot_down():
    """Distance 0.35 m in all nominal states, shrinking by a metre per metre driven."""
    horizon = 5
    nrmp = Nrmp(horizon, 1, PERIOD, FREE, WEIGHTS._replace(eta=0.0))
    slopes = np.zeros((horizon, 1, 3))
    slopes[:, :, 0] = -1.0
    nominal = rollout(np.tile([0.5, 0.0], (horizon, 1)), PERIOD)
    gap = 0.35 - nominal[1:, :1]
    straight_ahead(nrmp, horizon, points=1, slopes=slopes, distances=gap)
    controls, _ = nrmp.solve()
    driven = rollout(controls, PERIOD)[-1, 0]
    assert driven == pytest.approx(0.35 - WEIGHTS.d_min, abs=0.01)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_problem_that_is_none_has_no_solution_and_spoils_nothing(bad):
    nrmp = Nrmp(6, 5, PERIOD, FREE, WEIGHTS)
    straight_ahead(nrmp, 6)
    before, _ = nrmp.solve()
    straight_ahead(nrmp, 6, velocity=(bad, 0.0))
    assert nrmp.solve() is None
    straight_ahead(nrmp, 6)
    after, _ = nrmp.solve()
    assert after == pytest.approx(before, abs=1e-6)


def test_an_infeasible_problem_has_no_solution():
    """A robot faster than its limits and unable to slow down in time."""
    nrmp = Nrmp(6, 5, PERIOD, SLUGGISH, WEIGHTS)
    straight_ahead(nrmp, 6, velocity=(3.0, 0.0))
    assert nrmp.solve() is None


@given(st.floats(-50, 50))
def test_wrapped_angles_point_the_same_way(angle):
    assert -np.pi <= wrap(angle) <= np.pi
    assert np.cos(wrap(angle)) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrap(angle)) == pytest.approx(np.sin(angle), abs=1e-9)
