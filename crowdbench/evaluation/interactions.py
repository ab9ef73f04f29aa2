"""What happens between a robot and the pedestrians: distances, time to collision, cut-offs.

Pure functions of arrays, N states, P pedestrians; ``docs/metrics.md`` has figures to check by
hand. Positions are in the world frame, and nothing here depends on how that frame is placed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from crowdbench.libm import atan2

Array = NDArray[np.float64]

WALKING_SPEED = 0.1
"""Below this a pedestrian stands and has no path to be cut off from [m/s]."""
TIME_GAP = 2.0
"""A crossing is a cut-off when the pedestrian would arrive sooner than this [s]."""
EVENT_SPACING = 1.0
"""Cut-offs of the same pedestrian closer than this are one event [s]."""
NEAR = 0.2
"""A near miss is nearer than this, between surfaces [m]."""
FAST = 0.5
"""And closes in faster than this [m/s]."""


def centre_distance(robot_position: Array, pedestrian_position: Array) -> Array:
    """Distance between centres.

    Args:
        robot_position: (N, 2) [m].
        pedestrian_position: (N, P, 2) [m].

    Returns:
        (N, P) [m].
    """
    offset = pedestrian_position - robot_position[:, None]
    return np.asarray(np.linalg.norm(offset, axis=2))


def clearance(
    robot_pose: Array,
    footprint: tuple[float, float],
    pedestrian_position: Array,
    pedestrian_radius: Array,
) -> Array:
    """Distance between the robot's rectangle and the pedestrians' discs, 0 when they touch.

    Args:
        robot_pose: (N, 3) x, y [m], heading [rad].
        footprint: length and width [m].
        pedestrian_position: (N, P, 2) [m].
        pedestrian_radius: (P,) [m].

    Returns:
        (N, P) [m].
    """
    offset = pedestrian_position - robot_pose[:, None, :2]
    cos, sin = np.cos(robot_pose[:, 2:]), np.sin(robot_pose[:, 2:])
    ahead = cos * offset[..., 0] + sin * offset[..., 1]
    left = cos * offset[..., 1] - sin * offset[..., 0]
    beyond_end = np.maximum(np.abs(ahead) - footprint[0] / 2, 0.0)
    beyond_side = np.maximum(np.abs(left) - footprint[1] / 2, 0.0)
    return np.asarray(np.maximum(np.hypot(beyond_end, beyond_side) - pedestrian_radius, 0.0))


def hull_distance(robot_position: Array, people: Array) -> Array:
    """Distance from the robot's centre to the convex hull of the centres of some people.

    Args:
        robot_position: (N, 2) [m].
        people: (N, M, 2), at least two [m].

    Returns:
        (N,) [m]; 0 inside.
    """
    offset = people - robot_position[:, None]
    first, second = np.triu_indices(people.shape[1], 1)
    begin, edge = offset[:, first], offset[:, second] - offset[:, first]
    length2 = np.sum(edge**2, axis=2)
    share = -np.sum(begin * edge, axis=2) / np.where(length2 > 0, length2, 1.0)
    nearest = begin + np.clip(share, 0.0, 1.0)[..., None] * edge
    distance = np.linalg.norm(nearest, axis=2).min(axis=1)
    # Inside, people are all around: no gap between neighbouring directions is half a turn.
    angles = np.sort(atan2(offset[..., 1], offset[..., 0]), axis=1)
    gaps = np.diff(angles, axis=1, append=angles[:, :1] + 2 * np.pi)
    return np.where(gaps.max(axis=1) < np.pi, 0.0, distance)


def time_to_collision(offset: Array, relative_velocity: Array, reach: Array) -> Array:
    """Time until two discs touch if both keep their velocity.

    The smallest t >= 0 with |x + w t| = R.

    Args:
        offset: (..., 2) x, from one centre to the other [m].
        relative_velocity: (..., 2) w, the velocity of the other less one's own [m/s].
        reach: (...) R, the sum of the radii [m].

    Returns:
        (...) [s]; 0 when they overlap already, infinite when they never touch.
    """
    square_speed = np.sum(relative_velocity**2, axis=-1)
    approach = -np.sum(offset * relative_velocity, axis=-1)
    outside = np.sum(offset**2, axis=-1) - reach**2
    discriminant = approach**2 - square_speed * outside
    meets = (outside > 0) & (approach > 0) & (discriminant >= 0)
    # The quadratic's smaller root, in the form that does not cancel.
    root = approach + np.sqrt(np.where(meets, discriminant, 0.0))
    time = np.where(meets, outside / np.where(meets, root, 1.0), np.inf)
    return np.where(outside <= 0, 0.0, time)


def crossing_gaps(
    robot_position: Array,
    pedestrian_position: Array,
    pedestrian_velocity: Array,
    period: float,
    reach: Array,
) -> Array:
    """Projected time gap wherever the robot crosses the path ahead of a walking pedestrian.

    The path is the ray from the pedestrian along its velocity, both as they were when the step
    began: only the robot's own motion can cross it, a pedestrian that turns on the spot cannot
    sweep it over the robot. At the moment of crossing, the gap is the time the pedestrian's
    surface would still need to the robot's (0 if they would overlap).

    Args:
        robot_position: (N, 2) [m].
        pedestrian_position: (N, P, 2) [m].
        pedestrian_velocity: (N, P, 2) [m/s].
        period: time between two states [s].
        reach: (P,) the robot's radius plus each pedestrian's [m].

    Returns:
        (N - 1, P) gap of each step [s]; infinite where no path is crossed.
    """
    velocity = pedestrian_velocity[:-1]
    speed = np.linalg.norm(velocity, axis=2)
    walks = speed >= WALKING_SPEED
    speed = np.where(walks, speed, 1.0)
    ahead = velocity / speed[..., None]
    before = robot_position[:-1, None] - pedestrian_position[:-1]
    after = robot_position[1:, None] - pedestrian_position[:-1]
    side_before, side_after = _cross(ahead, before), _cross(ahead, after)
    # Arriving on the line counts, leaving it does not: one crossing is never counted twice.
    crosses = walks & (side_before != 0) & (side_before * side_after <= 0)
    share = side_before / np.where(crosses, side_before - side_after, 1.0)
    place = np.sum(ahead * (before + share[..., None] * (after - before)), axis=2)
    distance = place - speed * share * period
    gap = np.maximum(distance - reach, 0.0) / speed
    return np.where(crosses & (distance > 0), gap, np.inf)


def cut_offs(gaps: Array, period: float, limit: float = TIME_GAP) -> list[tuple[int, int]]:
    """Crossings with a gap below ``limit``, per pedestrian one per ``EVENT_SPACING``.

    Args:
        gaps: (N, P) from ``crossing_gaps`` [s].
        period: time between two states [s].
        limit: [s].

    Returns:
        (step, pedestrian) of each, in their order.
    """
    found = []
    last: dict[int, int] = {}
    spacing = EVENT_SPACING / period - 1e-9  # in steps; a rounding error must not add one
    for step, pedestrian in np.argwhere(gaps < limit).tolist():
        if pedestrian not in last or step - last[pedestrian] >= spacing:
            last[pedestrian] = step
            found.append((step, pedestrian))
    return found


def closing_speed(offset: Array, relative_velocity: Array) -> Array:
    """How fast two centres come nearer to each other, negative when they part.

    Args:
        offset: (..., 2) from one centre to the other [m].
        relative_velocity: (..., 2) the velocity of the other less one's own [m/s].

    Returns:
        (...) [m/s]; 0 for centres at one place.
    """
    distance = np.linalg.norm(offset, axis=-1)
    approach = -np.sum(offset * relative_velocity, axis=-1)
    return np.asarray(approach / np.where(distance > 0, distance, 1.0))


def near_misses(
    clearance: Array, closing_speed: Array, touched: int | None = None
) -> list[tuple[int, int]]:
    """Approaches to less than ``NEAR`` in which somebody closes in faster than ``FAST``.

    An approach lasts while the clearance to a pedestrian stays below ``NEAR``.

    Args:
        clearance: (N, P) between surfaces [m].
        closing_speed: (N, P) [m/s].
        touched: the pedestrian with whom it ended in contact; the approach that led there is a
            collision and no near miss.

    Returns:
        (state, pedestrian) of each, in their order: the first state that is near and fast.
    """
    near = clearance < NEAR
    begins = near & ~np.vstack([np.zeros_like(near[:1]), near[:-1]])
    approach = np.cumsum(begins, axis=0)
    found: dict[tuple[int, int], tuple[int, int]] = {}
    for state, pedestrian in np.argwhere(near & (closing_speed > FAST)).tolist():
        key = (pedestrian, int(approach[state, pedestrian]))
        found.setdefault(key, (state, pedestrian))
    if touched is not None and near[-1, touched]:
        found.pop((touched, int(approach[-1, touched])), None)
    return list(found.values())


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
