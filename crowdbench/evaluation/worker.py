"""The process that runs episodes: agent code runs here and nowhere else.

It answers one message after the other, and gives its pulse while agent code runs.

Everything heavy is imported in ``main``: the parent imports this module for the messages alone.
"""

from __future__ import annotations

import contextlib
import copy
import faulthandler
import hashlib
import os
import resource
import signal
import sys
import traceback
import warnings
from dataclasses import dataclass
from importlib.metadata import entry_points
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench.agent import ENTRY_POINT_GROUP, Agent, AgentError, AgentSpec
from crowdbench.evaluation.driven import Driven
from crowdbench.evaluation.pulse import MAKING, WARM_UP, Pulse
from crowdbench.evaluation.results import Cell
from crowdbench.scenario import Scenario, ScenarioError

if TYPE_CHECKING:
    from crowdbench.simulation.env import CrowdEnv

MAX_WARNING = 1000
"""Of a warning that agent code gives [characters]."""


@dataclass(frozen=True)
class Describe:
    """Make the agent and say which one it is."""

    agent: AgentSpec


@dataclass(frozen=True)
class Job:
    """Run one episode."""

    scenario: Scenario
    agent: AgentSpec
    cell: Cell
    seed: int


@dataclass(frozen=True)
class Described:
    """Answer to Describe: what distinguishes this agent from another of the same name."""

    weights_sha256: str
    code: str
    drives: tuple[str, ...] | None


@dataclass(frozen=True)
class Done:
    """Answer to Job: what each robot did, which the parent simulates again to measure it.

    Attributes:
        driven: of each robot.
        warned: warnings since the last answer, each in one line.
    """

    driven: list[Driven]
    warned: tuple[str, ...] = ()


@dataclass(frozen=True)
class Refused:
    """Answer to either: the user's mistake."""

    error: AgentError | ScenarioError


@dataclass(frozen=True)
class Broken:
    """Answer to either: a mistake of crowdbench's, with the traceback."""

    traceback: str


Message = Describe | Job
Answer = Described | Done | Refused | Broken


def main() -> None:
    """Serve messages until the parent is gone; arguments are the descriptors to use."""
    connection_fd, pulse_fd, crash_fd, parent = (int(item) for item in sys.argv[-4:])
    for descriptor in (connection_fd, pulse_fd, crash_fd):
        os.set_inheritable(descriptor, False)
    _die_with(parent)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    # What is on the stack when the process crashes or is stopped tells where it was.
    faulthandler.enable(crash_fd, all_threads=False)
    import crowdbench.evaluation.rollout  # noqa: F401 - now, while the parent is still planning

    worker = _Worker(Pulse(pulse_fd))
    connection = Connection(connection_fd)
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            connection.send(worker.answer(connection.recv()))


def code_version(name: str) -> str:
    """Hash of the file of a ``file.py:Class`` agent, else the distribution that brings it."""
    path = name.partition(":")[0]
    if path.endswith(".py"):
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:12]
    for point in entry_points(group=ENTRY_POINT_GROUP):
        if point.name == name and point.dist is not None:
            return f"{point.dist.name} {point.dist.version}"
    return ""


class _Worker:
    """Keeps the last environment and the last agents, which the next job mostly needs again."""

    def __init__(self, pulse: Pulse) -> None:
        self._pulse = pulse
        self._env: CrowdEnv | None = None
        self._label = ""
        self._agents: list[Agent] = []
        self._described = Described("", "", None)
        self._warm = False
        self._warned: list[str] = []
        warnings.showwarning = self._note

    def answer(self, message: Message) -> Answer:
        try:
            if isinstance(message, Describe):
                self._make(message.agent, count=1)
                return self._described
            return self._run(message)
        except (AgentError, ScenarioError) as error:
            return Refused(copy.copy(error))  # without what caused it, which may not travel
        except Exception:
            return Broken(traceback.format_exc())

    def _run(self, job: Job) -> Done:
        from crowdbench.evaluation.rollout import run_episode, warm_up

        env, label = self._environment(job.scenario), str(job.agent)
        self._make(job.agent, count=job.scenario.robots.count)
        made = self._described.weights_sha256, self._described.code
        if made != (job.cell.weights_sha256, job.cell.code):
            raise AgentError(f"agent {label!r} was changed during the run; run again")
        if not self._warm:
            observations, _ = env.reset(seed=job.seed)
            with self._pulse.during(WARM_UP):
                warm_up(env, self._agents, observations)
            self._warm = True
        episodes = run_episode(env, self._agents, job.seed, label=label, on_call=self._pulse.beat)
        warned, self._warned = tuple(self._warned), []
        return Done([Driven.of(episode) for episode in episodes], warned)

    def _note(self, message: Warning | str, *place: Any, **more: Any) -> None:
        """Keep a warning for the parent, which shows each once however many processes there are."""
        self._warned.append(" ".join(str(message).split())[:MAX_WARNING])

    def _environment(self, scenario: Scenario) -> CrowdEnv:
        from crowdbench.simulation.env import CrowdEnv

        if self._env is None or self._env.scenario != scenario:
            self._env = CrowdEnv(scenario)
        return self._env

    def _make(self, spec: AgentSpec, count: int) -> None:
        if self._label != str(spec):
            self._agents, self._label, self._warm = [], str(spec), False
        if len(self._agents) == count:
            return
        with self._pulse.during(MAKING):
            del self._agents[count:]
            self._agents += [spec.make() for _ in range(count - len(self._agents))]
        weights = self._agents[0].weights_sha256 or ""
        self._described = Described(weights, code_version(spec.name), self._agents[0].drives)


def _die_with(parent: int) -> None:
    """Ask Linux to end this process with its parent, however that ends."""
    if sys.platform == "linux":
        import ctypes

        pr_set_pdeathsig = 1
        ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)
    if os.getppid() != parent:
        sys.exit()
