"""Calibration: every scenario can be won by who knows everything, and not by going straight.

Run ``python benchmarks/calibration.py [SCENARIO ...]``. Runs agents on the calibration seeds
(900,000 up), which no test uses, and prints success with Wilson's interval and SPL as the rows of
the table in docs/scenarios.md. In the paper's tier ``informed`` has to reach 0.98 everywhere and
``straight_line`` to stay below 0.7 wherever somebody walks. Finished episodes are kept in
``--folder``, so that a run that was stopped goes on.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from crowdbench_agents.learning.seeds import VALIDATION
from rich.console import Console
from rich.progress import Progress

import crowdbench
from crowdbench.evaluation.results import ResultsStore
from crowdbench.evaluation.runner import Task, run
from crowdbench.evaluation.statistics import wilson_interval

FIRST_SEED = VALIDATION[0]


def main() -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenarios", nargs="*", help="by default all of the tier")
    parser.add_argument("--tier", default="paper", choices=crowdbench.scenario_tiers())
    parser.add_argument("--agents", nargs="+", default=["informed", "straight_line"])
    parser.add_argument("--episodes", type=int, default=500)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path("build/calibration"))
    options = parser.parse_args()

    names = options.scenarios or crowdbench.scenario_names(options.tier)
    seeds = range(FIRST_SEED, FIRST_SEED + options.episodes)
    tasks = [
        Task(crowdbench.load_scenario(name), crowdbench.AgentSpec.parse(agent), seeds)
        for name in names
        for agent in options.agents
    ]
    with Progress(console=Console(stderr=True)) as progress:
        bar = progress.add_task("episodes", total=None)
        cells = run(
            tasks,
            options.folder,
            jobs=options.jobs,
            on_progress=lambda p: progress.update(bar, total=p.total, completed=p.stored + p.done),
        )

    store = ResultsStore(options.folder)
    results = [_summary(store.rows(cell), seeds) for cell in cells]
    console = Console(width=200, highlight=False)
    console.print("| scenario |" + "".join(f" {a}: success | SPL |" for a in options.agents))
    console.print("|---|" + "---|---|" * len(options.agents))
    for i, name in enumerate(names):
        row = results[i * len(options.agents) : (i + 1) * len(options.agents)]
        console.print(f"| `{name}` | " + " | ".join(row) + " |")


def _summary(rows: pd.DataFrame, seeds: Sequence[int]) -> str:
    rows = rows[rows["seed"].isin(seeds)]
    success = wilson_interval(rows["success"])
    return (
        f"{success.mean:.3f} \\[{success.low:.3f}, {success.high:.3f}] | {rows['spl'].mean():.3f}"
    )


if __name__ == "__main__":
    main()
