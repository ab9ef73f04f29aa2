"""Which QP solver the NeuPAN-like planner should call: times on problems recorded from its drives.

Run ``python benchmarks/qp_solvers.py``. Every solver gets the same problems in the order in which
they arose, in the form that suits it: daqp with soft constraints or with explicit slacks, the
others with slacks; warm-started where that helps, at tolerances that give the same optimum. Solvers
that are not installed are left out (``pip install piqp osqp proxsuite``). Also prints what one
control step of the whole planner takes: 2 alternations, T = 10, 100 points. Times are processor
time, which a busy machine changes less; OMP_NUM_THREADS=1 keeps it to one core.
"""

from __future__ import annotations

import argparse
import copy
import importlib
import time
from collections.abc import Callable
from typing import Any

import daqp
import numpy as np
import scipy.sparse as sp
from crowdbench_agents.learning.seeds import VALIDATION
from crowdbench_agents.neupan.agent import Neupan
from crowdbench_agents.neupan.nrmp import SOFT, Problem
from rich.console import Console
from rich.table import Table

import crowdbench

SCENARIOS = ("multimodal_fast_nonreactive", "corridor_very_dense")
FIRST_SEED = VALIDATION[0]
Solver = Callable[[Problem], np.ndarray]


def record(scenario: str, steps: int) -> tuple[list[Problem], list[float]]:
    """Problems of some control steps, and the processor time [s] of each step undisturbed."""
    env = crowdbench.parallel_env(scenario)
    problems: list[Problem] = []
    seconds: list[float] = []
    for recording in (False, True):
        seed, agent, done = FIRST_SEED, Neupan(), 0
        while done < steps:
            observations, _ = env.reset(seed=seed)
            agent.reset(env.robot_spec(), seed)
            if recording:
                keep_problems(agent, problems)
            while env.agents and done < steps:
                begin = time.process_time()
                action = agent.act(crowdbench.Observation(**observations["robot_0"]))
                if not recording and done > 0:
                    seconds.append(time.process_time() - begin)
                observations, *_ = env.step({"robot_0": action})
                done += 1
            seed += 1
    return problems, seconds


def keep_problems(agent: Neupan, problems: list[Problem]) -> None:
    nrmp = agent._pan._nrmp
    solve = nrmp.solve

    def keep() -> Any:
        problems.append(copy.deepcopy(nrmp.problem))
        return solve()

    nrmp.solve = keep  # type: ignore[method-assign]


def with_slacks(p: Problem) -> tuple[np.ndarray, ...]:
    """H, f, rows and bounds with a slack s >= 0 per hinge: .. + rho/2 |s|^2, A z - s <= b."""
    n, m = len(p.f), len(p.b)
    H = np.zeros((n + m, n + m))
    H[:n, :n], H[n:, n:] = p.H, p.rho * np.eye(m)
    rows = np.block([[p.A, -np.eye(m)], [p.C, np.zeros((len(p.C), m))]])
    low = np.concatenate([np.full(m, -np.inf), p.c - p.ramp])
    high = np.concatenate([p.b, p.c + p.ramp])
    box_low = np.concatenate([p.low, np.zeros(m)])
    box_high = np.concatenate([p.high, np.full(m, np.inf)])
    return H, np.concatenate([p.f, np.zeros(m)]), rows, low, high, box_low, box_high


def daqp_soft(p: Problem) -> Solver:
    n, m = len(p.f), len(p.b)
    model = daqp.Model()
    sense = np.zeros(n + m + len(p.c), dtype=np.int32)
    sense[n : n + m] = SOFT
    started = False

    def solve(p: Problem) -> np.ndarray:
        nonlocal started
        rows = np.concatenate([p.A, p.C])
        high = np.concatenate([p.high, p.b, p.c + p.ramp])
        low = np.concatenate([p.low, np.full(m, -np.inf), p.c - p.ramp])
        if started:
            model.update(H=p.H, f=p.f, A=rows, bupper=high, blower=low)
        else:
            model.setup(p.H, p.f, rows, high, low, sense)
            model.soft_weights(*[np.full(len(high), 1 / p.rho)] * 2)
            started = True
        return model.solve()[0]

    return solve


def daqp_slacks(p: Problem) -> Solver:
    model, started = daqp.Model(), False

    def solve(p: Problem) -> np.ndarray:
        nonlocal started
        H, f, rows, low, high, box_low, box_high = with_slacks(p)
        high, low = np.concatenate([box_high, high]), np.concatenate([box_low, low])
        if started:
            model.update(H=H, f=f, A=rows, bupper=high, blower=low)
        else:
            model.setup(H, f, rows, high, low)
            started = True
        return model.solve()[0][: len(p.f)]

    return solve


def piqp_dense(p: Problem) -> Solver:
    piqp = importlib.import_module("piqp")
    solver, started = piqp.DenseSolver(), False
    solver.settings.eps_abs = solver.settings.eps_rel = 1e-8

    def solve(p: Problem) -> np.ndarray:
        nonlocal started
        H, f, rows, low, high, box_low, box_high = with_slacks(p)
        if started:
            solver.update(P=H, c=f, G=rows, h_l=low, h_u=high, x_l=box_low, x_u=box_high)
        else:
            solver.setup(H, f, None, None, rows, low, high, box_low, box_high)
            started = True
        solver.solve()
        return np.array(solver.result.x[: len(p.f)])

    return solve


def proxqp_dense(p: Problem) -> Solver:
    proxqp = importlib.import_module("proxsuite").proxqp
    n, m = len(p.f) + len(p.b), len(p.b) + len(p.c)
    qp, started = proxqp.dense.QP(n, 0, m, True), False
    qp.settings.eps_abs = 1e-7

    def solve(p: Problem) -> np.ndarray:
        nonlocal started
        H, f, rows, low, high, box_low, box_high = with_slacks(p)
        low, box_high = np.maximum(low, -1e20), np.minimum(box_high, 1e20)
        if started:
            qp.update(H=H, g=f, C=rows, l=low, u=high, l_box=box_low, u_box=box_high,
                      update_preconditioner=True)  # fmt: skip
        else:
            qp.init(H, f, None, None, rows, low, high, box_low, box_high)
            started = True
        qp.solve()
        return qp.results.x[: len(p.f)].copy()

    return solve


def osqp_sparse(p: Problem) -> Solver:
    osqp = importlib.import_module("osqp")
    n = len(p.f) + len(p.b)
    # The pattern stays the same, so that values can be replaced in place.
    pattern_H = sp.csc_matrix(np.triu(np.ones((len(p.f), len(p.f)))))
    pattern_H = sp.block_diag([pattern_H, sp.eye(len(p.b))], format="csc")
    rows_full = np.vstack([with_slacks(p)[2] != 0, np.eye(n)])
    rows_full[: len(p.b), : len(p.f)] = 1
    pattern_A = sp.csc_matrix(rows_full)
    solver = osqp.OSQP()
    started = False

    def values(matrix: np.ndarray, pattern: sp.csc_matrix) -> np.ndarray:
        columns = np.repeat(np.arange(pattern.shape[1]), np.diff(pattern.indptr))
        return matrix[pattern.indices, columns]

    def solve(p: Problem) -> np.ndarray:
        nonlocal started
        H, f, rows, low, high, box_low, box_high = with_slacks(p)
        pattern_H.data = values(H, pattern_H)
        pattern_A.data = values(np.vstack([rows, np.eye(n)]), pattern_A)
        low, high = np.concatenate([low, box_low]), np.concatenate([high, box_high])
        if started:
            solver.update(Px=pattern_H.data, Ax=pattern_A.data, q=f, l=low, u=high)
        else:
            solver.setup(pattern_H, f, pattern_A, low, high, verbose=False, eps_abs=1e-6,
                         eps_rel=1e-6, max_iter=20_000, polishing=True)  # fmt: skip
            started = True
        return solver.solve().x[: len(p.f)]

    return solve


SOLVERS = {
    "daqp, soft constraints": daqp_soft,
    "daqp, slacks": daqp_slacks,
    "piqp, dense": piqp_dense,
    "proxqp, dense": proxqp_dense,
    "osqp, sparse": osqp_sparse,
}


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare QP solvers on recorded problems.")
    parser.add_argument("--steps", type=int, default=100, help="control steps to record")
    options = parser.parse_args()
    console = Console()
    for scenario in SCENARIOS:
        problems, seconds = record(scenario, options.steps)
        table = Table("solver", "median [ms]", "p99 [ms]", "worst excess cost [relative]",
                      title=f"{scenario}: {len(problems)} problems, {len(problems[0].f)} unknowns, "
                      f"{len(problems[0].b)} hinges")  # fmt: skip
        best: np.ndarray | None = None
        for name, make in SOLVERS.items():
            try:
                solve = make(problems[0])
            except ImportError:
                table.add_row(name, "not installed", "", "")
                continue
            times, costs = [], []
            for problem in problems:
                begin = time.process_time()
                z = solve(problem)
                times.append(1e3 * (time.process_time() - begin))
                costs.append(problem.cost(np.clip(z, problem.low, problem.high)))
            best = np.array(costs) if best is None else best
            excess = (np.array(costs) - best) / np.maximum(1.0, np.abs(best))
            table.add_row(name, f"{np.median(times):.2f}", f"{np.percentile(times, 99):.2f}",
                          f"{np.max(np.abs(excess)):.0e}")  # fmt: skip
        console.print(table)
        console.print(f"control step: median {1e3 * np.median(seconds):.1f} ms, "
                      f"p99 {1e3 * np.percentile(seconds, 99):.1f} ms\n")  # fmt: skip


if __name__ == "__main__":
    main()
