"""Train DUNE for one footprint, and measure it against the closed form.

``python -m crowdbench_agents.neupan.dune_training --length 0.4 --width 0.3 --out dune.safetensors``
takes about two minutes on one core. The name and hash it prints go into config.yaml.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import torch
from crowdbench_agents.neupan.dune import SHARPNESS, Array, Dune, Footprint
from rich.console import Console
from rich.table import Table
from safetensors.numpy import save_file

NEAREST, FARTHEST = 1e-3, 8.0  # distances trained on [m]: where directions turn, and lidar range
HIDDEN = 64
LEARNING_RATE = 3e-3
BANDS = ((-1.0, 0.0), (0.0, 0.1), (0.1, 0.5), (0.5, 1.0), (1.0, 3.0), (3.0, 8.0))


class Encoder(Protocol):
    """Anything that maps (N, 2) points to (N, E) dual variables."""

    def dual(self, points: Array) -> Array:
        """(N, E) dual variables of (N, 2) points in the robot frame."""


class Accuracy(NamedTuple):
    """How an encoder compares with the closed form in one band of distances."""

    band: tuple[float, float]  # [m]; (-1, 0) is the inside
    rmse: float  # of the distance [m]
    worst: float  # [m]
    normal_p99: float  # 99th percentile of the angle between normals [deg]; nan inside
    infeasibility: float  # largest violation of mu >= 0 or |G' mu| <= 1


def sample_inside(footprint: Footprint, rng: np.random.Generator, count: int) -> Array:
    """(count, 2) points inside the footprint, triangle by triangle."""
    triangle = rng.integers(1, len(footprint.h) - 1, count)
    a, b = footprint.corners[triangle], footprint.corners[triangle + 1]
    u, v = np.sort(rng.random((2, count)), axis=0)
    return footprint.corners[0] * (1 - v)[:, None] + a * (v - u)[:, None] + b * u[:, None]


def sample_outside(footprint: Footprint, rng: np.random.Generator, distance: Array) -> Array:
    """(N, 2) points at given distances (N,), a third off the edges, the rest off the corners."""
    count, edges = len(distance), len(footprint.h)
    edge = rng.integers(0, edges, count)
    start, end = footprint.corners[edge], footprint.corners[(edge + 1) % edges]
    angles = np.arctan2(footprint.G[:, 1], footprint.G[:, 0])
    span = (angles[(edge + 1) % edges] - angles[edge]) % (2 * np.pi)
    off_edge = rng.random(count) < 1 / 3
    angle = angles[edge] + np.where(off_edge, 0.0, span * rng.random(count))
    along = np.where(off_edge, rng.random(count), 1.0)[:, None]
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    return start + along * (end - start) + distance[:, None] * direction


def train_dune(
    footprint: Footprint, seed: int, iterations: int = 30_000, batch: int = 4096
) -> Dune:
    """Fit an encoder to the closed form, with as many points per decade of distance.

    The first layer starts from the edges' own offsets G p - h, so that its kinks lie where the
    map has its own.
    """
    rng = np.random.default_rng(seed)
    generator = torch.Generator().manual_seed(seed)
    edges = len(footprint.h)
    G = torch.tensor(footprint.G, dtype=torch.float32)
    h = torch.tensor(footprint.h, dtype=torch.float32)
    shapes = [(2, HIDDEN), (HIDDEN, HIDDEN), (HIDDEN, edges)]
    weights = [(torch.rand(s, generator=generator) * 2 - 1) / s[0] ** 0.5 for s in shapes]
    biases = [(torch.rand(s[1], generator=generator) * 2 - 1) / s[0] ** 0.5 for s in shapes]
    rows = torch.arange(HIDDEN // 2) % edges
    scale = torch.exp(torch.randn(len(rows), generator=generator))
    weights[0][:, : len(rows)] = G[rows].T * scale
    biases[0][: len(rows)] = -h[rows] * scale
    parameters = [p.requires_grad_() for p in weights + biases]
    optimiser = torch.optim.Adam(parameters, lr=LEARNING_RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    for iteration in range(iterations):
        decades = rng.uniform(np.log(NEAREST), np.log(FARTHEST), batch - batch // 10)
        points = np.concatenate(
            [
                sample_inside(footprint, rng, batch // 10),
                sample_outside(footprint, rng, np.exp(decades)),
            ]
        )
        label = torch.tensor(footprint.dual(points), dtype=torch.float32)
        x = torch.tensor(points, dtype=torch.float32)
        offsets = x @ G.T - h
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            x = torch.relu(x @ weight + bias)
        # Sharp from the start, an output can die: no gradient reaches it from a flat side.
        sharpness = SHARPNESS ** min(1.0, 4 * iteration / iterations)
        raw = torch.nn.functional.softplus(x @ weights[-1] + biases[-1], beta=sharpness)
        mu = raw / (raw @ G).norm(dim=1, keepdim=True).clamp(min=1.0)
        distance = (label * offsets).sum(1)
        error = (mu * offsets).sum(1) - distance
        # A centimetre matters next to the robot and not at eight metres.
        loss = (mu - label).square().sum(1) + (error / (0.02 + 0.1 * distance)).square()
        optimiser.zero_grad(set_to_none=True)
        loss.mean().backward()
        optimiser.step()
        schedule.step()
    arrays = [p.detach().numpy().astype(np.float32) for p in parameters]
    count = len(shapes)
    return Dune(footprint, list(zip(arrays[:count], arrays[count:], strict=True)))


def save_dune(dune: Dune, path: Path) -> str:
    """Write the weights with the footprint they are for; return the file's sha256."""
    tensors = {}
    for i, (weight, bias) in enumerate(dune.layers):
        tensors[f"{i}.weight"], tensors[f"{i}.bias"] = weight, bias
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file(tensors, path, {"corners": json.dumps(dune.footprint.corners.tolist())})
    return hashlib.sha256(path.read_bytes()).hexdigest()


def measure(
    encoder: Encoder, footprint: Footprint, seed: int, count: int = 100_000
) -> list[Accuracy]:
    """Compare an encoder with the closed form on ``count`` fresh points in each band."""
    rng = np.random.default_rng(seed)
    rows = []
    for band in BANDS:
        if band[1] <= 0:
            points = sample_inside(footprint, rng, count)
        else:
            points = sample_outside(footprint, rng, rng.uniform(*band, count))
        truth, found = footprint.dual(points), encoder.dual(points)
        error = footprint.distance(points, found) - footprint.distance(points, truth)
        n, m = truth @ footprint.G, found @ footprint.G
        size = np.linalg.norm(m, axis=1)
        cosine = np.sum(n * m, axis=1) / np.maximum(size, 1e-12)
        angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        p99 = float(np.percentile(angle, 99)) if band[1] > 0 else float("nan")
        infeasibility = max(float(np.max(size) - 1), float(-np.min(found)), 0.0)
        rmse = float(np.sqrt(np.mean(error**2)))
        rows.append(Accuracy(band, rmse, float(np.max(np.abs(error))), p99, infeasibility))
    return rows


def as_table(rows: list[Accuracy], title: str) -> Table:
    """The figures of ``measure`` for people."""
    table = Table(
        "distance [m]", "RMSE [cm]", "worst [cm]", "normal p99 [deg]", "infeasible", title=title
    )
    for row in rows:
        band = "inside" if row.band[1] <= 0 else f"{row.band[0]:g} to {row.band[1]:g}"
        table.add_row(
            band,
            f"{100 * row.rmse:.3f}",
            f"{100 * row.worst:.2f}",
            f"{row.normal_p99:.2f}",
            f"{row.infeasibility:.0e}",
        )
    return table


def main() -> None:
    """Train for a rectangle, save, and show how good it is."""
    parser = argparse.ArgumentParser(description="Train DUNE for a rectangular footprint.")
    parser.add_argument("--length", type=float, default=0.4, help="along the heading [m]")
    parser.add_argument("--width", type=float, default=0.3, help="across the heading [m]")
    parser.add_argument("--seed", type=int, default=1_000_000)
    parser.add_argument("--iterations", type=int, default=30_000)
    parser.add_argument("--out", type=Path, required=True, help="a .safetensors file")
    options = parser.parse_args()
    torch.set_num_threads(1)
    x, y = options.length / 2, options.width / 2
    footprint = Footprint.from_corners(np.array([[x, y], [-x, y], [-x, -y], [x, -y]]))
    dune = train_dune(footprint, options.seed, options.iterations)
    digest = save_dune(dune, options.out)
    console = Console()
    console.print(as_table(measure(dune, footprint, seed=0), f"DUNE {x * 2:g} x {y * 2:g} m"))
    console.print(f"{options.out}: sha256 {digest}", soft_wrap=True)


if __name__ == "__main__":
    main()
