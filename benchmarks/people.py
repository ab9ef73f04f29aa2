"""How simulated people differ from recorded ones who had to go the same ways.

    python benchmarks/people.py FILE ... [--models orca social_force] [--figure people.png]
    python benchmarks/people.py FILE FILE ... --fit

Everybody enters where and when recorded, wants to walk the recorded way at the speed that it was
walked with where nobody was near, and is moved by the walking model among the recording's walls.
Who stands wants to be where recorded, and is moved by the model like everybody else. Both crowds
are measured alike (``crowdbench.people.likeness``). The distance between two distributions is the
earth mover's; its interval comes from blocks of five seconds, drawn again. As a yardstick, the
first half of the recording is compared with its second. Of files that do not all lack the same
units, save those that lack any first (``crowdbench people FILE --unit cm --fps 16 --save``).

``--models jupedsim:collision_free_speed`` (or ``anticipation_velocity``) lets a model of JuPedSim
(https://www.jupedsim.org) walk the same. ``--fit`` tries ``FIELDS``, those of a scenario that the
models follow, on every other recording, and says how the best do on those between.
"""

from __future__ import annotations

import argparse
import importlib
import time
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

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
STANDS = 1.0
"""Who is not this far from where the way began when it ends stands [m]."""
LEAVES = 0.4
"""Who is this near to the end of the way is gone [m]."""
PATIENCE = 2.0
"""And after this many times the recorded time in any case."""


class Ways:
    """The recorded ways, for people who are to walk them again.

    Attributes:
        recorded: everybody at the steps of the simulation.
        ways: of each person, all places (n, 2) [m].
        begin: of each [s].
        duration: of each [s].
        stands: (P,) who does not get ``STANDS`` far.
        speed: (P,) preferred [m/s].
    """

    def __init__(self, recording: CrowdRecording) -> None:
        """Take all tracks."""
        self.recorded = recorded(recording)
        self.ways = np.split(recording.positions, recording.starts[1:-1])
        self.begin = recording.begins.tolist()
        self.duration = (recording.ends - recording.begins).tolist()
        self.stands = np.array([np.linalg.norm(way[-1] - way[0]) < STANDS for way in self.ways])
        self.speed = free_speeds(self.recorded)

    def aim(self, person: int, place: FloatArray, passed: int) -> tuple[int, FloatArray]:
        """The row of the way that has been passed, and the first ``LOOK_AHEAD`` away after it."""
        way = self.ways[person]
        ahead = way[passed : passed + 50]
        passed += int(np.argmin(((ahead - place) ** 2).sum(axis=1)))
        far = ((way[passed:] - place) ** 2).sum(axis=1) >= LOOK_AHEAD**2
        return passed, way[passed + int(far.argmax())] if far.any() else way[-1]

    def over(self, person: int, place: FloatArray, step: int) -> bool:
        """Whether somebody at a place has to leave in a step."""
        if self.stands[person]:
            return not np.isfinite(self.recorded.position[step, person, 0])
        end = self.begin[person] + PATIENCE * self.duration[person] + 5.0
        near = np.linalg.norm(place - self.ways[person][-1]) < LEAVES
        return bool(near or step * PERIOD > end)


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


class Fields(NamedTuple):
    """Of a scenario's pedestrians, which every walking model follows.

    Attributes:
        radius: [m].
        acceleration: limit on the change of velocity [m/s2].
    """

    radius: float = 0.2
    acceleration: float = np.inf


FIELDS = [Fields(*pair) for pair in product((0.15, 0.2, 0.25, 0.3), (np.inf, 2.4, 1.2))]
"""Those that are tried. 2.4 m/s2 is what Moussaid et al. 2009 have measured of people who start."""
AS_USUAL = Fields()


class ByModel:
    """People who are moved by one of crowdbench's walking models."""

    def __init__(self, recording: CrowdRecording, name: str, fields: Fields) -> None:
        """Nobody is there."""
        count = len(recording.people)
        self._model, self._fields, self._walls = WALKING_MODELS[name](), fields, recording.segments
        self.place, self._velocity = np.zeros((count, 2)), np.zeros((count, 2))
        self._speed = np.zeros(count)

    def enter(self, person: int, place: FloatArray, ahead: FloatArray, speed: float) -> bool:
        """Somebody appears and walks towards ``ahead``; false where that is not possible."""
        self.place[person], self._speed[person] = place, speed
        self._velocity[person] = speed * ahead / max(float(np.linalg.norm(ahead)), 1e-9)
        return True

    def leave(self, person: int) -> None:
        """Somebody is gone."""

    def walk(self, there: NDArray[np.int64], goal: FloatArray, time: float) -> None:
        """Move those who are there towards their goals, for a period."""
        before, speed = self._velocity[there], self._speed[there]
        crowd = Crowd(
            position=self.place[there],
            velocity=before,
            heading=np.arctan2(before[:, 1], before[:, 0]),
            goal=goal,
            preferred_speed=speed,
            preferred_velocity=preferred(goal - self.place[there], speed),
            radius=np.full(len(there), self._fields.radius),
            present=np.ones(len(there), dtype=np.bool_),
            sees_robot=np.zeros((len(there), 0), dtype=np.bool_),
            robot_position=np.empty((0, 2)),
            robot_velocity=np.empty((0, 2)),
            robot_radius=0.25,
            responsibility=0.5,
            obstacles=np.empty((0, 3)),
            walls=self._walls,
            period=PERIOD,
        )
        after = self._model.velocities(crowd, time)
        most = self._fields.acceleration * PERIOD
        if np.isfinite(most):
            change = after - before
            size = np.sqrt((change**2).sum(axis=1, keepdims=True))
            after = before + change * np.minimum(1.0, most / np.maximum(size, 1e-9))
        self._velocity[there] = after
        self.place[there] += PERIOD * after


class Simulated(NamedTuple):
    """People who have walked.

    Attributes:
        frames: where.
        step: processor time of a control period, of the model alone [s].
        missed: how many never got in, as others were where they would appear.
    """

    frames: Frames
    step: float
    missed: int


def simulated(recording: CrowdRecording, name: str, fields: Fields = AS_USUAL) -> Simulated:
    """The same people, moved by a walking model."""
    ways = Ways(recording)
    steps, count = ways.recorded.position.shape[:2]
    people = _walkers(recording, name, fields)
    position = np.full((steps, count, 2), np.nan)
    passed, goal = [0] * count, np.zeros((count, 2))
    state = np.zeros(count, dtype=np.int64)  # not yet, there, gone
    spent = 0.0
    for step in range(steps):
        now = step * PERIOD
        places = ways.recorded.position[step]
        for p in range(count):
            way = ways.ways[p]
            if state[p] == 0 and np.isfinite(places[p, 0]):
                ahead = np.zeros(2) if ways.stands[p] else way[min(5, len(way) - 1)] - way[0]
                state[p] = people.enter(p, way[0], ahead, float(ways.speed[p]))
            if state[p] == 1 and ways.over(p, people.place[p], step):
                state[p] = 2
                people.leave(p)
        there = np.flatnonzero(state == 1)
        position[step, there] = people.place[there]
        for p in there.tolist():
            if ways.stands[p]:
                goal[p] = places[p]
            else:
                passed[p], goal[p] = ways.aim(p, people.place[p], passed[p])
        if len(there):
            before = time.process_time()
            people.walk(there, goal[there], now)
            spent += time.process_time() - before
    return Simulated(Frames(position, PERIOD), spent / steps, int((state == 0).sum()))


def _walkers(recording: CrowdRecording, name: str, fields: Fields) -> Any:
    """What moves people: one of crowdbench's walking models, or one of JuPedSim."""
    package, _, model = name.rpartition(":")
    if package == "jupedsim":
        # By name, since files of this folder are no package; here, since few have JuPedSim.
        models = importlib.import_module("jupedsim_people")
        return models.ByJuPedSim(recording, model, fields.radius, PERIOD)
    return ByModel(recording, name, fields)


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


def mismatch(real: Frames, other: Frames) -> float:
    """Mean over measures of the distance, by the standard deviation of what was recorded."""
    found = []
    for measure, _ in MEASURES.values():
        values = measure(real)
        if len(values) > 1 and values.std() > 0:
            found.append(_distance(values, measure(other)) / values.std())
    return float(np.nanmean(found))


def fit(recordings: list[CrowdRecording], models: list[str]) -> None:
    """Print a table of ``FIELDS``: mismatch where they were chosen, and in the other recordings."""
    crowds = [recorded(recording) for recording in recordings]
    chosen, others = slice(0, None, 2), slice(1, None, 2)
    print(f"chosen on {', '.join(r.name for r in recordings[chosen])}\n")
    print("| model | radius [m] | acceleration [m/s²] | chosen on | the others |")
    print("|---|---|---|---|---|")
    for name in models:
        found = {
            fields: [
                mismatch(real, simulated(recording, name, fields).frames)
                for recording, real in zip(recordings, crowds, strict=True)
            ]
            for fields in FIELDS
        }
        best = min(FIELDS, key=lambda fields: float(np.mean(found[fields][chosen])))
        for fields in dict.fromkeys((AS_USUAL, best)):
            means = (np.mean(found[fields][which]) for which in (chosen, others))
            cells = " | ".join(f"{mean:.3f}" for mean in means)
            print(f"| `{name}` | {fields.radius:g} | {fields.acceleration:g} | {cells} |")


def main() -> None:
    """Print a table for each recording, and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--unit")
    parser.add_argument("--fps", type=float)
    parser.add_argument("--models", nargs="+", default=["orca", "social_force"])
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--fit", action="store_true")
    options = parser.parse_args()
    recordings = [read_recording(path, options.unit, options.fps) for path in options.files]
    if options.fit:
        fit(recordings, options.models)
        return
    panels = {}
    for path, recording in zip(options.files, recordings, strict=True):
        real = recorded(recording)
        half = len(real.position) // 2
        crowds = {name: simulated(recording, name) for name in options.models}
        rows = {"second half": distances(real.part(0, half), real.part(half, 2 * half), _rng())}
        rows |= {name: distances(real, crowd.frames, _rng()) for name, crowd in crowds.items()}
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
        for name, crowd in crowds.items():
            far = f"mismatch {mismatch(real, crowd.frames):.2f}"
            cost = f"{1000 * crowd.step:.2f} ms of processor time a step"
            print(f"\n{name}: {far}, {cost}, {crowd.missed} people never got in")
        frames = {name: crowd.frames for name, crowd in crowds.items()}
        panels[path.stem] = {"recorded": real, **frames}
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
