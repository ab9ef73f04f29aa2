"""A plan of runs in, stored episodes out: in parallel, resumable, and the same either way.

Every episode depends on its scenario, agent and seed alone, so the order in which processes get
to them does not matter, and an episode that is stored need not be run again (``results`` says
when an episode counts as stored). Worker processes run agents and say what the robots did; this
one simulates that again and measures it, so that no agent can touch a metric.
"""

from __future__ import annotations

import json
import warnings
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from crowdbench.agent import AgentError, AgentSpec, agent_names, find_agent, require_suited
from crowdbench.compiled import note_run, was_run
from crowdbench.evaluation.database import used
from crowdbench.evaluation.driven import Driven, ResimulationError
from crowdbench.evaluation.executors import EXECUTORS, Executor, ExecutorError
from crowdbench.evaluation.pool import Limits
from crowdbench.evaluation.protocol import (
    MOST_WARNINGS,
    Answer,
    Broken,
    Describe,
    Described,
    Done,
    Job,
    Lost,
    Message,
    Refused,
)
from crowdbench.evaluation.results import Cell, ResultsStore, scenario_label
from crowdbench.evaluation.scoring import Scorer
from crowdbench.scenario import Scenario, ScenarioError
from crowdbench.simulation import WORLD_VERSION


@dataclass(frozen=True)
class Task:
    """One agent in one scenario on some seeds."""

    scenario: Scenario
    agent: AgentSpec
    seeds: Sequence[int]


@dataclass(frozen=True)
class Progress:
    """How far a run has come.

    Attributes:
        total: episodes of the plan.
        stored: those that were there before.
        done: those run since.
        jobs: processes that work at the same time.
        rows: of the episode that just ended, one per robot; empty at the start.
    """

    total: int
    stored: int
    done: int
    jobs: int
    rows: Sequence[Mapping[str, Any]] = ()


@dataclass(frozen=True)
class Missing:
    """An episode that was wanted and has no row."""

    cell: Cell
    seed: int
    reason: str

    def __str__(self) -> str:
        return f"{self.cell.agent} in {self.cell.scenario}, seed {self.seed}: {self.reason}"


class IncompleteError(RuntimeError):
    """Episodes that could not be run, or are not what an agent's process told of them.

    Everything else is stored.

    Attributes:
        cells: those of the run, as it would have returned them.
        missing: the episodes, in the order in which they were tried.
    """

    def __init__(self, cells: list[Cell], missing: Sequence[Missing]) -> None:
        super().__init__(f"{len(missing)} episodes are missing: {'; '.join(map(str, missing[:3]))}")
        self.cells, self.missing = cells, missing


def run(
    tasks: Sequence[Task],
    folder: str | Path,
    *,
    jobs: int | None = None,
    limits: Limits | None = None,
    executor: str = "local",
    address: str | None = None,
    retry_errors: bool = False,
    on_progress: Callable[[Progress], None] = lambda progress: None,
    on_note: Callable[[str], None] = lambda note: None,
) -> list[Cell]:
    """Run the episodes of a plan that are not stored yet, and store them as they end.

    Ended by an exception (Ctrl-C included), it stops its processes and keeps what is finished;
    called again, it goes on from there.

    Args:
        tasks: the plan; episodes are run in its order.
        folder: results folder.
        jobs: worker processes that work at the same time, by default one per core. However many
            there are, an agent computes in a single thread.
        limits: for agent code.
        executor: where agents run, a name in ``EXECUTORS``.
        address: which cluster, for executors that can be told.
        retry_errors: run stored episodes that ended with ``agent_error`` again and replace them.
        on_progress: called at the start and after every episode.
        on_note: told in a line what takes long and happens once.

    Returns:
        The cells of the tasks, in their order, to look up their rows.

    Raises:
        AgentError: an agent cannot be made, or cannot act for a scenario's drive or people.
        ScenarioError: a scenario has no room, with any of its seeds.
        ResultsError: the results folder cannot be written to.
        ExecutorError, UnknownNameError: agents cannot be run where they should, or in no process.
        IncompleteError: at the end, if episodes are missing.
    """
    if jobs is not None and jobs < 1:
        raise ExecutorError(f"jobs: {jobs}; allowed: 1 or more")
    folder = Path(folder)
    store, scorer = ResultsStore(folder), Scorer()
    for task in tasks:
        _require_known(task.agent.name)
    missing: list[Missing] = []
    with used(folder), EXECUTORS[executor](jobs, limits or Limits(), address) as workers:
        workers.prepare(sum(len(task.seeds) for task in tasks))
        identities = _identify(workers, [task.agent for task in tasks])
        for task in tasks:
            label = str(task.agent)
            its = identities[label]
            require_suited(its.drives, its.unsupported_models, label, task.scenario)
        cells = [_cell(task, identities[str(task.agent)]) for task in tasks]
        queue: deque[Message] = deque()
        for task, cell in zip(tasks, cells, strict=True):
            finished = store.stored(cell, errors=not retry_errors)
            robots = set(_robots(task.scenario))
            wanted = [seed for seed in task.seeds if not finished.get(seed, set()) >= robots]
            queue.extend(Job(task.scenario, task.agent, cell, seed) for seed in wanted)
        total = sum(len(task.seeds) for task in tasks)
        progress = Progress(total, stored=total - len(queue), done=0, jobs=workers.jobs)
        on_progress(progress)
        _compile(scorer, queue, on_note, agents=not workers.remote)
        without_room: dict[Cell, ScenarioError] = {}
        warned: set[tuple[str, str]] = set()
        for job, answer, origin in workers.run(queue):
            assert isinstance(job, Job)
            _pass_on_warnings(job.cell.agent, answer, warned)
            try:
                driven = _driven(job, answer)
                results = scorer.score(job.scenario, job.cell.agent, job.seed, driven, origin.now())
            except _NotRunError as error:
                missing.append(Missing(job.cell, job.seed, str(error)))
                continue
            except ResimulationError as error:
                told = f"not what the agent's process told of it: {error}"
                missing.append(Missing(job.cell, job.seed, told))
                continue
            except ScenarioError as error:
                without_room[job.cell] = error
                missing.append(Missing(job.cell, job.seed, str(error)))
                continue
            store.append(job.cell, results, job.scenario, replace_errors=retry_errors)
            rows = [result.row(job.cell) for result in results]
            progress = replace(progress, done=progress.done + 1, jobs=workers.jobs, rows=rows)
            on_progress(progress)
    for cell, refusal in without_room.items():
        if not store.stored(cell):
            raise refusal
    if missing:
        raise IncompleteError(cells, missing)
    return cells


def _require_known(name: str) -> None:
    """Refuse a name that nothing has, without importing what has the others."""
    if name not in agent_names() and not Path(name.partition(":")[0]).is_file():
        find_agent(name)


def _identify(workers: Executor, agents: Sequence[AgentSpec]) -> dict[str, Described]:
    """Make every agent once: finds the user's mistakes, and the hashes of weights and files."""
    queue: deque[Message] = deque(Describe(spec) for spec in {str(a): a for a in agents}.values())
    identities = {}
    for message, answer, _ in workers.run(queue):
        label = str(message.agent)
        if isinstance(answer, Refused):
            raise answer.error
        if isinstance(answer, Lost):
            raise AgentError(f"agent {label!r}: {answer.reason}")
        if isinstance(answer, Broken):
            raise AgentError(f"agent {label!r}: it cannot be made: {_last_line(answer)}")
        if not isinstance(answer, Described):
            raise AgentError(f"agent {label!r}: its process answered something else")
        identities[label] = answer
    return identities


def _compile(
    scorer: Scorer, queue: Sequence[Message], on_note: Callable[[str], None], *, agents: bool
) -> None:
    """Compile what this process needs before others need the same, and say so.

    What an agent needs is compiled in its first process, see ``Pool``; it is named where
    ``agents`` run on this machine.
    """
    installed = {message.agent.name for message in queue} & set(agent_names() if agents else ())
    names = ["crowdbench", *sorted(installed)] if queue else []
    fresh = [name for name in names if not was_run(name)]
    if not fresh:
        return
    on_note(f"compiling for {', '.join(fresh)} (once per machine) ...")
    first = queue[0]
    if "crowdbench" in fresh and isinstance(first, Job):
        scorer.compile(first.scenario, first.seed)
    for name in fresh:
        note_run(name)


def _cell(task: Task, identity: Described) -> Cell:
    return Cell(
        scenario=scenario_label(task.scenario),
        scenario_digest=task.scenario.digest,
        agent=str(task.agent),
        options=json.dumps(dict(task.agent.options), sort_keys=True, default=str),
        world=WORLD_VERSION,
        weights_sha256=identity.weights_sha256,
        code=identity.code,
    )


def _robots(scenario: Scenario) -> list[str]:
    return [f"robot_{r}" for r in range(scenario.robots.count)]


class _NotRunError(Exception):
    """An episode could not be run, which is not the agent's result; the message says why."""


def _driven(job: Job, answer: Answer | Lost) -> list[Driven]:
    """What the robots did; nothing, when the agent ended the process that ran them."""
    if isinstance(answer, Lost):
        if answer.outside:
            raise _NotRunError(f"{answer.reason}, twice")
        return [Driven.lost(robot, answer.reason) for robot in _robots(job.scenario)]
    if isinstance(answer, Refused):
        raise (
            answer.error
            if isinstance(answer.error, ScenarioError)
            else _NotRunError(str(answer.error))
        )
    if isinstance(answer, Broken):
        raise _NotRunError(f"its worker process failed: {_last_line(answer)}")
    if not isinstance(answer, Done):
        raise _NotRunError("its process answered something else")
    return answer.driven


def _pass_on_warnings(agent: str, answer: Answer | Lost, warned: set[tuple[str, str]]) -> None:
    """Warn of what an agent warned of in its process, of each thing once and of some in a run."""
    told = sum(name == agent for name, _ in warned)
    for text in answer.warned if isinstance(answer, Done) else ():
        if (agent, text) not in warned and told <= MOST_WARNINGS:
            warned.add((agent, text))
            told += 1
            shown = text if told <= MOST_WARNINGS else "further warnings of this run are not shown"
            warnings.warn(f"agent {agent!r}: {shown}", stacklevel=3)


def _last_line(broken: Broken) -> str:
    lines = broken.traceback.strip().splitlines()
    place = next((line.strip() for line in reversed(lines) if line.startswith("  File ")), "")
    return f"{lines[-1]} ({place})"
