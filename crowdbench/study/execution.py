"""Running what the tables lack, with a forecast of the time it takes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench.agent import AgentError, AgentSpec
from crowdbench.evaluation.results import load_results, scenario_label
from crowdbench.evaluation.runner import Progress, Task, run
from crowdbench.scenario import load_scenario
from crowdbench.study.model import Cell, Study
from crowdbench.study.sessions import Account

if TYPE_CHECKING:
    import pandas as pd

PASSES = (1, 50, 100)
"""Seeds below the first limit run first, in every cell: then all speeds are known. Then as much in
every cell before more in any, so that a run that is cut short has something in all of them. What
is beyond the last limit runs at the end."""
OVERHEAD = 0.001
"""Time of a step outside the agent until it has been measured [s]."""


@dataclass
class Speed:
    """What the episodes of one agent took so far."""

    episodes: int = 0
    steps: int = 0
    planning: float = 0.0  # [s]

    def add(self, steps: int, seconds_per_step: float) -> None:
        """Count an episode; without a step it took no planning, and untimed as much as others."""
        if math.isnan(seconds_per_step):
            seconds_per_step = self.planning / self.steps if self.steps else 0.0
        self.episodes += 1
        self.steps += steps
        self.planning += steps * seconds_per_step if steps else 0.0

    def per_episode(self, overhead: float) -> float:
        """Mean time of an episode [s], with ``overhead`` per step."""
        return (self.planning + overhead * self.steps) / self.episodes


class Forecast:
    """How long the rest takes, from the speeds measured so far.

    An episode takes the agent's own time, known from ``inference_s``, and a time per step for
    everything else, which is what is left of the session's wall time.

    Attributes:
        jobs: processes that work at the same time; may change.
    """

    def __init__(
        self, pending: Mapping[str, int], stored: Iterable[tuple[str, int, float]], jobs: int
    ) -> None:
        """Start from the episodes stored before.

        Args:
            pending: episodes to run, by agent.
            stored: agent, steps and ``inference_s`` of earlier episodes.
            jobs: processes.
        """
        self._pending = Counter(pending)
        self.jobs = jobs
        self._speeds: dict[str, Speed] = {}
        self._session = Speed()
        self._seconds = 0.0
        for agent, steps, seconds in stored:
            self._speeds.setdefault(agent, Speed()).add(steps, seconds)

    def finished(self, row: Mapping[str, str], seconds: float) -> None:
        """Take note of an episode.

        Args:
            row: as stored.
            seconds: wall time of the session so far.
        """
        agent, steps = row["agent"], int(row["steps"])
        for speed in (self._speeds.setdefault(agent, Speed()), self._session):
            speed.add(steps, float(row["inference_s"]))
        self._pending[agent] = max(0, self._pending[agent] - 1)
        self._seconds = seconds

    @property
    def unknown(self) -> list[str]:
        """Agents with episodes to run, of whose speed nothing is known."""
        return [name for name, count in self._pending.items() if count and name not in self._speeds]

    def seconds_left(self) -> float:
        """Wall time until the last episode ends [s]; agents of unknown speed are left out."""
        return self._time(self._pending)

    def seconds_for(self, plan: Iterable[Cell]) -> float:
        """Wall time of all episodes of a plan [s]; agents of unknown speed are left out."""
        wanted: Counter[str] = Counter()
        for cell in plan:
            wanted[cell.agent] += cell.episodes
        return self._time(wanted)

    def _time(self, episodes: Mapping[str, int]) -> float:
        overhead = OVERHEAD
        if self._session.steps:
            rest = self._seconds * self.jobs - self._session.planning
            overhead = max(0.0, rest / self._session.steps)
        known = self._speeds.items()
        work = sum(episodes.get(name, 0) * speed.per_episode(overhead) for name, speed in known)
        return work / self.jobs


@dataclass(frozen=True)
class Outlook:
    """What is known before the first episode.

    Attributes:
        weights: hash of the weights of every agent that can be made.
        broken: agents that cannot be made, and why.
    """

    weights: dict[str, str]
    broken: dict[str, str]


def look(plan: Sequence[Cell]) -> Outlook:
    """Make every agent of a plan once."""
    weights, broken = {}, {}
    for agent in dict.fromkeys(cell.agent for cell in plan):
        try:
            weights[agent] = AgentSpec.parse(agent).make().weights_sha256 or ""
        except AgentError as error:
            broken[agent] = str(error)
    return Outlook(weights, broken)


def run_missing(
    folder: Path,
    study: Study,
    outlook: Outlook,
    jobs: int | None,
    on_progress: Callable[[int, int, Forecast], None],
    published: pd.DataFrame | None = None,
    *,
    executor: str = "local",
    address: str | None = None,
    on_note: Callable[[str], None] = lambda note: None,
) -> Forecast:
    """Run the episodes of a study that are not there yet.

    Args:
        folder: results folder.
        study: what to run.
        outlook: of its cells; agents that cannot be made are left out.
        jobs: processes, by default as many as the executor has room for.
        on_progress: told the number of episodes stored, of those planned, and the forecast.
        published: rows of the record that need not be run again; none by default.
        executor, address, on_note: as for ``run``.

    Returns:
        The forecast as it is at the end.
    """
    plan = [cell for cell in study.cells() if cell.agent in outlook.weights]
    worlds = {cell.scenario: load_scenario(cell.scenario) for cell in plan}
    digests = {scenario_label(world): world.digest for world in worlds.values()}

    def fitting(rows: pd.DataFrame) -> list[Any]:
        return [
            row
            for row in rows.itertuples()
            if row.scenario_digest == digests.get(row.scenario)
            and row.weights_sha256 == outlook.weights.get(row.agent)
        ]

    elsewhere = [] if published is None else fitting(published)
    not_again = {(row.scenario, row.agent, row.seed) for row in elsewhere}
    stored = [*fitting(load_results(folder)), *elsewhere]
    there = {(row.scenario_digest, row.agent, row.seed) for row in stored}
    pending = Counter(
        cell.agent
        for cell in plan
        for seed in range(cell.episodes)
        if (worlds[cell.scenario].digest, cell.agent, seed) not in there
    )
    known = [(row.agent, row.steps, row.inference_s) for row in stored]
    forecast = Forecast(pending, known, jobs or 1)
    account = Account(folder, study.name)
    total = sum(cell.episodes for cell in plan)
    done = total - sum(pending.values())

    def advance(progress: Progress) -> None:
        nonlocal done
        forecast.jobs = progress.jobs
        for row in progress.rows[:1]:
            done = min(done + 1, total)
            account.count(row["machine"], progress.jobs)
            forecast.finished(row, account.seconds)
        on_progress(done, total, forecast)

    try:
        run(
            _tasks(plan, not_again),
            folder,
            jobs=jobs,
            executor=executor,
            address=address,
            on_progress=advance,
            on_note=on_note,
        )
    finally:
        account.write()
    return forecast


def _tasks(plan: Sequence[Cell], not_again: Set[tuple[str, str, int]] = frozenset()) -> list[Task]:
    """The plan pass by pass, each of them grouped by agent, which saves loading."""
    tasks = []
    limits = (*PASSES, max((cell.episodes for cell in plan), default=0))
    for first, end in zip((0, *limits), limits, strict=False):
        for cell in plan:
            wanted = range(first, min(end, cell.episodes))
            seeds = [seed for seed in wanted if (*cell[:2], seed) not in not_again]
            if seeds:
                tasks.append(Task(load_scenario(cell.scenario), AgentSpec.parse(cell.agent), seeds))
    return tasks
