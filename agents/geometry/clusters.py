"""What a scan shows: round things with velocities, and long straight ones.

Neighbouring beams that hit nearly the same place form a cluster. A short cluster is a disc (a
circle is fitted to the points), a long one a chain of segments. Discs are tracked from scan to
scan in the odometry frame with an alpha-beta filter, which gives their velocities.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from crowdbench_agents.geometry.footprint import turned
from crowdbench_agents.geometry.scan import ScanGeometry
from crowdbench_agents.geometry.steering import slow_to_react
from numpy.typing import NDArray

import crowdbench
from crowdbench.compiled import compiled

BREAK, SLANT = 0.15, 2.0
"""Points of neighbouring beams farther apart than this [m], and farther than ``SLANT`` times their
spacing on a surface that faces the robot, belong to different clusters."""
STRAIGHT = 0.015
"""A cluster that deviates less from its chord is straight [m]."""
LONG = 1.1
"""A cluster wider than this is a chain of segments even if it is not straight [m]."""
RADII = (0.15, 0.6)
"""Radii that a fitted circle may have [m]."""
FIT_ERROR = 0.03
"""Largest root mean square error of a fitted circle [m]."""
ALPHA, BETA = 0.8, 0.5
"""Gains of the filter for position and velocity, where a circle was fitted."""
GATE = 0.5
"""Farthest a disc may be from where it was expected [m]."""
MEMORY = 5
"""Scans for which a hidden disc is remembered, if a circle was once fitted to it."""
OF_DISC = 0.1
"""A point this near to the rim of a disc belongs to it [m]."""
STILL = 0.1
"""Discs slower than this stand still [m/s]."""


@dataclass(frozen=True)
class Scene:
    """What is around the robot, in the odometry frame.

    Attributes:
        discs: (N, 5) x, y [m], velocity x, y [m/s], radius [m].
        segments: (S, 4) x1, y1, x2, y2 [m].
    """

    discs: NDArray[np.float64]
    segments: NDArray[np.float64]

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(N,) which discs move."""
        return np.hypot(self.discs[:, 2], self.discs[:, 3]) > STILL


class Tracker:
    """Turns the scans of one episode into scenes."""

    def __init__(self, robot: crowdbench.RobotSpec) -> None:
        """Begin without any memory."""
        angles = robot.lidar_angles
        self._geometry = ScanGeometry(robot)
        self._cos, self._sin = np.cos(angles), np.sin(angles)
        self._range = robot.lidar_range
        self._period = robot.control_period
        self._bridges = slow_to_react(robot)
        # Columns: x, y, vx, vy, radius, scans since last seen, fitted before.
        self._tracks = np.empty((0, 7))

    def update(self, observation: crowdbench.Observation) -> Scene:
        """Take in the next scan."""
        lidar = observation.lidar.astype(np.float64)
        found, segments = _clusters(
            self._geometry.bridged(lidar) if self._bridges else lidar,
            self._geometry.origin(observation.pose.astype(np.float64)),
            self._cos,
            self._sin,
            self._range,
            self._geometry.step,
            self._geometry.circle,
        )
        self._tracks = _track(self._tracks, found, self._period)
        return Scene(self._tracks[:, :5].copy(), segments)

    def without_moving(
        self, observation: crowdbench.Observation, scene: Scene
    ) -> NDArray[np.float64]:
        """(beams,) the scan as if the moving discs of its scene were not there [m]."""
        lidar = observation.lidar.astype(np.float64)
        x, y, heading = self._geometry.origin(observation.pose.astype(np.float64)).tolist()
        centres = scene.discs[scene.moving, :2] - [x, y]
        centres = turned(centres, math.cos(heading), math.sin(heading))
        points = lidar[:, None] * self._geometry.directions
        gaps = np.linalg.norm(points[:, None] - centres, axis=2) - scene.discs[scene.moving, 4]
        return np.where((np.abs(gaps) < OF_DISC).any(axis=1), self._range, lidar)


@compiled()
def _clusters(lidar, pose, beam_cos, beam_sin, reach, step, circle):
    """Discs (N, 4): x, y, radius, whether fitted; segments (S, 4) of the long clusters.

    Beams begin at ``pose``, and their directions are from its heading.
    """
    beams = len(lidar)
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    points = np.empty((beams, 2))
    hit = np.empty(beams, dtype=np.bool_)
    for i in range(beams):
        hit[i] = lidar[i] < reach - 1e-3
        px, py = lidar[i] * beam_cos[i], lidar[i] * beam_sin[i]
        points[i, 0] = pose[0] + cosine * px - sine * py
        points[i, 1] = pose[1] + sine * px + cosine * py
    joined = np.zeros(beams, dtype=np.bool_)
    start = 0
    for i in range(beams):
        before = i - 1 if i > 0 else beams - 1
        if hit[i] and hit[before] and (i > 0 or circle):
            gap = math.hypot(points[i, 0] - points[before, 0], points[i, 1] - points[before, 1])
            spacing = step * min(lidar[i], lidar[before])
            joined[i] = gap < max(BREAK, SLANT * spacing)
        if not joined[i]:
            start = i
    discs, segments = np.empty((beams, 4)), np.empty((beams, 4))
    n_discs, n_segments = 0, 0
    members = np.empty((beams, 2))
    count = 0
    for k in range(1, beams + 1):
        # From the first beam after a break all the way round.
        i = (start + k - 1) % beams
        if hit[i]:
            members[count, 0], members[count, 1] = points[i, 0], points[i, 1]
            count += 1
        ends = k == beams or not joined[(start + k) % beams]
        if not ends or count == 0:
            continue
        if _is_chain(members, count):
            for j in range(count - 1):
                # Element by element: numba compiles numpy's message about shapes for rows.
                segments[n_segments, 0], segments[n_segments, 1] = members[j, 0], members[j, 1]
                segments[n_segments, 2] = members[j + 1, 0]
                segments[n_segments, 3] = members[j + 1, 1]
                n_segments += 1
        else:
            _disc(members, count, pose, discs[n_discs])
            n_discs += 1
        count = 0
    return _without_crumbs(discs[:n_discs]), segments[:n_segments]


@compiled()
def _without_crumbs(discs):
    """The discs without those guessed from points on the rim of a fitted one.

    Beams that graze a rim are far apart and break from its cluster.
    """
    kept = np.ones(len(discs), dtype=np.bool_)
    for i in range(len(discs)):
        for j in range(len(discs)):
            apart = math.hypot(discs[i, 0] - discs[j, 0], discs[i, 1] - discs[j, 1])
            if discs[i, 3] == 0.0 and discs[j, 3] > 0.0 and apart < discs[j, 2] + OF_DISC:
                kept[i] = False
    return discs[kept]


@compiled()
def _is_chain(points, count):
    """Whether points in order are too many or too straight for a disc."""
    ex, ey = points[count - 1, 0] - points[0, 0], points[count - 1, 1] - points[0, 1]
    width = math.hypot(ex, ey)
    if width > LONG:
        return True
    if count < 3:
        return False
    for j in range(1, count - 1):
        cross = ex * (points[j, 1] - points[0, 1]) - ey * (points[j, 0] - points[0, 0])
        if abs(cross) > STRAIGHT * width:
            return False
    return True


@compiled()
def _disc(points, count, pose, disc):
    """Write (x, y, radius, fitted) of the circle through points (algebraic fit, Kasa 1976)."""
    mx, my = 0.0, 0.0
    for j in range(count):
        mx, my = mx + points[j, 0], my + points[j, 1]
    mx, my = mx / count, my / count
    if count >= 3:
        suu, suv, svv, suz, svz, sz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(count):
            u, v = points[j, 0] - mx, points[j, 1] - my
            z = u * u + v * v
            suu, suv, svv = suu + u * u, suv + u * v, svv + v * v
            suz, svz, sz = suz + u * z, svz + v * z, sz + z
        determinant = suu * svv - suv * suv
        if determinant > 1e-12:
            a = (suz * svv - svz * suv) / (2 * determinant)
            b = (svz * suu - suz * suv) / (2 * determinant)
            radius = math.sqrt(a * a + b * b + sz / count)
            error = 0.0
            for j in range(count):
                off = math.hypot(points[j, 0] - mx - a, points[j, 1] - my - b) - radius
                error += off * off / count
            # The centre lies behind the points that are seen.
            behind = a * (mx - pose[0]) + b * (my - pose[1]) > 0.0
            if RADII[0] <= radius <= RADII[1] and error < FIT_ERROR * FIT_ERROR and behind:
                disc[0], disc[1], disc[2], disc[3] = mx + a, my + b, radius, 1.0
                return
    width = math.hypot(points[count - 1, 0] - points[0, 0], points[count - 1, 1] - points[0, 1])
    disc[0], disc[1], disc[2], disc[3] = mx, my, max(0.05, 0.5 * width), 0.0


@compiled()
def _track(tracks, found, period):
    """Move the tracks on, correct them by what was found, forget the old and begin the new."""
    kept = np.empty((len(tracks) + len(found), 7))
    count = 0
    taken = np.zeros(len(found), dtype=np.bool_)
    expected = tracks.copy()
    for t in range(len(tracks)):
        expected[t, 0] += period * tracks[t, 2]
        expected[t, 1] += period * tracks[t, 3]
    matched = np.full(len(tracks), -1)
    for _ in range(len(tracks)):
        best, best_t, best_f = GATE, -1, -1
        for t in range(len(tracks)):
            if matched[t] < 0:
                for f in range(len(found)):
                    gap = math.hypot(expected[t, 0] - found[f, 0], expected[t, 1] - found[f, 1])
                    if not taken[f] and gap < best:
                        best, best_t, best_f = gap, t, f
        if best_t < 0:
            break
        matched[best_t] = best_f
        taken[best_f] = True
    for t in range(len(tracks)):
        track = expected[t]
        if matched[t] >= 0:
            disc = found[matched[t]]
            dx, dy = disc[0] - track[0], disc[1] - track[1]
            if disc[3] > 0.0 and track[6] > 0.0:
                track[0], track[1] = track[0] + ALPHA * dx, track[1] + ALPHA * dy
                track[2], track[3] = track[2] + BETA * dx / period, track[3] + BETA * dy / period
                track[4] += ALPHA * (disc[2] - track[4])
            elif disc[3] > 0.0 or track[6] == 0.0:
                # A guessed centre moves with the robot, so it says nothing about the velocity.
                track[0], track[1], track[4] = disc[0], disc[1], disc[2]
            track[5] = 0.0
            track[6] = max(track[6], disc[3])
        else:
            track[5] += 1.0
        if track[5] == 0.0 or (track[6] > 0.0 and track[5] <= MEMORY):
            for column in range(7):
                kept[count, column] = track[column]
            count += 1
    for f in range(len(found)):
        if not taken[f]:
            kept[count, 0], kept[count, 1] = found[f, 0], found[f, 1]
            kept[count, 2], kept[count, 3] = 0.0, 0.0
            kept[count, 4], kept[count, 5], kept[count, 6] = found[f, 2], 0.0, found[f, 3]
            count += 1
    return kept[:count]
