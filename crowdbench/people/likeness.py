"""What people do when they walk among others, as distributions that can be compared.

Real and simulated people come in the same form, ``Frames``, and are measured by the same functions,
so that what differs is how they walk and not how it was measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

AROUND = 1.5
"""Radius of the circle in which density is counted [m]."""
NEAR = 5.0
"""Beyond which nobody is anybody's neighbour [m]."""
BODY = 0.2
"""Radius of a body for times to collision [m]."""
SOON = 5.0
"""Times to collision above this are left out [s]."""
SMOOTH = 2
"""Steps before and after between which a velocity is measured: heads sway."""
LANE = 0.75
"""Half the width of the band in which people walk behind each other [m]."""
PASSING = 2.0
"""Beyond which two people do not pass each other [m]."""


@dataclass(frozen=True)
class Frames:
    """People at equal steps of time.

    Attributes:
        position: (T, P, 2) [m]; NaN where a person is not there.
        period: between two of them [s].
    """

    position: FloatArray
    period: float

    @cached_property
    def velocity(self) -> FloatArray:
        """(T, P, 2) over ``SMOOTH`` steps before and after [m/s]; NaN at either end of a way."""
        velocity = np.full_like(self.position, np.nan)
        ahead, behind = self.position[2 * SMOOTH :], self.position[: -2 * SMOOTH]
        velocity[SMOOTH:-SMOOTH] = (ahead - behind) / (2 * SMOOTH * self.period)
        return velocity

    @cached_property
    def speed(self) -> FloatArray:
        """(T, P) [m/s]."""
        return np.sqrt((self.velocity**2).sum(axis=2))

    def part(self, begin: int, end: int) -> Frames:
        """Some of the steps."""
        return Frames(self.position[begin:end], self.period)


def local_density(frames: Frames) -> FloatArray:
    """(T, P) people within ``AROUND`` of everybody, oneself included, by that area [1/m2]."""
    density = np.where(np.isfinite(frames.speed), 1 / (np.pi * AROUND**2), np.nan)
    for k, there, offset in _neighbours(frames):
        apart = np.sqrt((offset**2).sum(axis=2))
        density[k, there] = (apart <= AROUND).sum(axis=1) / (np.pi * AROUND**2)
    return density


def densities(frames: Frames) -> tuple[FloatArray, FloatArray]:
    """Density around everybody [1/m2] and how fast they walk in it [m/s], a value per step."""
    density = local_density(frames)
    known = np.isfinite(density)
    return density[known], frames.speed[known]


def nearest_distance(frames: Frames) -> FloatArray:
    """Distance from everybody to the nearest other [m], a value per step and person."""
    return _joined([_apart(offset).min(axis=1) for _, _, offset in _neighbours(frames)])


def time_to_collision(frames: Frames) -> FloatArray:
    """Least time to collision with anybody, below ``SOON`` [s]."""
    found = []
    for k, there, offset in _neighbours(frames):
        velocity = frames.velocity[k, there]
        relative = velocity[None] - velocity[:, None]
        square, approach = (relative**2).sum(axis=2), -(offset * relative).sum(axis=2)
        outside = (offset**2).sum(axis=2) - (2 * BODY) ** 2
        inside = approach**2 - square * outside
        meets = (outside > 0) & (approach > 0) & (inside >= 0)
        root = approach + np.sqrt(np.where(meets, inside, 0.0))
        time = np.where(meets, outside / np.where(meets, root, 1.0), np.inf)
        np.fill_diagonal(time, np.inf)
        least = time.min(axis=1, initial=np.inf)
        found.append(least[least < SOON])
    return _joined(found)


def passing_distance(frames: Frames) -> FloatArray:
    """How far to its left somebody has the other whom it passes, walking the other way [m].

    Of each pair the step at which they are nearest, within ``PASSING``; negative on the right.
    """
    nearest: dict[tuple[int, int], tuple[float, float]] = {}
    for k, there, offset in _neighbours(frames):
        velocity, rows = frames.velocity[k, there], np.flatnonzero(there)
        speed = frames.speed[k, there]
        unit = velocity / np.maximum(speed, 1e-9)[:, None]
        opposite = (unit[:, None] * unit[None]).sum(axis=2) < -0.7
        moving = (speed[:, None] > 0.3) & (speed[None] > 0.3)
        apart = _apart(offset)
        left = unit[:, None, 0] * offset[..., 1] - unit[:, None, 1] * offset[..., 0]
        for i, j in np.argwhere(opposite & moving & (apart < PASSING)).tolist():
            pair = int(rows[i]), int(rows[j])
            if apart[i, j] < nearest.get(pair, (np.inf, 0.0))[0]:
                nearest[pair] = float(apart[i, j]), float(left[i, j])
    return np.array([left for _, left in nearest.values()])


def lane_order(frames: Frames) -> FloatArray:
    """Order of lanes around everybody, 0 where both directions mix and 1 in a lane of one.

    ((same - opposite) / (same + opposite))^2 of those who walk within ``LANE`` beside its line
    (Rex and Loewen, "Lane formation in oppositely charged colloids driven by an electric field",
    Phys. Rev. E 75, 2007).
    """
    found = []
    for k, there, offset in _neighbours(frames):
        velocity, speed = frames.velocity[k, there], frames.speed[k, there]
        unit = velocity / np.maximum(speed, 1e-9)[:, None]
        beside = np.abs(unit[:, None, 0] * offset[..., 1] - unit[:, None, 1] * offset[..., 0])
        along = (unit[:, None] * unit[None]).sum(axis=2)
        walks = (speed > 0.2) & (beside <= LANE) & (_apart(offset) < NEAR)
        same, against = (walks & (along > 0.5)).sum(axis=1), (walks & (along < -0.5)).sum(axis=1)
        known = (same + against > 0) & (speed > 0.2)
        order = (same - against) / np.maximum(same + against, 1)
        found.append(order[known] ** 2)
    return _joined(found)


def detour(frames: Frames) -> FloatArray:
    """Length of everybody's way over the straight line, of ways of 1 m and more."""
    ratios = []
    for way in frames.position.transpose(1, 0, 2):
        places = way[np.isfinite(way[:, 0])]
        if len(places) > 1:
            straight = float(np.sqrt(((places[-1] - places[0]) ** 2).sum()))
            length = float(np.sqrt((np.diff(places, axis=0) ** 2).sum(axis=1)).sum())
            if straight >= 1.0:
                ratios.append(length / straight)
    return np.array(ratios)


def acceleration(frames: Frames) -> FloatArray:
    """Change of everybody's velocity [m/s2], a value per step and person."""
    change = np.diff(frames.velocity, axis=0) / frames.period
    size = np.sqrt((change**2).sum(axis=2))
    return size[np.isfinite(size)]


MEASURES: Mapping[str, tuple[Callable[[Frames], FloatArray], str]] = {
    "speed": (lambda frames: frames.speed[np.isfinite(frames.speed)], "m/s"),
    "density": (lambda frames: densities(frames)[0], "1/m²"),
    "nearest distance": (nearest_distance, "m"),
    "time to collision": (time_to_collision, "s"),
    "passing distance": (passing_distance, "m"),
    "lane order": (lane_order, ""),
    "detour": (detour, ""),
    "acceleration": (acceleration, "m/s²"),
}
"""Distributions by which crowds are compared, with their units."""


def _neighbours(frames: Frames) -> Iterator[tuple[int, NDArray[np.bool_], FloatArray]]:
    """Steps, who is there with a known velocity, and (N, N, 2) from each to each [m]."""
    known = np.isfinite(frames.velocity[..., 0])
    for k in np.flatnonzero(known.sum(axis=1) > 1).tolist():
        there = known[k]
        places = frames.position[k, there]
        yield k, there, places[None] - places[:, None]


def _apart(offset: FloatArray) -> FloatArray:
    """(N, N) distances, infinite to oneself [m]."""
    apart = np.sqrt((offset**2).sum(axis=2))
    np.fill_diagonal(apart, np.inf)
    return apart


def _joined(parts: list[FloatArray]) -> FloatArray:
    return np.concatenate(parts) if parts else np.empty(0)
