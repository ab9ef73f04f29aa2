"""NRMP: the convex motion planner that DUNE's distances regularise, one QP per alternation.

Around a nominal trajectory (states s_bar, controls u_bar), with the dual variables mu of M points
per step held fixed, NeuPAN's neural regularised motion planner (Han et al. 2023) minimises

    sum_t |q (s_t - s_ref_t)|^2 + (p (v_t - v_ref))^2 + b/2 |s_t - s_bar_t|^2 - eta d_t
          + rho/2 sum_i max(0, d_t - (lambda_ti' x_t - lambda_ti' p_ti - mu_ti' h))^2

over controls u_t = (v, w) and safety distances d_t, subject to linearised differential-drive
dynamics, speed and acceleration limits and d_min <= d_t <= d_max; x_t is the position in the state
s_t = (x, y, heading) and lambda = -R(heading) G' mu.

Three things differ from the published form. The distance is also linearised in the heading, since
turning moves the corners of a footprint. c/2 |u_t - u_(t-1)|^2 keeps the drive smooth, from the
current velocity on. And the first control is tied to the current velocity by the acceleration
limits, where there are any. States are eliminated and the squared hinge is a soft constraint of
the solver, so that 3 T unknowns remain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import daqp
import numpy as np
from crowdbench_agents.neupan.dune import Array

from crowdbench.compiled import compiled

SOFT = 8  # daqp's mark of a constraint whose violation costs rho/2 times its square
CURVATURE = 1e-2
"""Makes the cost strictly convex in d; its gradient stays far below eta."""


class Weights(NamedTuple):
    """The cost's weights; see the module's docstring. q and p act squared."""

    q_position: float  # [1/m]
    q_heading: float  # [1/rad]
    p_speed: float  # [s/m]
    proximal: float  # b
    smooth: float  # c
    eta: float  # [1/m]
    rho: float  # [1/m^2]
    d_min: float  # [m]
    d_max: float  # [m]


@dataclass(frozen=True)
class Limits:
    """What the robot can do."""

    low: Array  # (2,) v [m/s], w [rad/s]
    high: Array  # (2,)
    acceleration: Array | None  # (2,) [m/s^2], [rad/s^2]


@dataclass(frozen=True)
class Problem:
    """min 1/2 z'H z + f'z + rho/2 sum max(0, A z - b)^2, low <= z <= high, |C z - c| <= ramp.

    z = (v_0, w_0, v_1, .., w_(T-1), d_1, .., d_T); A has M rows per step. C has a row per control
    where the acceleration is limited, and none otherwise.
    """

    H: Array
    f: Array
    A: Array
    b: Array
    rho: float
    low: Array
    high: Array
    C: Array
    c: Array
    ramp: Array

    def cost(self, z: Array) -> float:
        """Value of the objective at z."""
        hinge = np.maximum(0.0, self.A @ z - self.b)
        return float(z @ self.H @ z / 2 + self.f @ z + self.rho / 2 * hinge @ hinge)


class Nrmp:
    """The QP of one robot: built once for T steps and M points, updated in place, warm-started."""

    def __init__(
        self, horizon: int, points: int, period: float, limits: Limits, weights: Weights
    ) -> None:
        """Allocate the problem for ``horizon`` steps of ``period`` seconds."""
        T, n, hinges = horizon, 3 * horizon, horizon * points
        self._horizon, self._period = T, period
        self._limits, self._weights = limits, weights
        acceleration = np.zeros(0) if limits.acceleration is None else limits.acceleration
        ramp = np.tile(acceleration * period, T)
        # What daqp reads; the problem's arrays are views of these.
        self._rows = np.zeros((hinges + len(ramp), n))
        self._high = np.full(n + len(self._rows), np.inf)
        self._low = np.full(n + len(self._rows), -np.inf)
        self._high[:n] = np.concatenate([np.tile(limits.high, T), np.full(T, weights.d_max)])
        self._low[:n] = np.concatenate([np.tile(limits.low, T), np.full(T, weights.d_min)])
        C = self._rows[hinges:]
        C[np.arange(len(C)), np.arange(len(C))] = 1.0
        C[np.arange(2, len(C)), np.arange(len(C) - 2)] = -1.0
        self.problem = Problem(
            H=np.zeros((n, n)),
            f=np.zeros(n),
            A=self._rows[:hinges],
            b=self._high[n : n + hinges],
            rho=weights.rho,
            low=self._low[:n],
            high=self._high[:n],
            C=C,
            c=np.zeros(len(C)),
            ramp=ramp,
        )
        self._model: daqp.Model | None = None

    def update(
        self,
        states: Array,
        controls: Array,
        reference: Array,
        v_ref: Array,
        slopes: Array,
        distances: Array,
        velocity: Array,
    ) -> Problem:
        """Write the problem around a nominal trajectory; always the same object.

        Args:
            states: (T + 1, 3) nominal x, y [m], heading [rad].
            controls: (T, 2) nominal v [m/s], w [rad/s].
            reference: (T, 3) states wanted at steps 1..T.
            v_ref: (T,) speeds wanted [m/s].
            slopes: (T, M, 3) derivative of each point's distance with respect to the state.
            distances: (T, M) of each point in the nominal state [m].
            velocity: (2,) current v [m/s], w [rad/s].
        """
        p = self.problem
        _write_cost(
            p.H, p.f, p.A, p.b, states, controls, reference, v_ref, slopes, distances, velocity,
            self._period, self._weights,
        )  # fmt: skip
        if len(p.c):
            p.c[:2] = velocity
            self._high[-len(p.c) :] = p.c + p.ramp
            self._low[-len(p.c) :] = p.c - p.ramp
        return p

    def solve(self) -> tuple[Array, Array] | None:
        """(T, 2) controls and (T,) safety distances [m] at the optimum, or None on failure."""
        p = self.problem
        if not all(np.isfinite(part).all() for part in (p.H, p.f, p.A, p.b)):
            return None
        if self._model is None:
            flag = self._start()
        else:
            flag = self._model.update(
                H=p.H, f=p.f, A=self._rows, bupper=self._high, blower=self._low
            )
        z = np.full(len(p.f), np.nan)
        if flag >= 0:
            assert self._model is not None
            z, _, flag, _ = self._model.solve()
        if flag <= 0 or not np.isfinite(z).all():
            self._model = None  # what failed is no warm start
            return None
        controls = z[: 2 * self._horizon].reshape(-1, 2)
        return np.clip(controls, self._limits.low, self._limits.high), z[2 * self._horizon :]

    def _start(self) -> int:
        p = self.problem
        sense = np.zeros(len(self._high), dtype=np.int32)
        sense[len(p.f) : len(p.f) + len(p.b)] = SOFT
        slack = np.full(len(self._high), 1.0 / p.rho)
        self._model = daqp.Model()
        flag, _ = self._model.setup(p.H, p.f, self._rows, self._high, self._low, sense)
        self._model.soft_weights(rho_l=slack, rho_u=slack)
        return flag


@compiled()
def wrap(angle: float) -> float:  # pragma: no cover - compiled
    """The same angle between -pi and pi [rad]."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


@compiled()
def rollout(controls: Array, period: float) -> Array:  # pragma: no cover - compiled
    """(T + 1, 3) states reached from the origin, each of the (T, 2) controls held for a period.

    The chord of an arc of angle w t is v t sin(w t / 2) / (w t / 2), half that angle off.
    """
    states = np.zeros((len(controls) + 1, 3))
    for t in range(len(controls)):
        v, w = controls[t]
        half = w * period / 2
        chord = v * period * (np.sin(half) / half if abs(half) > 1e-9 else 1.0)
        middle = states[t, 2] + half
        states[t + 1, 0] = states[t, 0] + chord * np.cos(middle)
        states[t + 1, 1] = states[t, 1] + chord * np.sin(middle)
        states[t + 1, 2] = middle + half
    return states


@compiled()
def sensitivity(
    states: Array, controls: Array, period: float
) -> Array:  # pragma: no cover - compiled
    """(T, 3, 2 T) derivative of ``rollout``'s states 1..T with respect to all controls."""
    T = len(controls)
    gamma = np.zeros((T, 3, 2 * T))
    for t in range(T):
        v, w = controls[t]
        half = w * period / 2
        sinc = np.sin(half) / half if abs(half) > 1e-9 else 1.0
        slope = (np.cos(half) - sinc) / half if abs(half) > 1e-3 else -half / 3
        c, s = np.cos(states[t, 2] + half), np.sin(states[t, 2] + half)
        chord = v * period * sinc
        for j in range(2 * t):
            gamma[t, 0, j] = gamma[t - 1, 0, j] - chord * s * gamma[t - 1, 2, j]
            gamma[t, 1, j] = gamma[t - 1, 1, j] + chord * c * gamma[t - 1, 2, j]
            gamma[t, 2, j] = gamma[t - 1, 2, j]
        longer = v * period * slope * period / 2
        gamma[t, 0, 2 * t] = period * sinc * c
        gamma[t, 1, 2 * t] = period * sinc * s
        gamma[t, 0, 2 * t + 1] = longer * c - chord * s * period / 2
        gamma[t, 1, 2 * t + 1] = longer * s + chord * c * period / 2
        gamma[t, 2, 2 * t + 1] = period
    return gamma


@compiled()
def _write_cost(
    H: Array, f: Array, A: Array, b: Array,
    states: Array, controls: Array, reference: Array, v_ref: Array,
    slopes: Array, distances: Array, velocity: Array, period: float, w: Weights,
) -> None:  # fmt: skip  # pragma: no cover - compiled
    T, M = distances.shape
    gamma = sensitivity(states, controls, period)
    for i in range(len(f)):
        f[i] = 0.0
        for j in range(len(f)):
            H[i, j] = 0.0
    for i in range(len(A)):
        for j in range(len(f)):
            A[i, j] = 0.0
    base = np.empty(3)  # the state that zero controls would lead to
    for t in range(T):
        known = 2 * t + 2  # controls that the state depends on
        for k in range(3):
            row = gamma[t, k]
            base[k] = states[t + 1, k]
            for i in range(known):
                base[k] -= row[i] * controls[i // 2, i % 2]
            q = w.q_heading if k == 2 else w.q_position
            off = states[t + 1, k] - reference[t, k]
            target = states[t + 1, k] - (wrap(off) if k == 2 else off)
            weight = 2 * q * q + w.proximal
            pull = 2 * q * q * (base[k] - target) + w.proximal * (base[k] - states[t + 1, k])
            for i in range(known):
                f[i] += pull * row[i]
                for j in range(known):
                    H[i, j] += weight * row[i] * row[j]
        H[2 * t, 2 * t] += 2 * w.p_speed**2
        f[2 * t] -= 2 * w.p_speed**2 * v_ref[t]
        for j in (2 * t, 2 * t + 1):
            H[j, j] += w.smooth
            if t > 0:
                H[j - 2, j - 2] += w.smooth
                H[j - 2, j] -= w.smooth
                H[j, j - 2] -= w.smooth
            else:
                f[j] -= w.smooth * velocity[j]
        d = 2 * T + t
        H[d, d] = CURVATURE
        f[d] = -w.eta - CURVATURE * w.d_max
        for m in range(M):
            r = t * M + m
            A[r, d] = 1.0
            b[r] = distances[t, m]
            for k in range(3):
                b[r] += slopes[t, m, k] * (base[k] - states[t + 1, k])
                for j in range(known):
                    A[r, j] -= slopes[t, m, k] * gamma[t, k, j]
