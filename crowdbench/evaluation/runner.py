"""A plan of runs in, stored rows out: in parallel, resumable, and the same either way.

Every episode depends on its scenario, agent and seed alone, so the order in which processes get
to them does not matter, and an episode that is stored need not be run again (``results`` says
when an episode counts as stored).
"""

from __future__ import annotations

import json
import os
import platform
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

from crowdbench.agent import AgentError, AgentSpec, agent_names, find_agent, require_drive
from crowdbench.evaluation.appending import require_writable
from crowdbench.evaluation.pool import Answer, Limits, Lost, Pool
from crowdbench.evaluation.results import Cell, ResultsStore, scenario_label
from crowdbench.evaluation.trajectories import TrajectoryStore
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
    rows: Sequence[dict[str, str]] = ()


def run(
    tasks: Sequence[Task],
    folder: str | Path,
    *,
    jobs: int | None = None,
    limits: Limits | None = None,
    save_trajectories: bool = False,
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
        save_trajectories: keep whole episodes too; stored rows without one are run again for it.
        on_progress: called at the start and after every episode.

    Returns:
        The cells of the tasks, in their order, to look up their rows.

    Raises:
        AgentError: an agent cannot be made, or cannot act for a scenario's drive.
        ScenarioError: a scenario has no room.
        ResultsError: the results folder cannot be written to.
    """
    folder = Path(folder)
    store, trajectories = ResultsStore(folder), TrajectoryStore(folder)
    require_writable(folder)
    for task in tasks:
        _require_known(task.agent.name)
    jobs = jobs or _cores()
    machine = machine_name(threads=1 if jobs > 1 else _cores())
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
            if save_trajectories:
                whole = trajectories.stored(cell)
                finished = {s: robots & whole.get(s, set()) for s, robots in finished.items()}
            robots = {f"robot_{r}" for r in range(task.scenario.robots.count)}
            missing = [seed for seed in task.seeds if not finished.get(seed, set()) >= robots]
            if missing:
                store.describe_scenario(cell, task.scenario)
            for seed in missing:
                job = Job(task.scenario, task.agent, cell, seed, machine, save_trajectories)
                queue.append(job)
        total = sum(len(task.seeds) for task in tasks)
        progress = Progress(total, stored=total - len(queue), done=0)
        on_progress(progress)
        for message, answer in pool.run(queue):
            assert isinstance(message, Job)
            if isinstance(answer, Lost):
                queue.appendleft(_log_loss(message, answer))
                continue
            done = _checked(answer)
            assert isinstance(done, Done)
            if done.trajectories:
                trajectories.append(message.cell, done.trajectories)
            store.append(message.cell, done.rows)
            progress = replace(progress, done=progress.done + 1, rows=done.rows)
            on_progress(progress)
    return cells


def machine_name(threads: int) -> str:
    """The processor, its cores, and how many threads an agent had."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(line.partition(":")[2].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):  # not Linux, or a processor without a name
        pass
    return f"{name}, {_cores()} cores, {threads} thread{'s' * (threads > 1)} per agent"


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


def _log_loss(job: Job, lost: Lost) -> Job:
    if job.lost is not None:
        raise RuntimeError(f"{job.cell.scenario}, seed {job.seed}: {lost.reason}, twice")
    return replace(job, lost=lost.reason)


def _checked(answer: Answer) -> Done | Described:
    if isinstance(answer, Refused):
        raise answer.error
    if isinstance(answer, Broken):
        raise RuntimeError(f"a worker process failed:\n{answer.traceback}")
    return answer


def _cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
