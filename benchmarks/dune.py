"""How DUNE compares with the closed form it was trained on: distances, normals, feasibility.

Run ``python benchmarks/dune.py``. Wanted on points within 3 m: distance RMSE below 0.5 cm, 99th
percentile of the angle between normals below 5 degrees beyond 0.1 m, no dual infeasibility above
1e-3. The published checkpoint of the original, measured in the same way: RMSE 1.1 cm within 0.1 m,
1.5 cm at 0.1 to 0.5 m, normals off by up to 51 degrees.
"""

from __future__ import annotations

import argparse

from crowdbench_agents.neupan.agent import FOLDER, load_settings
from crowdbench_agents.neupan.dune import load_dune
from crowdbench_agents.neupan.dune_training import as_table, measure
from rich.console import Console


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure DUNE against the closed form.")
    parser.add_argument("--points", type=int, default=200_000, help="in each band of distances")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    settings = load_settings()
    dune = load_dune(FOLDER / "weights" / settings.weights, settings.weights_sha256)
    rows = measure(dune, dune.footprint, options.seed, options.points)
    Console().print(as_table(rows, f"{settings.weights}, {options.points:,} points in each band"))
    near = [row for row in rows if row.band[1] <= 3.0]
    reached = all(row.rmse < 0.005 and row.infeasibility < 1e-3 for row in near) and all(
        row.normal_p99 < 5.0 for row in near if row.band[0] >= 0.1
    )
    Console().print("what is wanted: " + ("reached" if reached else "NOT reached"))


if __name__ == "__main__":
    main()
