"""How simulated people differ from recorded ones who had to go the same ways.

    python benchmarks/people.py FILE ... [--models orca social_force] [--figure people.png]

Everybody enters where and when recorded, wants to walk the recorded way at the speed that it was
walked with where nobody was near, and is moved by the walking model among the recording's walls.
Both crowds are measured alike (``crowdbench.people.likeness``). The distance between two
distributions is the earth mover's; its interval comes from blocks of five seconds, drawn again. As
a yardstick, the first half of the recording is compared with its second.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wasserstein_distance

from crowdbench.extensions import WALKING_MODELS
from crowdbench.people import CrowdRecording, read_recording
from crowdbench.people.likeness import MEASURES, Frames, densities, local_density
from crowdbench.simulation.pedestrians import preferred_velocity
from crowdbench.simulation.walking import Crowd

FloatArray = NDArray[np.float64]
PERIOD = 0.2
BLOCK = 5.0
"""Length of the pieces that are drawn again [s]."""
REPEATS = 200
LOOK_AHEAD = 1.5
"""How far ahead on the recorded way somebody aims [m]."""
FREE = 0.5
"""Up to this density people walk as fast as they like [1/m2]."""
LEAST = 5
"""Steps in which somebody has to be that free for a speed of one's own."""
SLOWEST = 0.3
"""Preferred speeds are not below this [m/s]."""
RADIUS = 0.2
LEAVES = 0.4
"""Who is this near to the end of the way is gone [m]."""
PATIENCE = 2.0
"""And after this many times the recorded time in any case."""


class Ways:
    """The recorded ways, for people who are to walk them again."""

    def __init__(self, recording: CrowdRecording) -> None:
        """Take all tracks of a metre and more."""
        begins, ends = recording.starts[:-1], recording.starts[1:]
        self.ways, self.begin, self.duration = [], [], []
        kept = []
        for track, (first, last) in enumerate(zip(begins.tolist(), ends.tolist(), strict=True)):
            places = recording.positions[first:last]
            if np.linalg.norm(places[-1] - places[0]) < 1.0:
                continue
            kept.append(track)
            self.ways.append(places)
            self.begin.append(float(recording.begins[track]))
            self.duration.append(float(recording.ends[track] - recording.begins[track]))
        self.speed = free_speeds(recorded(recording))[kept]

    def aim(self, person: int, place: FloatArray, passed: int) -> tuple[int, FloatArray]:
        """The row of the way that has been passed, and the first ``LOOK_AHEAD`` away after it."""
        way = self.ways[person]
        ahead = way[passed : passed + 50]
        passed += int(np.argmin(((ahead - place) ** 2).sum(axis=1)))
        far = ((way[passed:] - place) ** 2).sum(axis=1) >= LOOK_AHEAD**2
        return passed, way[passed + int(far.argmax())] if far.any() else way[-1]


def free_speeds(real: Frames) -> FloatArray:
    """(P,) median speed of each person where hardly anybody is near [m/s].

    Of those who are never that free, the median of all who are: in a crowd one is slower than one
    would like to be.
    """
    free = np.where(local_density(real) <= FREE, real.speed, np.nan)
    known = np.isfinite(free).sum(axis=0) >= LEAST
    everybody = float(np.nanmedian(free)) if known.any() else 1.34
    speeds = np.full(free.shape[1], everybody)
    speeds[known] = np.nanmedian(free[:, known], axis=0)
    return np.maximum(speeds, SLOWEST)


def recorded(recording: CrowdRecording) -> Frames:
    """The recording at the same steps."""
    steps = int(recording.duration / PERIOD) + 1
    position = np.full((steps, len(recording.people), 2), np.nan)
    for step in range(steps):
        present = recording.at(step * PERIOD)
        position[step, present.tracks] = present.positions
    return Frames(position, PERIOD)


def simulated(recording: CrowdRecording, name: str) -> Frames:
    """The same people, moved by a walking model."""
    ways, model = Ways(recording), WALKING_MODELS[name]()
    steps, count = int(recording.duration / PERIOD) + 1, len(ways.ways)
    position = np.full((steps, count, 2), np.nan)
    place, velocity = np.zeros((count, 2)), np.zeros((count, 2))
    passed, state = [0] * count, np.zeros(count, dtype=np.int64)  # not yet, there, gone
    speed, goal = np.array(ways.speed), np.zeros((count, 2))
    for step in range(steps):
        time = step * PERIOD
        for p in range(count):
            if state[p] == 0 and time >= ways.begin[p]:
                state[p], place[p] = 1, ways.ways[p][0]
                way = ways.ways[p]
                first = way[min(5, len(way) - 1)] - way[0]
                velocity[p] = speed[p] * first / max(float(np.linalg.norm(first)), 1e-9)
            late = time > ways.begin[p] + PATIENCE * ways.duration[p] + 5.0
            arrived = np.linalg.norm(place[p] - ways.ways[p][-1]) < LEAVES
            if state[p] == 1 and (arrived or late):
                state[p] = 2
        there = np.flatnonzero(state == 1)
        position[step, there] = place[there]
        if not len(there):
            continue
        for p in there.tolist():
            passed[p], goal[p] = ways.aim(p, place[p], passed[p])
        crowd = Crowd(
            position=place[there].copy(),
            velocity=velocity[there].copy(),
            heading=np.arctan2(velocity[there, 1], velocity[there, 0]),
            goal=goal[there].copy(),
            preferred_speed=speed[there].copy(),
            preferred_velocity=preferred(goal[there] - place[there], speed[there]),
            radius=np.full(len(there), RADIUS),
            present=np.ones(len(there), dtype=np.bool_),
            sees_robot=np.zeros((len(there), 0), dtype=np.bool_),
            robot_position=np.empty((0, 2)),
            robot_velocity=np.empty((0, 2)),
            robot_radius=0.25,
            responsibility=0.5,
            obstacles=np.empty((0, 3)),
            walls=recording.segments,
            period=PERIOD,
        )
        velocity[there] = model.velocities(crowd, time)
        place[there] += PERIOD * velocity[there]
    return Frames(position, PERIOD)


def preferred(offset: NDArray[np.float64], speed: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P, 2) straight to goals at ``offset`` (P, 2), past which nobody walks in a period [m/s]."""
    pairs = zip(offset.tolist(), speed.tolist(), strict=True)
    return np.array([preferred_velocity(x, y, pace, PERIOD) for (x, y), pace in pairs])


def distances(real: Frames, other: Frames, rng: np.random.Generator) -> dict[str, list[float]]:
    """Earth mover's distance of each measure with a 95 % interval; NaN where one has no values."""
    found = {}
    size = round(BLOCK / PERIOD)
    blocks = [_blocks(frames, size) for frames in (real, other)]
    for name, (measure, _) in MEASURES.items():
        parts = [[measure(block) for block in pieces] for pieces in blocks]
        whole = _distance(*(np.concatenate(part) for part in parts))
        again = []
        for _ in range(REPEATS if np.isfinite(whole) else 0):
            drawn = [
                np.concatenate([part[i] for i in rng.integers(len(part), size=len(part))])
                for part in parts
            ]
            again.append(_distance(*drawn))
        low, high = np.nanpercentile(again, [2.5, 97.5]) if again else (np.nan, np.nan)
        found[name] = [whole, float(low), float(high)]
    return found


def _blocks(frames: Frames, size: int) -> list[Frames]:
    steps = len(frames.position)
    return [frames.part(k, k + size) for k in range(0, max(steps - size // 2, 1), size)]


def _distance(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(wasserstein_distance(a, b)) if len(a) and len(b) else float("nan")


def main() -> None:
    """Print a table for each recording, and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--unit")
    parser.add_argument("--fps", type=float)
    parser.add_argument("--models", nargs="+", default=["orca", "social_force"])
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    panels = {}
    for path in options.files:
        recording = read_recording(path, options.unit, options.fps)
        real = recorded(recording)
        half = len(real.position) // 2
        crowds = {name: simulated(recording, name) for name in options.models}
        rows = {"second half": distances(real.part(0, half), real.part(half, 2 * half), _rng())}
        rows |= {name: distances(real, crowd, _rng()) for name, crowd in crowds.items()}
        print(
            f"\n{path.name}\n\n| against the recording | "
            + " | ".join(
                f"{name}{f' [{unit}]' if unit else ''}" for name, (_, unit) in MEASURES.items()
            )
            + " |"
        )
        print("|---" * (len(MEASURES) + 1) + "|")
        means = [
            measure(real).mean() if len(measure(real)) else np.nan
            for measure, _ in MEASURES.values()
        ]
        print("| mean, recorded | " + " | ".join(f"{mean:.2f}" for mean in means) + " |")
        for name, row in rows.items():
            cells = (f"{d:.2f} [{low:.2f}, {high:.2f}]" for d, low, high in row.values())
            print(f"| {name} | " + " | ".join(cells) + " |")
        panels[path.stem] = {"recorded": real, **crowds}
    if options.figure:
        _draw(panels, options.figure)


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def _draw(panels: dict[str, dict[str, Frames]], path: Path) -> None:
    """Speed over density and nearest distances, a row a recording."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        len(panels), 3, figsize=(11, 2.8 * len(panels)), squeeze=False, layout="constrained"
    )
    for row, (title, crowds) in zip(axes, panels.items(), strict=True):
        for name, frames in crowds.items():
            density, speed = densities(frames)
            bins = np.arange(0, density.max(initial=0.1) + 0.3, 0.28)
            middle = [speed[(density >= b) & (density < b + 0.28)] for b in bins]
            mean = [part.mean() if len(part) > 20 else np.nan for part in middle]
            row[0].plot(bins + 0.14, mean, marker="o", markersize=3, label=name)
            for axis, key in ((row[1], "nearest distance"), (row[2], "acceleration")):
                values = np.sort(MEASURES[key][0](frames))
                axis.plot(values, np.linspace(0, 1, len(values)), label=name)
        row[0].set(title=title, xlabel="density [1/m²]", ylabel="speed [m/s]")
        row[1].set(xlabel="nearest distance [m]", ylabel="share below", xlim=(0, 3))
        row[2].set(xlabel="acceleration [m/s²]", xlim=(0, 4))
        row[1].legend(frameon=False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
