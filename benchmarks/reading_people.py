"""How long it takes to read a recording of many people.

Run ``python benchmarks/reading_people.py``. A recording of 20,000 frames with 100 people is written
as text of PeTrack, as CSV and as NPZ; each is read several times in turn, the first by pedpy alone
as well. Prints the least processor time of each and its ratio to that of pedpy.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pedpy
from rich.console import Console
from rich.table import Table

from crowdbench.people import read_recording
from crowdbench.people.saved import save


def main() -> None:
    """Write, read in turns, and print a line for each kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--people", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        petrack, csv, npz = _write(Path(folder), options.people, options.frames)
        kinds: dict[str, Callable[[], object]] = {
            "pedpy alone": lambda: pedpy.load_trajectory(trajectory_file=petrack),
            "PeTrack text": lambda: read_recording(petrack),
            "CSV": lambda: read_recording(csv, fps=25),
            "NPZ": lambda: read_recording(npz),
        }
        least = dict.fromkeys(kinds, math.inf)
        for _ in range(options.repeats):
            for kind, read in kinds.items():
                begun = time.process_time()
                read()
                least[kind] = min(least[kind], time.process_time() - begun)
    table = Table("kind", "processor time [s]", "of pedpy's")
    for kind, seconds in least.items():
        table.add_row(kind, f"{seconds:.2f}", f"{seconds / least['pedpy alone']:.2f}")
    Console(highlight=False).print(table)


def _write(folder: Path, people: int, frames: int) -> tuple[Path, Path, Path]:
    """The same random walks as text of PeTrack, as CSV and as NPZ."""
    petrack, csv, npz = (folder / f"walk.{ending}" for ending in ("txt", "csv", "npz"))
    steps = np.random.default_rng(0).normal(scale=0.02, size=(people, frames, 2))
    rows = np.column_stack(
        [
            np.repeat(np.arange(people), frames),
            np.tile(np.arange(frames), people),
            steps.cumsum(axis=1).reshape(-1, 2),
        ]
    )
    form = ["%d", "%d", "%.4f", "%.4f"]
    header = "framerate: 25 fps\nid frame x/m y/m"
    np.savetxt(petrack, rows, form, header=header)
    np.savetxt(csv, rows, form, delimiter=",", header="id,frame,x/m,y/m", comments="")
    save(read_recording(petrack), npz)
    return petrack, csv, npz


if __name__ == "__main__":
    main()
