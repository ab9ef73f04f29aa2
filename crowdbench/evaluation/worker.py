"""The process that runs episodes: agent code runs here and nowhere else.

It answers one message after the other, all about the same agent, and gives its heartbeat while
agent code runs.

Everything heavy is imported in ``main``: nothing of it is needed before.
"""

from __future__ import annotations

import contextlib
import faulthandler
import hashlib
import os
import signal
import sys
import traceback
import warnings
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench.agent import Agent, AgentError, AgentSpec, code_version
from crowdbench.call_stack import with_room
from crowdbench.evaluation.driven import Driven
from crowdbench.evaluation.heartbeat import MAKING, WARM_UP, Heartbeat
from crowdbench.evaluation.keeper import keep
from crowdbench.evaluation.protocol import (
    MOST_WARNINGS,
    Answer,
    Broken,
    Describe,
    Described,
    Done,
    Job,
    Message,
    Refused,
)
from crowdbench.messages import plain_text, short
from crowdbench.scenario import NoRoomError, Scenario, ScenarioError

if TYPE_CHECKING:
    from crowdbench.simulation.env import CrowdEnv

_LONGEST_HASH = 200
_LONGEST_WARNING = 1000


@with_room
def main() -> None:
    """Serve messages until the parent is gone; arguments are the descriptors to use."""
    connection_fd, heartbeat_fd, crash_fd, parent = (int(item) for item in sys.argv[-4:])
    descriptors = (connection_fd, heartbeat_fd, crash_fd)
    for descriptor in descriptors:
        os.set_inheritable(descriptor, False)
    keep(parent, descriptors)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    # What is on the stack when the process crashes or is stopped tells where it was.
    faulthandler.enable(crash_fd, all_threads=False)
    # The parent ends this process; an interrupt that arrives here would look like the agent's.
    signal.signal(signal.SIGINT, lambda number, frame: None)
    import crowdbench.evaluation.rollout  # noqa: F401 - now, while the parent is still planning

    heartbeat, connection = Heartbeat(heartbeat_fd), Connection(connection_fd)
    _note_signals(heartbeat)
    # A child that the agent forks has nothing to say to the parent, and nothing to its log.
    os.register_at_fork(after_in_child=connection.close)
    os.register_at_fork(after_in_child=faulthandler.disable)
    worker, itself, folder = _Worker(heartbeat), os.getpid(), Path.cwd()
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            number, message = connection.recv()
            os.chdir(folder)  # where the agent's file is found, wherever the agent has gone
            answer = worker.answer(message)
            if os.getpid() != itself:
                os._exit(0)
            connection.send((number, answer))


class _Worker:
    """Keeps the last environment and the agents, which the next job mostly needs again."""

    def __init__(self, heartbeat: Heartbeat) -> None:
        self._heartbeat = heartbeat
        self._env: CrowdEnv | None = None
        self._agents: list[Agent] = []
        self._described = Described("", "", None)
        self._warm = False
        self._warned: list[str] = []
        warnings.showwarning = self._note_warning

    def answer(self, message: Message) -> Answer:
        try:
            if isinstance(message, Describe):
                self._make(message.agent, count=1)
                return self._described
            return self._run(message)
        except (AgentError, ScenarioError) as error:
            return Refused(_plain(error))
        except BaseException:  # whatever an agent has put in place of what runs here
            return Broken(traceback.format_exc())

    def _run(self, job: Job) -> Done:
        from crowdbench.evaluation.rollout import run_episode, warm_up

        env, label = self._environment(job.scenario), str(job.agent)
        self._make(job.agent, count=job.scenario.robots.count)
        made = self._described.weights_sha256, self._described.code
        if made != (job.cell.weights_sha256, job.cell.code):
            raise AgentError(f"agent {label!r} was changed during the run; run again")
        if not self._warm:
            observations, _ = env.reset(seed=job.seed)  # compiles what it needs, without a limit
            with self._heartbeat.during(WARM_UP):
                warm_up(env, self._agents, observations)
            self._warm = True
            self._heartbeat.note_warm()
        beat = self._heartbeat.beat
        episodes = run_episode(env, self._agents, job.seed, label=label, on_call=beat)
        warned, self._warned = tuple(self._warned), []
        return Done([Driven.of(episode) for episode in episodes], warned)

    def _note_warning(self, message: Warning | str, *place: Any, **more: Any) -> None:
        """Keep a warning for the parent, which shows each once however many processes there are."""
        text = " ".join(str(message).split())[:_LONGEST_WARNING]
        if text not in self._warned and len(self._warned) <= MOST_WARNINGS:
            self._warned.append(text)

    def _environment(self, scenario: Scenario) -> CrowdEnv:
        from crowdbench.simulation.env import CrowdEnv

        if self._env is None or self._env.scenario != scenario:
            self._env, self._warm = CrowdEnv(scenario), False
        return self._env

    def _make(self, spec: AgentSpec, count: int) -> None:
        if len(self._agents) == count:
            return
        with self._heartbeat.during(MAKING):
            del self._agents[count:]
            self._agents += [spec.make() for _ in range(count - len(self._agents))]
            agent = self._agents[0]
            weights = _weights(spec, agent)
            drives = None if agent.drives is None else _names(spec, agent, "drives")
            models = _names(spec, agent, "unsupported_models")
            version = _text(spec, "version", vars(type(agent)).get("version"))
        self._described = Described(weights, code_version(spec.name, version), drives, models)


def _plain(error: AgentError | ScenarioError) -> AgentError | ScenarioError:
    """The same error without what caused it and whatever else may not travel."""
    if isinstance(error, NoRoomError):
        return NoRoomError(plain_text(str(error)), int(error.seed))
    kind = AgentError if isinstance(error, AgentError) else ScenarioError
    return kind(plain_text(str(error)))


def _weights(spec: AgentSpec, agent: Agent) -> str:
    """The agent's word for its weights."""
    return _text(spec, "weights_sha256", agent.weights_sha256)


def _text(spec: AgentSpec, name: str, value: Any) -> str:
    """What an agent says of itself, as text that fits in a line; empty for None."""
    if value is not None and not isinstance(value, str):
        raise AgentError(
            f"agent {short(str(spec))}: {name} is {short(value)}, expected text or None"
        )
    text = plain_text(value or "")
    if text.isprintable() and len(text) <= _LONGEST_HASH:
        return text
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def _names(spec: AgentSpec, agent: Agent, attribute: str) -> tuple[str, ...]:
    """Names that an agent declares."""
    value: Any = getattr(agent, attribute)
    if not isinstance(value, tuple | list) or not all(isinstance(item, str) for item in value):
        raise AgentError(
            f"agent {short(str(spec))}: {attribute} is {short(value)}, expected a tuple of names"
        )
    return tuple(plain_text(item) for item in value)


def _note_signals(heartbeat: Heartbeat) -> None:
    """Note signals that this process or a child of it sends to this process.

    The parent sees only by which signal a process was ended, and not whose it was.
    """
    itself, group, keeper = os.getpid(), os.getpgrp(), os.getppid()
    targets = {
        "os.kill": ((itself,), (keeper,), (-group,), (0,), (-1,)),
        "os.killpg": ((group,), (0,)),
    }

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "signal.pthread_kill" or arguments[:1] in targets.get(event, ()):
            heartbeat.note_signal(int(arguments[1]))

    sys.addaudithook(hook)
    raise_signal = signal.raise_signal

    def noted(signalnum: int, /) -> None:
        heartbeat.note_signal(int(signalnum))
        raise_signal(signalnum)

    signal.raise_signal = noted  # of all these, the one of which no hook is told
