"""LiDAR: rays against the true shapes, circles and segments."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.simulation.rounding import sum_of_products

TWO_PI = 2 * math.pi


def beam_table(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """(beams, 3) cosine, sine and angle [rad] of evenly spaced, ascending beams."""
    return np.column_stack([np.cos(angles), np.sin(angles), angles])


@compiled(inline="always")
def cast_rays(
    pose: NDArray[np.float64],
    beams: NDArray[np.float64],
    pedestrians: NDArray[np.float64],
    obstacles: NDArray[np.float64],
    segments: NDArray[np.float64],
    largest: float,
    out: NDArray[np.float32],
) -> float:
    """Distance along each beam to the nearest surface.

    Shapes are moved into the sensor frame, where each visits only the beams it may cover.

    Args:
        pose: (3,) sensor x, y [m], heading [rad].
        beams: (beams, 3) from ``beam_table``.
        pedestrians: (P, 3) x, y, radius [m].
        obstacles: (K, 3) x, y, radius [m].
        segments: (S, 4) x1, y1, x2, y2 [m].
        largest: range reported when nothing is hit [m].
        out: (beams,) distances [m], written.

    Returns:
        The least distance, ``largest`` when nothing is hit [m].
    """
    for i in range(len(out)):  # numpy's forms take numba longer to compile than all the rest
        out[i] = largest
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    for p in range(len(pedestrians)):
        x, y = pedestrians[p, 0] - pose[0], pedestrians[p, 1] - pose[1]
        x, y = cosine * x + sine * y, cosine * y - sine * x
        _circle(x, y, pedestrians[p, 2], largest, beams, out)
    for k in range(len(obstacles)):
        x, y = obstacles[k, 0] - pose[0], obstacles[k, 1] - pose[1]
        x, y = cosine * x + sine * y, cosine * y - sine * x
        _circle(x, y, obstacles[k, 2], largest, beams, out)
    for s in range(len(segments)):
        if (
            max(segments[s, 0], segments[s, 2]) < pose[0] - largest
            or min(segments[s, 0], segments[s, 2]) > pose[0] + largest
            or max(segments[s, 1], segments[s, 3]) < pose[1] - largest
            or min(segments[s, 1], segments[s, 3]) > pose[1] + largest
        ):
            continue
        x1, y1 = segments[s, 0] - pose[0], segments[s, 1] - pose[1]
        x2, y2 = segments[s, 2] - pose[0], segments[s, 3] - pose[1]
        x1, y1 = cosine * x1 + sine * y1, cosine * y1 - sine * x1
        x2, y2 = cosine * x2 + sine * y2, cosine * y2 - sine * x2
        _segment(x1, y1, x2, y2, beams, out)
    nearest = np.float64(largest)
    for i in range(len(out)):
        nearest = min(nearest, np.float64(out[i]))
    return nearest


@compiled()
def _visited(offset: float, span: float, beams: NDArray[np.float64]) -> tuple[int, int]:
    """Beams between offset and offset + span, angles from the first beam: a half-open range.

    One beam more on either side, so that rounding opens no gap between two shapes.
    """
    spacing = beams[1, 2] - beams[0, 2] if len(beams) > 1 else TWO_PI
    lowest = max(0, math.floor(offset / spacing))
    return lowest, min(len(beams), math.ceil((offset + span) / spacing) + 1)


@compiled()
def _circle(
    x: float,
    y: float,
    radius: float,
    largest: float,
    beams: NDArray[np.float64],
    out: NDArray[np.float32],
) -> None:
    """Shorten the beams that meet a circle at (x, y) in the sensor frame."""
    squared = x * x + y * y
    if squared <= radius * radius:
        for i in range(len(out)):
            out[i] = 0.0
        return
    distance = math.sqrt(squared)
    if distance - radius >= largest:
        return
    half = math.asin(radius / distance)
    offset = (math.atan2(y, x) - half - beams[0, 2]) % TWO_PI
    for turn in range(2):
        lowest, highest = _visited(offset - turn * TWO_PI, 2 * half, beams)
        for i in range(lowest, highest):
            along = x * beams[i, 0] + y * beams[i, 1]
            inside = along * along - squared + radius * radius
            if inside >= 0.0 and along > 0.0:
                out[i] = min(out[i], along - math.sqrt(inside))


@compiled(inline="always")
def _segment(
    x1: float,
    y1: float,
    x2: float,
    y2: float,
    beams: NDArray[np.float64],
    out: NDArray[np.float32],
) -> None:
    """Shorten the beams that meet a segment given in the sensor frame."""
    turn_area = x1 * y2 - x2 * y1
    if turn_area < 0.0:
        x1, y1, x2, y2, turn_area = x2, y2, x1, y1, -turn_area
    dx, dy = x2 - x1, y2 - y1
    first = math.atan2(y1, x1)
    span = (math.atan2(y2, x2) - first) % TWO_PI
    offset = (first - beams[0, 2]) % TWO_PI
    for turn in range(2):
        lowest, highest = _visited(offset - turn * TWO_PI, span, beams)
        for i in range(lowest, highest):
            across = beams[i, 0] * dy - beams[i, 1] * dx
            if across == 0.0:
                continue
            hit = turn_area / across
            along = (x1 * beams[i, 1] - y1 * beams[i, 0]) / across
            if hit >= 0.0 and -1e-12 <= along <= 1.0 + 1e-12:
                out[i] = min(out[i], hit)


@compiled()
def footprint_segments(
    pose: NDArray[np.float64], length: float, width: float
) -> NDArray[np.float64]:
    """(4, 4) edges of a rectangular footprint at ``pose`` (x, y [m], heading [rad])."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    edges = np.empty((4, 4))
    for k in range(4):
        x = length / 2 if k in (0, 3) else -length / 2
        y = width / 2 if k < 2 else -width / 2
        edges[k, 0] = sum_of_products(x, cosine, y, -sine) + pose[0]
        edges[k, 1] = sum_of_products(x, sine, y, cosine) + pose[1]
    for k in range(4):
        edges[k, 2], edges[k, 3] = edges[(k + 1) % 4, 0], edges[(k + 1) % 4, 1]
    return edges
