"""Proximal alternating minimisation: DUNE and NRMP in turns, until the plan settles.

One alternation evaluates the encoder at every point in every nominal state, keeps the M nearest
points per step, and lets the planner's QP improve the controls with those distances linearised.
Two things are added to the published scheme, and can be switched off:

- a full step is taken only when it lowers the true cost, otherwise a shorter one along it;
- the alternation starts from several nominal trajectories, because a QP around one of them cannot
  find the other side of a person. The cheapest result is driven.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from crowdbench_agents.neupan.dune import Array, Footprint
from crowdbench_agents.neupan.nrmp import Limits, Nrmp, Weights, rollout, wrap

from crowdbench.compiled import compiled

FAR = 50.0  # distance of a point that is not there [m]
STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)


class Encoder(Protocol):
    """What maps (N, 2) points in the robot frame to (N, E) dual variables."""

    def dual(self, points: Array) -> Array:
        """Return (N, E) dual variables."""


@dataclass(frozen=True)
class Scene:
    """What a plan is made for, in the present robot frame.

    Attributes:
        points: (N, 2) [m].
        point_velocity: (N, 2) [m/s].
        reference: (T, 3) states wanted at steps 1..T [m, m, rad].
        v_ref: (T,) speeds wanted [m/s].
        velocity: (2,) current v [m/s], w [rad/s].
    """

    points: Array
    point_velocity: Array
    reference: Array
    v_ref: Array
    velocity: Array


@dataclass(frozen=True)
class Plan:
    """Controls around which everything is known.

    Attributes:
        controls: (T, 2) v [m/s], w [rad/s].
        states: (T + 1, 3) nominal states, the first at the origin.
        slopes: (T, M, 3) derivatives of the distances with respect to the states.
        distances: (T, M) from the footprint to the nearest points, negative inside [m]; those to
            moving points scaled.
        cost: true cost.
    """

    controls: Array
    states: Array
    slopes: Array
    distances: Array
    cost: float


class Pan:
    """Improves plans for one robot."""

    def __init__(
        self,
        footprint: Footprint,
        encoder: Encoder,
        period: float,
        limits: Limits,
        weights: Weights,
        horizon: int,
        step_points: int,
        iterations: int,
        tolerance: float,
        line_search: bool,
        moving_scale: float,
    ) -> None:
        """Build the QP once; see config.yaml for the settings."""
        self._footprint, self._encoder = footprint, encoder
        self._period, self._weights = period, weights
        self._points, self._moving_scale = step_points, moving_scale
        self._iterations, self._tolerance = iterations, tolerance
        self._lengths = STEP_LENGTHS if line_search else STEP_LENGTHS[:1]
        self._nrmp = Nrmp(horizon, step_points, period, limits, weights)
        self.failed_solves = 0

    def plan(self, scene: Scene, starts: list[Array]) -> Plan | None:
        """Return the cheapest plan found from (T, 2) controls, None when no QP was solved."""
        plans = [plan for start in starts if (plan := self._improve(scene, start)) is not None]
        return min(plans, key=lambda plan: plan.cost, default=None)

    def _improve(self, scene: Scene, start: Array) -> Plan | None:
        plan = self._evaluate(scene, start)
        for iteration in range(self._iterations):
            self._nrmp.update(
                plan.states,
                plan.controls,
                scene.reference,
                scene.v_ref,
                plan.slopes,
                plan.distances,
                scene.velocity,
            )
            solution = self._nrmp.solve()
            if solution is None:
                self.failed_solves += 1
                return None if iteration == 0 else plan
            step = solution[0] - plan.controls
            if np.max(np.abs(step)) < self._tolerance:
                break
            for length in self._lengths:
                candidate = self._evaluate(scene, plan.controls + length * step)
                if candidate.cost < plan.cost or len(self._lengths) == 1:
                    break
            else:
                break
            plan = candidate
        return plan

    def _evaluate(self, scene: Scene, controls: Array) -> Plan:
        """Roll controls out and measure distances: the DUNE half of an alternation."""
        states = rollout(controls, self._period)
        local = _local_points(states, scene.points, scene.point_velocity, self._period)
        mu = self._footprint.with_interior(local, self._encoder.dual(local))
        slopes, distances = _nearest(
            states,
            local,
            mu,
            self._footprint.G,
            self._footprint.h,
            self._points,
            scene.point_velocity,
            self._moving_scale,
        )
        cost = _true_cost(
            controls,
            states,
            distances,
            scene.reference,
            scene.v_ref,
            scene.velocity,
            self._weights,
        )
        return Plan(controls, states, slopes, distances, cost)


@compiled()
def _local_points(
    states: Array, points: Array, velocity: Array, period: float
) -> Array:  # pragma: no cover - compiled
    """(T N, 2) the points at steps 1..T in the robot frame of each step."""
    T, N = len(states) - 1, len(points)
    local = np.empty((T * N, 2))
    for t in range(T):
        x, y, heading = states[t + 1]
        c, s = np.cos(heading), np.sin(heading)
        time = (t + 1) * period
        for i in range(N):
            dx = points[i, 0] + time * velocity[i, 0] - x
            dy = points[i, 1] + time * velocity[i, 1] - y
            local[t * N + i, 0] = c * dx + s * dy
            local[t * N + i, 1] = c * dy - s * dx
    return local


@compiled()
def _nearest(
    states: Array,
    local: Array,
    mu: Array,
    G: Array,
    h: Array,
    count: int,
    velocity: Array,
    moving_scale: float,
) -> tuple[Array, Array]:  # pragma: no cover - compiled
    """(T, M, 3) slopes and (T, M) distances of the ``count`` nearest points of each step.

    With n = G' mu and q = R(heading)' (p - x): d = n' q - mu' h, so d changes by -R n per metre
    of the robot and by n_x q_y - n_y q_x per radian. Where a moving point will be is less certain
    than where a wall is: its distance counts ``moving_scale`` times, so that the range d_min to
    d_max, in which the robot keeps away, is longer for it by the inverse.
    """
    T = len(states) - 1
    N, E = len(local) // T, len(h)
    slopes, distances = np.zeros((T, count, 3)), np.full((T, count), FAR)
    d, scale = np.empty(N), np.ones(N)
    for i in range(N):
        if velocity[i, 0] != 0.0 or velocity[i, 1] != 0.0:
            scale[i] = moving_scale
    for t in range(T):
        for i in range(N):
            d[i] = 0.0
            for e in range(E):
                g = G[e, 0] * local[t * N + i, 0] + G[e, 1] * local[t * N + i, 1]
                d[i] += scale[i] * mu[t * N + i, e] * (g - h[e])
        order = np.argsort(d)[:count]
        c, s = np.cos(states[t + 1, 2]), np.sin(states[t + 1, 2])
        for m in range(len(order)):
            k, weight = t * N + order[m], scale[order[m]]
            nx, ny = 0.0, 0.0
            for e in range(E):
                nx += weight * mu[k, e] * G[e, 0]
                ny += weight * mu[k, e] * G[e, 1]
            distances[t, m] = d[order[m]]
            slopes[t, m, 0] = -(c * nx - s * ny)
            slopes[t, m, 1] = -(s * nx + c * ny)
            slopes[t, m, 2] = nx * local[k, 1] - ny * local[k, 0]
    return slopes, distances


@compiled()
def _true_cost(
    controls: Array,
    states: Array,
    distances: Array,
    reference: Array,
    v_ref: Array,
    velocity: Array,
    w: Weights,
) -> float:  # pragma: no cover - compiled
    """NRMP's cost without its linearisation, the safety distance being the nearest point's."""
    cost = 0.0
    last = velocity
    for t in range(len(controls)):
        off = states[t + 1] - reference[t]
        cost += w.q_position**2 * (off[0] ** 2 + off[1] ** 2)
        cost += (w.q_heading * wrap(off[2])) ** 2 + (w.p_speed * (controls[t, 0] - v_ref[t])) ** 2
        change = controls[t] - last
        cost += w.smooth / 2 * (change[0] ** 2 + change[1] ** 2)
        cost -= w.eta * min(max(distances[t, 0], w.d_min), w.d_max)
        for m in range(distances.shape[1]):
            cost += w.rho / 2 * max(0.0, w.d_min - distances[t, m]) ** 2
        last = controls[t]
    return cost
