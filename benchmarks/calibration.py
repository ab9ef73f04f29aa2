"""Calibration: every scenario can be won by who knows everything, and not by going straight.

Run ``python benchmarks/calibration.py [SCENARIO ...]`` or, for the hard tier, with ``--tier hard``
and ``--tier situation``. Runs agents on the calibration seeds (900,000 up), which no test uses, and
prints success with Wilson's interval and SPL as the rows of the table in docs/scenarios.md, which
says what each agent has to reach. Finished episodes are kept in ``--folder``, so that a run that
was stopped goes on.
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
from crowdbench.evaluation.executors import ExecutorError
from crowdbench.evaluation.results import ResultsError, ResultsStore
from crowdbench.evaluation.runner import Task, run
from crowdbench.evaluation.statistics import wilson_interval

FIRST_SEED = VALIDATION[0]
PAPER = {"informed": 500, "straight_line": 500}
HARD = {"informed": 500, "informed:intent=sampled": 200, "straight_line": 500}
"""Agents of a calibration and their episodes."""


def main() -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenarios", nargs="*", help="by default all of the tier")
    parser.add_argument("--tier", default="paper", choices=crowdbench.scenario_tiers())
    parser.add_argument("--agents", nargs="+", help="by default those of the calibration")
    parser.add_argument("--episodes", type=int, help="by default those of the calibration")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path("build/calibration"))
    options = parser.parse_args()
    if options.episodes is not None and options.episodes < 1:
        parser.error(f"--episodes: {options.episodes}; allowed: 1 or more")
    try:
        _calibrate(options)
    except (crowdbench.AgentError, crowdbench.ScenarioError, ExecutorError, ResultsError) as error:
        parser.error(str(error))


def _calibrate(options: argparse.Namespace) -> None:
    names = options.scenarios or crowdbench.scenario_names(options.tier)
    usual = PAPER if options.tier == "paper" else HARD
    agents = options.agents or list(usual)
    tasks = [
        Task(
            crowdbench.load_scenario(name),
            crowdbench.AgentSpec.parse(agent),
            range(FIRST_SEED, FIRST_SEED + (options.episodes or HARD.get(agent, 500))),
        )
        for name in names
        for agent in agents
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
    results = [
        _summary(store.rows(cell), task.seeds) for cell, task in zip(cells, tasks, strict=True)
    ]
    console = Console(width=200, highlight=False)
    console.print("| scenario |" + "".join(f" {a}: success | SPL |" for a in agents))
    console.print("|---|" + "---|---|" * len(agents))
    for i, name in enumerate(names):
        row = results[i * len(agents) : (i + 1) * len(agents)]
        console.print(f"| `{name}` | " + " | ".join(row) + " |")


def _summary(rows: pd.DataFrame, seeds: Sequence[int]) -> str:
    rows = rows[rows["seed"].isin(seeds)]
    success = wilson_interval(rows["success"])
    return (
        f"{success.mean:.3f} \\[{success.low:.3f}, {success.high:.3f}] | {rows['spl'].mean():.3f}"
    )


if __name__ == "__main__":
    main()
