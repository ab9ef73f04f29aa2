"""DUNE: how far a point is from the robot's footprint, and in which direction, as dual variables.

A convex footprint is {x : G x <= h} in the robot frame, with E unit normals G (E, 2) pointing
outwards. Its distance to a point p is the value of the dual problem (NeuPAN, Han et al. 2023)

    d(p) = max  mu' (G p - h)   subject to   mu >= 0,  |G' mu| <= 1,

so any feasible mu gives a lower bound on the distance that is linear in p: exactly what a convex
planner needs. With y* the point of the footprint nearest to p and n = (p - y*) / d, the optimum
has a closed form: mu_i = 1 when y* lies on edge i alone, [g_a g_b] mu = n when y* is the corner
between edges a and b, and mu = 0 inside. The deep unfolded encoder, DUNE, learns that map for one
footprint. The closed form makes its training labels and judges it afterwards.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from crowdbench.compiled import compiled

Array = NDArray[np.float64]
PARTS = ("weight", "bias")
"""Of a layer, in the names of tensors."""


class WeightsError(ValueError):
    """A weights file that must not be used; the message names the file and the reason."""


@dataclass(frozen=True)
class Footprint:
    """A convex polygon around the robot's reference point.

    Attributes:
        corners: (E, 2) counter-clockwise [m].
        G: (E, 2) unit outward normals; edge i runs from corner i to corner i + 1.
        h: (E,) offsets [m].
    """

    corners: Array
    G: Array
    h: Array

    @classmethod
    def from_corners(cls, corners: NDArray[np.floating]) -> Footprint:
        """Make a footprint from its corners in counter-clockwise order.

        Raises:
            ValueError: fewer than three corners, or not strictly convex and counter-clockwise.
        """
        points = np.asarray(corners, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
            raise ValueError(f"footprint corners: expected (3 or more, 2), got {points.shape}")
        edges = np.roll(points, -1, axis=0) - points
        after = np.roll(edges, -1, axis=0)
        turns = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
        turned = np.sum(np.arctan2(turns, np.sum(edges * after, axis=1)))
        if not (np.all(turns > 1e-9) and np.isclose(turned, 2 * np.pi)):
            raise ValueError("footprint corners: expected a convex polygon, counter-clockwise")
        normals = np.column_stack([edges[:, 1], -edges[:, 0]])
        G = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return cls(points, G, np.sum(G * points, axis=1))

    def dual(self, points: Array) -> Array:
        """(N, E) optimal dual variables of (N, 2) points in the robot frame, in closed form."""
        return _dual(np.ascontiguousarray(points, dtype=np.float64), self.corners, self.G)

    def distance(self, points: Array, mu: Array) -> Array:
        """(N,) value mu' (G p - h) of the dual problem [m]."""
        return np.sum(mu * (points @ self.G.T - self.h), axis=1)

    def with_interior(self, points: Array, mu: Array) -> Array:
        """Give points inside the footprint the edge they are nearest to.

        Inside, mu = 0 is optimal and says nothing about the way out. The unit vector of the
        nearest edge is feasible too and its value, minus the depth, continues the distance.
        """
        _point_out(points, mu, self.G, self.h)
        return mu


@compiled()
def _dual(points: Array, corners: Array, G: Array) -> Array:  # pragma: no cover - compiled
    n, e = len(points), len(corners)
    mu = np.zeros((n, e))
    for k in range(n):
        px, py = points[k]
        best, edge, place, nx, ny, outside = np.inf, 0, 0.0, 0.0, 0.0, False
        for i in range(e):
            ax, ay = corners[i]
            bx, by = corners[(i + 1) % e]
            outside |= G[i, 0] * (px - ax) + G[i, 1] * (py - ay) > 0
            t = ((px - ax) * (bx - ax) + (py - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)
            t = min(max(t, 0.0), 1.0)
            dx, dy = px - ax - t * (bx - ax), py - ay - t * (by - ay)
            d = np.sqrt(dx * dx + dy * dy)
            if d < best:
                best, edge, place, nx, ny = d, i, t, dx, dy
        if not outside or best == 0.0:
            continue
        if 0.0 < place < 1.0:
            mu[k, edge] = 1.0
            continue
        a = (edge - 1) % e if place == 0.0 else edge
        b = (a + 1) % e
        nx, ny = nx / best, ny / best
        det = G[a, 0] * G[b, 1] - G[a, 1] * G[b, 0]
        mu[k, a] = max(0.0, (nx * G[b, 1] - ny * G[b, 0]) / det)
        mu[k, b] = max(0.0, (ny * G[a, 0] - nx * G[a, 1]) / det)
    return mu


SHARPNESS = 20.0
"""Of the softplus that ends the network: nearly a ReLU, which is what mu >= 0 looks like."""


@compiled()
def _point_out(points: Array, mu: Array, G: Array, h: Array) -> None:  # pragma: no cover - compiled
    for k in range(len(points)):
        nearest, depth = 0, -np.inf
        for i in range(len(h)):
            offset = G[i, 0] * points[k, 0] + G[i, 1] * points[k, 1] - h[i]
            if offset > depth:
                nearest, depth = i, offset
        if depth <= 0.0:
            for i in range(len(h)):
                mu[k, i] = 0.0
            mu[k, nearest] = 1.0


class Dune:
    """The learned encoder: a small network whose output is dual feasible by construction.

    The final softplus keeps mu >= 0, the division by max(1, |G' mu|) keeps the norm.
    """

    def __init__(self, footprint: Footprint, layers: list[tuple[Array, Array]]) -> None:
        """Use the weights (inputs, outputs) and biases of each layer, first to last."""
        self.footprint = footprint
        self.layers = [(w.astype(np.float32), b.astype(np.float32)) for w, b in layers]

    def dual(self, points: Array) -> Array:
        """(N, E) dual variables of (N, 2) points in the robot frame."""
        x = points.astype(np.float32)
        for weight, bias in self.layers[:-1]:
            x = np.maximum(x @ weight + bias, 0.0)
        weight, bias = self.layers[-1]
        raw = SHARPNESS * (x @ weight + bias).astype(np.float64)
        mu = np.logaddexp(0.0, raw) / SHARPNESS
        norm = np.linalg.norm(mu @ self.footprint.G, axis=1, keepdims=True)
        return mu / np.maximum(1.0, norm)


def load_dune(path: Path, sha256: str) -> Dune:
    """Load an encoder with the footprint it was trained for.

    Raises:
        WeightsError: the file is missing, is not the one whose hash is expected, or is no encoder.
    """
    try:
        found = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise WeightsError(f"DUNE weights {path}: cannot be read ({error.strerror})") from error
    if found != sha256:
        raise WeightsError(
            f"DUNE weights {path}: corrupted or replaced (sha256 {found}, expected {sha256})"
        )
    try:
        with safe_open(path, framework="numpy") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            corners = json.loads((file.metadata() or {})["corners"])
        footprint = Footprint.from_corners(np.array(corners, dtype=np.float64))
        return Dune(footprint, _layers(tensors, len(footprint.corners)))
    except (SafetensorError, KeyError, ValueError, TypeError) as error:
        raise WeightsError(f"DUNE weights {path}: not an encoder ({error})") from error


def _layers(tensors: dict[str, Any], edges: int) -> list[tuple[Array, Array]]:
    """Weight and bias of each layer, from (2,) points to ``edges`` dual variables.

    Raises:
        ValueError: the tensors are no such layers; the message names the first that is wrong.
    """
    layers, inputs = [], 2
    for i in range(max(1, len(tensors) // 2)):
        for name in (f"{i}.{part}" for part in PARTS):
            if name not in tensors:
                raise ValueError(f"tensor {name!r} is missing")
            if tensors[name].dtype != np.float32 or not np.isfinite(tensors[name]).all():
                raise ValueError(f"tensor {name!r} has to be of finite float32 numbers")
        weight, bias = tensors[f"{i}.weight"], tensors[f"{i}.bias"]
        if weight.ndim != 2 or len(weight) != inputs:
            raise ValueError(f"tensor '{i}.weight' has shape {weight.shape}, not ({inputs}, n)")
        if bias.shape != weight.shape[1:]:
            raise ValueError(f"tensor '{i}.bias' has shape {bias.shape}, not {weight.shape[1:]}")
        layers.append((weight, bias))
        inputs = len(bias)
    if odd := tensors.keys() - {f"{i}.{part}" for i in range(len(layers)) for part in PARTS}:
        raise ValueError(f"tensor {min(odd)!r} is of no layer")
    if inputs != edges:
        raise ValueError(f"the last layer has {inputs} outputs for {edges} edges")
    return layers
