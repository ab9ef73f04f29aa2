"""Where the points of a scan will be: the decoupled prediction of moving bodies.

Consecutive beams that hit nearby points form a group. A group that lies on a small circle is a
body: it is tracked with a Kalman filter of constant velocity, and stands for its whole circle,
because whoever walks past shows another side later. Everything else (walls, large things) is taken
to stand still. Nothing but the scans and the odometry is used, and bodies are predicted as if the
robot were not there.
"""

from __future__ import annotations

import numpy as np
from crowdbench_agents.neupan.dune import Array
from numpy.typing import NDArray

from crowdbench.compiled import compiled

GROUP_GAP = 0.2  # neighbouring points farther apart than this belong to two things [m]
BODY_RADIUS, BODY_SPREAD = 0.25, 0.1  # what a body's radius is expected to be, and how surely [m]
LARGEST_BODY = 0.5  # larger circles are walls or furniture [m]
FIT_ERROR = 0.05  # a group farther than this from its circle is no body [m]
FEWEST_POINTS = 3  # that show a curvature
FIT_NOISE = 0.01  # of a point about its circle [m]
RING_POINTS = 16
GATE = 0.6  # a body is the one expected within this distance [m]
POSITION_NOISE = 0.03  # of a fitted centre [m]
ACCELERATION = 2.0  # what people change their velocity by [m/s^2]
FIRST_SPEED = 1.0  # spread of an unknown velocity [m/s]
STANDING = 0.08  # slower bodies are taken to stand [m/s]
FORGET = 0.6  # a body unseen for this long is dropped [s]


class Tracker:
    """Estimates point velocities from consecutive scans of one episode."""

    def __init__(
        self,
        angles: Array,
        lidar_range: float,
        period: float,
        group_gap: float = GROUP_GAP,
        position_noise: float = POSITION_NOISE,
    ) -> None:
        """Start without bodies.

        Args:
            angles: (beams,) direction of each beam from the robot's heading [rad].
            lidar_range: distance of a beam that hits nothing [m].
            period: time between scans [s].
            group_gap: neighbouring points farther apart than this belong to two things [m].
            position_noise: standard deviation of a fitted centre [m].
        """
        self._beams = np.column_stack([np.cos(angles), np.sin(angles)])
        spacing = np.min(np.abs(np.diff(angles))) if len(angles) > 1 else 0.0
        wraps = len(angles) > 2 and 2 * np.pi - (angles[-1] - angles[0]) < 1.5 * spacing
        self._spacing, self._wraps = float(spacing), bool(wraps)
        self._range = lidar_range
        turn = np.arange(RING_POINTS) * (2 * np.pi / RING_POINTS)
        self._ring = np.column_stack([np.cos(turn), np.sin(turn)])
        self._step = np.array([[1.0, period], [0.0, 1.0]])
        jerk = np.array([period**2 / 2, period]) * ACCELERATION
        self._process = np.outer(jerk, jerk)
        self._period = period
        self._group_gap, self._variance = group_gap, position_noise**2
        self._state = np.empty((0, 2, 2))  # position and velocity, by axis, odometry frame
        self._spread = np.empty((0, 2, 2))  # covariance of position and velocity, either axis
        self._unseen = np.empty(0)  # seconds

    def update(self, scan: NDArray[np.floating], pose: NDArray[np.floating]) -> tuple[Array, Array]:
        """Take the next scan (beams,) [m], seen from ``pose`` (3,) in the odometry frame.

        Returns:
            (N, 2) points [m] and their velocities [m/s], both in the frame of ``pose``.
        """
        ranges = np.asarray(scan, dtype=np.float64)
        hit = np.isfinite(ranges) & (ranges < self._range - 1e-3) & (ranges > 0)
        ranges = np.where(hit, ranges, 0.0)
        group = _groups(ranges, self._beams, hit, self._spacing, self._wraps, self._group_gap)
        points = ranges[:, None] * self._beams
        circles, standing = _bodies(points, group)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        to_odometry = np.array([[c, -s], [s, c]])
        centres = circles[:, :2] @ to_odometry.T + np.asarray(pose[:2], dtype=np.float64)
        velocity = self._follow(centres) @ to_odometry
        velocity[np.linalg.norm(velocity, axis=1) < STANDING] = 0.0
        rings = circles[:, None, :2] + circles[:, None, 2:] * self._ring
        still = points[standing]
        return (
            np.concatenate([still, rings.reshape(-1, 2)]),
            np.concatenate([np.zeros_like(still), np.repeat(velocity, RING_POINTS, axis=0)]),
        )

    def _follow(self, centres: Array) -> Array:
        """(B, 2) velocities of the bodies at (B, 2) centres, odometry frame; updates the filter."""
        self._state = np.einsum("ij,tja->tia", self._step, self._state)
        self._spread = self._step @ self._spread @ self._step.T + self._process
        self._unseen = self._unseen + self._period
        velocity = np.zeros_like(centres)
        distance = np.linalg.norm(self._state[:, None, 0] - centres[None], axis=2)
        new = np.ones(len(centres), dtype=bool)
        while distance.size and distance.min() < GATE:
            t, b = np.unravel_index(np.argmin(distance), distance.shape)
            distance[t, :] = distance[:, b] = np.inf
            new[b] = False
            spread = self._spread[t]
            gain = spread[:, 0] / (spread[0, 0] + self._variance)
            self._state[t] += np.outer(gain, centres[b] - self._state[t, 0])
            self._spread[t] = spread - np.outer(gain, spread[0])
            self._unseen[t] = 0.0
            velocity[b] = self._state[t, 1]
        fresh = np.stack([centres[new], np.zeros((new.sum(), 2))], axis=1)
        unknown = np.diag([self._variance, FIRST_SPEED**2])
        self._state = np.concatenate([self._state, fresh])
        self._spread = np.concatenate([self._spread, np.repeat(unknown[None], new.sum(), axis=0)])
        self._unseen = np.concatenate([self._unseen, np.zeros(new.sum())])
        kept = self._unseen < FORGET
        self._state, self._spread = self._state[kept], self._spread[kept]
        self._unseen = self._unseen[kept]
        return velocity


@compiled()
def _groups(
    ranges: Array,
    beams: Array,
    hit: NDArray[np.bool_],
    spacing: float,
    wraps: bool,
    gap: float,
) -> NDArray[np.int64]:  # pragma: no cover - compiled
    """(beams,) number of the group each beam's point belongs to, -1 for beams that hit nothing."""
    n = len(ranges)
    group = np.full(n, -1)
    count = 0
    for i in range(n):
        if not hit[i]:
            continue
        if i > 0 and hit[i - 1] and _near(ranges, beams, i - 1, i, spacing, gap):
            group[i] = group[i - 1]
        else:
            group[i] = count
            count += 1
    if wraps and hit[0] and hit[n - 1] and _near(ranges, beams, n - 1, 0, spacing, gap):
        last = group[n - 1]
        for i in range(n):
            if group[i] == last:
                group[i] = group[0]
    return group


@compiled()
def _near(
    ranges: Array, beams: Array, i: int, j: int, spacing: float, gap: float
) -> bool:  # pragma: no cover - compiled
    dx = ranges[i] * beams[i, 0] - ranges[j] * beams[j, 0]
    dy = ranges[i] * beams[i, 1] - ranges[j] * beams[j, 1]
    return np.hypot(dx, dy) < gap + spacing * min(ranges[i], ranges[j])


@compiled()
def _bodies(
    points: Array, group: NDArray[np.int64]
) -> tuple[Array, NDArray[np.bool_]]:  # pragma: no cover - compiled
    """(B, 3) circles x, y, radius of the bodies, and (beams,) which points belong to none."""
    count = 0
    for g in group:
        count = max(count, g + 1)
    circles = np.empty((count, 3))
    standing = np.empty(len(group), dtype=np.bool_)
    for i in range(len(group)):
        standing[i] = group[i] >= 0
    mine = np.empty((len(points), 2))
    found = 0
    for k in range(count):
        n = np.int64(0)  # no literal: numba would compile the fit for it as well
        for i in range(len(group)):
            if group[i] == k:
                mine[n, 0], mine[n, 1] = points[i, 0], points[i, 1]
                n += 1
        if n < FEWEST_POINTS:
            continue
        x, y, radius, error = _fit_circle(mine, n)
        if radius > LARGEST_BODY or error > FIT_ERROR:
            continue
        circles[found, 0], circles[found, 1], circles[found, 2] = x, y, radius
        found += 1
        for i in range(len(group)):
            if group[i] == k:
                standing[i] = False
    return circles[:found], standing


@compiled()
def _fit_circle(
    points: Array, n: int | np.integer
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled
    """Circle through n points seen from the origin: x, y, radius, root mean square error [m].

    Gauss-Newton on sum (|p - c| - r)^2 / noise^2 + (r - expected)^2 / spread^2; the second term
    decides when there are too few points to see a curvature.
    """
    sum_x, sum_y, nearest = 0.0, 0.0, np.inf
    for i in range(n):
        sum_x, sum_y = sum_x + points[i, 0], sum_y + points[i, 1]
        nearest = min(nearest, np.hypot(points[i, 0], points[i, 1]))
    x, y = sum_x / n, sum_y / n
    away = 1.0 + 0.8 * BODY_RADIUS / max(np.hypot(x, y), 1e-6)
    x, y, radius = x * away, y * away, BODY_RADIUS
    weight = (FIT_NOISE / BODY_SPREAD) ** 2
    for _ in range(8):
        # A whisper of damping: a single point does not say where around it the centre is.
        # Normal equations of (x, y, radius): xx, xy, ... of the matrix, u, v, w on the right.
        xx, xy, xr, yy, yr, rr = 1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3 + weight
        u, v, w = 0.0, 0.0, -weight * (radius - BODY_RADIUS)
        for i in range(n):
            dx, dy = points[i, 0] - x, points[i, 1] - y
            d = max(np.hypot(dx, dy), 1e-9)
            ex, ey, off = dx / d, dy / d, d - radius
            xx, xy, xr = xx + ex * ex, xy + ex * ey, xr + ex
            yy, yr, rr = yy + ey * ey, yr + ey, rr + 1.0
            u, v, w = u + ex * off, v + ey * off, w + off
        # Elimination; the matrix is positive definite, so no pivot vanishes.
        fy, fr = xy / xx, xr / xx
        yy, yr, v = yy - fy * xy, yr - fy * xr, v - fy * u
        rr, w = rr - fr * xr, w - fr * u
        fr = yr / yy
        step_r = (w - fr * v) / (rr - fr * yr)
        step_y = (v - yr * step_r) / yy
        step_x = (u - xy * step_y - xr * step_r) / xx
        x, y, radius = x + step_x, y + step_y, radius + step_r
    error = 0.0
    for i in range(n):
        error += (np.hypot(points[i, 0] - x, points[i, 1] - y) - radius) ** 2
    behind = x * sum_x + y * sum_y
    # Curved the other way, or around the robot: no body.
    if behind <= 0 or np.hypot(x, y) < nearest or radius < 0.02:
        return x, y, np.inf, np.inf
    return x, y, radius, np.sqrt(error / n)
