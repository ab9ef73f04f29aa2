"""Crossing recorded people: how often robots arrive, and what that costs the people.

    python benchmarks/crossing.py FOLDER [--episodes 100] [--page docs/people.md]
    python benchmarks/crossing.py FOLDER --cost

FOLDER has the recordings named in ``RECORDINGS``. In each of them a robot drives 5 m across the
main direction of the people, of whom ``REACTIVE`` evade it: nearly everybody who sees a robot does,
but not everybody looks, as in the hard tier. Finished episodes are kept in ``--results``, so that a
run that was stopped goes on.

A recording lasts one to two minutes, and episodes that begin at about the same moment meet the same
people. So intervals (95 %) draw blocks of the recording anew, with all episodes that begin in
them. A block is ``BLOCK`` long, about as long as a crossing takes: people of one have left
the robot's way by the next.

``--cost`` prints instead how many people are there in the first 10 s and in all, what a step costs
[us], and its ratio to a step with as many people who walk by ORCA: as are there, and in all.
Processor time without resets, taken in turns.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from rich.console import Console
from rich.progress import Progress

from crowdbench import (
    AgentError,
    AgentSpec,
    Scenario,
    ScenarioError,
    load_scenario,
    parallel_env,
)
from crowdbench.evaluation.executors import ExecutorError
from crowdbench.evaluation.results import ResultsError, ResultsStore
from crowdbench.evaluation.runner import IncompleteError, Task, run
from crowdbench.evaluation.statistics import wilson_interval
from crowdbench.simulation.layout import place

RECORDINGS: dict[str, tuple[str, dict[str, Any]]] = {
    "Juelich, two streams in a corridor": ("juelich/bidirectional_corridor_400_b_03.txt", {}),
    "Juelich, one stream in a corridor": (
        "juelich/unidirectional_uo_180.txt",
        {"unit": "cm", "fps": 16},
    ),
    "Juelich, in front of a bottleneck": ("juelich/bottleneck_040_c_56_h.txt", {}),
    "Juelich, through a door": ("juelich/single_file_00_01a.h5", {}),
    "ETH, in front of a building": ("eth_ucy/eth_obsmat.txt", {}),
}
"""Files, and what they do not say themselves."""
CEILING = "informed"
AGENTS = (CEILING, "neupan", "orca", "dynamic_window", "straight_line")
REACTIVE = 0.7
BLOCK = 10.0
"""Length of the pieces of a recording that are drawn again [s]."""
REPEATS = 2000
RANKED_FROM = 0.5
"""What cannot be crossed this often by who knows everything does not tell planners apart."""
COLUMNS = {
    "success": ("success", 1, 2),
    "spl": ("SPL", 1, 2),
    "delay": ("delay [ms]", 1000, 1),
    "detour": ("detour [mm]", 1000, 1),
    "displacement": ("displacement [mm]", 1000, 1),
}
"""Metrics with their heading, factor and digits."""
STEPS, ROUNDS = 400, 9
"""Of ``--cost``."""
BEGIN, END = "<!-- crossing: begin -->", "<!-- crossing: end -->"
"""Around the tables in a page."""


class Episodes(NamedTuple):
    """When the episodes of a recording begin, and whom they may meet.

    Attributes:
        block: (N,) number of the block in which each begins.
        people: (N,) how many are there in the first 20 s.
    """

    block: NDArray[np.int64]
    people: NDArray[np.int64]


def crossing(path: Path, given: Mapping[str, Any]) -> Scenario:
    """The scenario of a recording; ``given`` is what its file does not say."""
    return load_scenario(
        "open",
        time_limit=30,
        robots={"travel": 5},
        pedestrians={
            "model": "recorded",
            "recording": {"file": str(path), **given},
            "reactive": REACTIVE,
            "spawn_clearance": 0.5,
        },
    )


def episodes_of(scenario: Scenario, seeds: Sequence[int]) -> Episodes:
    """Where in the recording episodes begin."""
    block, people = [], []
    for seed in seeds:
        tracks = place(scenario, seed).tracks
        assert tracks is not None
        block.append(int(tracks.begin // BLOCK))
        early = tracks.position[: round(20.0 / tracks.period) + 1, :, 0]
        people.append(int(np.isfinite(early).any(axis=0).sum()))
    return Episodes(np.array(block), np.array(people))


def block_interval(values: ArrayLike, blocks: NDArray[np.int64]) -> tuple[float, float]:
    """Limits of a mean when blocks are drawn anew, with all of their values.

    Args:
        values: (N,) NaN is left out.
        blocks: (N,) to which block each belongs.

    Returns:
        NaN where fewer than two blocks have values.
    """
    known = np.asarray(values, dtype=np.float64)
    defined = np.isfinite(known)
    _, which = np.unique(blocks[defined], return_inverse=True)
    sums, counts = np.bincount(which, known[defined]), np.bincount(which)
    if len(counts) < 2:
        return np.nan, np.nan
    drawn = np.random.default_rng(0).integers(len(counts), size=(REPEATS, len(counts)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def table(title: str, rows: Mapping[str, pd.DataFrame], episodes: Episodes) -> str:
    """The table of a recording in Markdown.

    Args:
        title: of the recording.
        rows: of each agent, the ceiling first, one per episode.
        episodes: of the recording, in the order of the seeds 0, 1, ...
    """
    ceiling = rows[CEILING]["success"].mean()
    others = [agent for agent in rows if agent != CEILING]
    ranked = ceiling >= RANKED_FROM
    if ranked:
        others.sort(key=lambda agent: -rows[agent]["success"].mean())
    note = "" if ranked else f"; not ranked, since `{CEILING}` crosses it in {ceiling:.2f}"
    lines = [
        f"| {title}{note} | " + " | ".join(name for name, _, _ in COLUMNS.values()) + " |",
        "|---" * (len(COLUMNS) + 1) + "|",
    ]
    for agent in (CEILING, *others):
        cells = [_cell(metric, rows[agent], metric, episodes) for metric in COLUMNS]
        lines.append(f"| `{agent}` | " + " | ".join(cells) + " |")
    chance = [
        _cell(metric, rows[CEILING], f"{metric}_by_chance", episodes)
        for metric in ("delay", "detour", "displacement")
    ]
    lines.append("| *by chance* | | | " + " | ".join(chance) + " |")
    blocks, people = len(np.unique(episodes.block)), episodes.people.mean()
    count = min(len(each) for each in rows.values())
    lines.append(
        f"\n{count} episodes each, which begin in {blocks} blocks of {BLOCK:g} s; within 20 s "
        f"{people:.0f} people come on average."
    )
    return "\n".join(lines)


def _cell(metric: str, rows: pd.DataFrame, column: str, episodes: Episodes) -> str:
    """Mean and interval of a column, in the metric's unit of print."""
    _, factor, digits = COLUMNS[metric]
    values = rows[column].to_numpy(dtype=np.float64)
    low, high = block_interval(values, episodes.block[rows["seed"].to_numpy()])
    if metric == "success":  # no surer than if no two episodes met the same people
        single = wilson_interval(values)
        low, high = np.fmin(low, single.low), np.fmax(high, single.high)
    mean = np.nanmean(values) if np.isfinite(values).any() else np.nan
    mean, low, high = (round(factor * v, digits) + 0.0 for v in (mean, low, high))
    return f"{mean:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def drive(
    scenarios: Sequence[Scenario], agents: Sequence[str], count: int, folder: Path, jobs: int
) -> list[dict[str, pd.DataFrame]]:
    """Run what is missing; the rows of each scenario by agent."""
    pairs = [(scenario, agent) for scenario in scenarios for agent in agents]
    tasks = [Task(scenario, AgentSpec.parse(agent), range(count)) for scenario, agent in pairs]
    with Progress(console=Console(stderr=True)) as progress:
        bar = progress.add_task("episodes", total=None)
        try:
            cells = run(
                tasks,
                folder,
                jobs=jobs,
                on_progress=lambda p: progress.update(
                    bar, total=p.total, completed=p.stored + p.done
                ),
            )
        except IncompleteError as error:
            sys.stderr.write(f"{error}\n")
            cells = error.cells
    store, found = ResultsStore(folder), []
    for k in range(0, len(cells), len(agents)):
        rows = [store.rows(cell) for cell in cells[k : k + len(agents)]]
        found.append(
            {agent: each[each["seed"] < count] for agent, each in zip(agents, rows, strict=True)}
        )
    return found


def stepping(scenario: Scenario) -> Callable[[], float]:
    """Return a function that takes ``STEPS`` steps: processor time of one [us]."""
    env = parallel_env(scenario)
    env.reset(seed=900_000)
    actions = np.random.default_rng(0).uniform([0, -1.5], [1, 1.5], (STEPS, 2))

    def run() -> float:
        spent = 0.0
        for action in actions:
            if not env.agents:
                env.reset()
            begin = time.process_time()
            env.step({"robot_0": action})
            spent += time.process_time() - begin
        return 1e6 * spent / STEPS

    return run


def by_orca(scenario: Scenario, count: int) -> Scenario:
    """As many people who walk by ORCA, in the same area, or where each has 1 m²."""
    sides = np.array([scenario.arena.length, scenario.arena.width])
    length, width = (sides * max(1.0, np.sqrt(count / sides.prod()))).tolist()
    return load_scenario(
        "open",
        time_limit=scenario.time_limit,
        arena={"length": length, "width": width},
        robots={"travel": 5},
        pedestrians={"count": count, "reactive": REACTIVE, "spawn_clearance": 0.5},
    )


def cost(title: str, scenario: Scenario) -> str:
    """The row of a recording in the table of ``--cost``."""
    count, early = scenario.pedestrians.count, round(10.0 / scenario.control_period)
    tracks = [place(scenario, seed).tracks for seed in range(900_000, 900_010)]
    finite = [np.isfinite(each.position[:early, :, 0]) for each in tracks if each is not None]
    there = round(count * float(np.mean(finite)))
    twins = [by_orca(scenario, number) for number in (there, count)]
    takers = [stepping(each) for each in (scenario, *twins)]
    rounds = np.array([[take() for take in takers] for _ in range(ROUNDS + 1)])[1:]
    some, everybody = np.median(rounds[:, :1] / rounds[:, 1:], axis=0)
    spent = np.median(rounds[:, 0])
    return f"| {title} | {there} | {count} | {spent:.0f} | {some:.2f} | {everybody:.2f} |"


def insert(page: Path, text: str) -> None:
    """Put text between the marks of a page."""
    head, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, mark, tail = rest.partition(END)
    if not mark:
        raise SystemExit(f"{page}: expected {BEGIN} and {END} in it")
    page.write_text(f"{head}{BEGIN}\n{text}\n{END}{tail}", encoding="utf-8")


def main() -> None:
    """Run what is missing, then print the tables, or write them into a page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--agents", nargs="+", default=AGENTS)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--results", type=Path, default=Path("build/crossing"))
    output = parser.add_mutually_exclusive_group()
    output.add_argument("--page", type=Path)
    output.add_argument("--cost", action="store_true")
    options = parser.parse_args()
    if options.episodes < 1:
        parser.error(f"--episodes: {options.episodes}; allowed: 1 or more")
    if options.page and not options.page.is_file():
        parser.error(f"--page: {options.page}: no such file")
    try:
        text = _tables(options)
    except (AgentError, ScenarioError, ExecutorError, ResultsError) as error:
        parser.error(str(error))
    if options.page:
        insert(options.page, text)
    else:
        print(text)


def _tables(options: argparse.Namespace) -> str:
    scenarios = [crossing(options.folder / file, given) for file, given in RECORDINGS.values()]
    if options.cost:
        return "\n".join(map(cost, RECORDINGS, scenarios))
    agents = list(dict.fromkeys([CEILING, *options.agents]))
    rows = drive(scenarios, agents, options.episodes, options.results, options.jobs)
    tables = [
        table(title, each, episodes_of(scenario, range(options.episodes)))
        for title, scenario, each in zip(RECORDINGS, scenarios, rows, strict=True)
    ]
    return "\n\n".join(tables)


if __name__ == "__main__":
    main()
