"""A plan of runs in, stored episodes out: in parallel, resumable, and the same either way.

Every episode depends on its scenario, agent and seed alone, so the order in which processes get
to them does not matter, and an episode that is stored need not be run again (``results`` says
when an episode counts as stored). Worker processes run agents and say what the robots did; this
one simulates that again and measures it, so that no agent can touch a metric.
"""

from __future__ import annotations

import json
import os
import platform
import warnings
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from crowdbench.agent import AgentError, AgentSpec, agent_names, find_agent, require_drive
from crowdbench.evaluation.database import require_writable
from crowdbench.evaluation.driven import Driven
from crowdbench.evaluation.pool import Answer, Limits, Lost, Pool
from crowdbench.evaluation.resimulate import ResimulationError
from crowdbench.evaluation.results import Cell, ResultsStore, scenario_label
from crowdbench.evaluation.scoring import Scorer
from crowdbench.evaluation.worker import Broken, Describe, Described, Done, Job, Message, Refused
from crowdbench.scenario import Scenario


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
        rows: of the episode that just ended, one per robot; empty at the start.
    """

    total: int
    stored: int
    done: int
    rows: Sequence[Mapping[str, Any]] = ()


class UnfaithfulError(RuntimeError):
    """Episodes that are not what an agent's process told of them; everything else is stored.

    Attributes:
        cells: those of the run, as it would have returned them.
        episodes: a line for each, which agent, scenario and seed it was.
    """

    def __init__(self, cells: list[Cell], episodes: Sequence[str]) -> None:
        super().__init__(
            f"{len(episodes)} episodes are not stored, because they are not what the agent's "
            f"process told of them: {'; '.join(episodes[:3])}"
        )
        self.cells, self.episodes = cells, episodes


def run(
    tasks: Sequence[Task],
    folder: str | Path,
    *,
    jobs: int | None = None,
    limits: Limits | None = None,
    on_progress: Callable[[Progress], None] = lambda progress: None,
) -> list[Cell]:
    """Run the episodes of a plan that are not stored yet, and store them as they end.

    Ended by an exception (Ctrl-C included), it stops its processes and keeps what is finished;
    called again, it goes on from there.

    Args:
        tasks: the plan; episodes are run in its order.
        folder: results folder.
        jobs: worker processes, by default one per core. With more than one, each agent computes
            in a single thread, which is also how ``inference_s`` is then to be read.
        limits: for agent code.
        on_progress: called at the start and after every episode.

    Returns:
        The cells of the tasks, in their order, to look up their rows.

    Raises:
        AgentError: an agent cannot be made, or cannot act for a scenario's drive.
        ScenarioError: a scenario has no room.
        ResultsError: the results folder cannot be written to.
        UnfaithfulError: at the end, if an agent's process told of episodes that do not happen.
    """
    folder = Path(folder)
    store, scorer = ResultsStore(folder), Scorer()
    require_writable(folder)
    for task in tasks:
        _require_known(task.agent.name)
    jobs = jobs or core_count()
    machine = machine_name(threads=1 if jobs > 1 else core_count())
    with Pool(jobs, limits or Limits()) as pool:
        pool.prepare(sum(len(task.seeds) for task in tasks))
        identities = _identify(pool, [task.agent for task in tasks])
        for task in tasks:
            label = str(task.agent)
            require_drive(identities[label].drives, label, task.scenario)
        cells = [_cell(task, identities[str(task.agent)]) for task in tasks]
        queue: deque[Message] = deque()
        for task, cell in zip(tasks, cells, strict=True):
            finished = store.stored(cell)
            robots = set(_robots(task.scenario))
            missing = [seed for seed in task.seeds if not finished.get(seed, set()) >= robots]
            queue.extend(Job(task.scenario, task.agent, cell, seed) for seed in missing)
        total = sum(len(task.seeds) for task in tasks)
        progress = Progress(total, stored=total - len(queue), done=0)
        on_progress(progress)
        unfaithful = []
        told: set[tuple[str, str]] = set()
        for job, answer in pool.run(queue):
            assert isinstance(job, Job)
            _pass_on_warnings(job.cell.agent, answer, told)
            try:
                results = scorer.score(
                    job.scenario, job.cell.agent, job.seed, _driven(job, answer), machine
                )
            except ResimulationError as error:
                unfaithful.append(f"{job.cell.agent} in {job.cell.scenario}: {error}")
                continue
            store.append(job.cell, results, job.scenario)
            rows = [result.row(job.cell) for result in results]
            progress = replace(progress, done=progress.done + 1, rows=rows)
            on_progress(progress)
    if unfaithful:
        raise UnfaithfulError(cells, unfaithful)
    return cells


def machine_name(threads: int) -> str:
    """The processor, its cores, and how many threads an agent had."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(line.partition(":")[2].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):  # not Linux, or a processor without a name
        pass
    return f"{name}, {core_count()} cores, {threads} thread{'s' * (threads > 1)} per agent"


def _require_known(name: str) -> None:
    """Refuse a name that nothing has, without importing what has the others."""
    if name not in agent_names() and not Path(name.partition(":")[0]).is_file():
        find_agent(name)


def _identify(pool: Pool, agents: Sequence[AgentSpec]) -> dict[str, Described]:
    """Make every agent once: finds the user's mistakes, and the hashes of weights and files."""
    queue: deque[Message] = deque(Describe(spec) for spec in {str(a): a for a in agents}.values())
    identities = {}
    for message, answer in pool.run(queue):
        if isinstance(answer, Lost):
            raise AgentError(f"agent {str(message.agent)!r}: {answer.reason}")
        described = _checked(answer)
        assert isinstance(described, Described)
        identities[str(message.agent)] = described
    return identities


def _cell(task: Task, identity: Described) -> Cell:
    return Cell(
        scenario=scenario_label(task.scenario),
        scenario_digest=task.scenario.digest,
        agent=str(task.agent),
        options=json.dumps(dict(task.agent.options), sort_keys=True, default=str),
        version=version("crowdbench-nav"),
        weights_sha256=identity.weights_sha256,
        code=identity.code,
    )


def _robots(scenario: Scenario) -> list[str]:
    return [f"robot_{r}" for r in range(scenario.robots.count)]


def _driven(job: Job, answer: Answer | Lost) -> list[Driven]:
    """What the robots did; nothing, when the process that ran them was lost."""
    if isinstance(answer, Lost):
        return [Driven.lost(robot, answer.reason) for robot in _robots(job.scenario)]
    done = _checked(answer)
    assert isinstance(done, Done)
    return done.driven


def _pass_on_warnings(agent: str, answer: Answer | Lost, told: set[tuple[str, str]]) -> None:
    """Warn of what an agent warned of in its process, of each thing once in a run."""
    for text in answer.warned if isinstance(answer, Done) else ():
        if (agent, text) not in told:
            told.add((agent, text))
            warnings.warn(f"agent {agent!r}: {text}", stacklevel=3)


def _checked(answer: Answer) -> Done | Described:
    if isinstance(answer, Refused):
        raise answer.error
    if isinstance(answer, Broken):
        raise RuntimeError(f"a worker process failed:\n{answer.traceback}")
    return answer


def core_count() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
