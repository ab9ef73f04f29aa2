"""One episode: an environment and its agents in, one log per robot out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crowdbench.agent import Agent, AgentSpec, require_suited
from crowdbench.evaluation.episode import Episode, Outcome, Source
from crowdbench.evaluation.heartbeat import RESET
from crowdbench.messages import describe_error, is_interrupt, plain_text, short
from crowdbench.robot import Observation
from crowdbench.scenario import Scenario
from crowdbench.simulation import streams
from crowdbench.simulation.contact import Contact
from crowdbench.simulation.env import CrowdEnv, parallel_env
from crowdbench.simulation.kinematics import make_drive
from crowdbench.simulation.observations import as_numbers

State = Mapping[str, NDArray[Any]]
OnCall = Callable[[int | None], None]
"""Told the step (or RESET) before an agent's code runs, and None when it has returned."""


@dataclass
class _Log:
    """What one robot has done so far."""

    robot: str
    index: int
    outcome: Outcome | None = None
    error: str | None = None
    contact: Contact | None = None
    inference_s: list[float] = field(default_factory=list)
    processor_s: float = 0.0
    actions: list[NDArray[np.float64]] = field(default_factory=list)
    commands: list[NDArray[np.float64]] = field(default_factory=list)
    diagnostics: dict[str, float] = field(default_factory=dict)

    def fail(self, message: str) -> None:
        self.outcome, self.error = "agent_error", message


def run_episode(
    scenario: str | Path | Scenario | CrowdEnv,
    agent: str | AgentSpec | Sequence[Agent],
    seed: int,
    *,
    label: str | None = None,
    on_step: Callable[[CrowdEnv], None] | None = None,
    on_call: OnCall = lambda step: None,
) -> list[Episode]:
    """Run one episode and log it.

    An agent that raises, or returns anything but two finite numbers, ends its robot's episode
    with the outcome ``agent_error``; other robots go on, past a robot that stands still.

    Args:
        scenario: name, file, Scenario, or an environment to use again.
        agent: which planner drives every robot, or one agent per robot.
        seed: episode seed.
        label: name of the agent in the log; for ready-made agents, their class by default.
        on_step: called after the reset and after every step.
        on_call: see ``OnCall``.

    Returns:
        One episode per robot, in the order of the robots.

    Raises:
        ScenarioError, AgentError: they cannot be found or made, there is no room, or the agent
            cannot act for the scenario's drive or among its people.
    """
    env = scenario if isinstance(scenario, CrowdEnv) else parallel_env(scenario)
    logs = _logs(env)
    if isinstance(agent, str):
        agent = AgentSpec.parse(agent)
    if isinstance(agent, AgentSpec):
        label = label or str(agent)
        agent = [agent.make() for _ in logs]
    if len(agent) != len(logs):
        raise ValueError(f"{len(logs)} robots need as many agents, got {len(agent)}")
    for one in agent:
        name = label or type(one).__name__
        require_suited(one.drives, one.unsupported_models, name, env.scenario)
    agents = {log.robot: agent[log.index] for log in logs}
    observations, _ = env.reset(seed=seed)
    states: list[State] = [env.state()]
    if on_step:
        on_step(env)
    for log in logs:
        _reset(log, agents[log.robot], env, seed, on_call)
    while any(log.outcome is None for log in logs):
        live = [log for log in logs if log.robot in env.agents]
        actions = {}
        for log in live:
            observation = observations[log.robot]
            actions[log.robot] = _act(log, agents[log.robot], observation, states[-1], on_call)
        if all(log.outcome for log in logs):
            break
        observations, _, _, _, infos = env.step(actions)
        states.append(env.state())
        for log in live:
            if log.outcome is None:
                log.actions.append(states[-1]["robot_velocity"][log.index])
                log.commands.append(actions[log.robot])
                outcome = infos[log.robot]["outcome"]
                log.outcome = None if outcome == "running" else outcome
                log.contact = infos[log.robot]["contact"]
        if on_step:
            on_step(env)
    for log in logs:
        _ask_diagnostics(log, agents[log.robot], on_call)
    label = label or type(agent[0]).__name__
    commands = [np.array(log.commands).reshape(-1, 2) for log in logs]
    source = Source(env.scenario, seed, commands)
    return [_episode(log, source, label, states) for log in logs]


def warm_up(
    env: CrowdEnv, agents: Sequence[Agent], observations: Mapping[str, Mapping[str, Any]]
) -> None:
    """Let agents act once, unrecorded, after a reset: compiling and loading are not planning.

    What goes wrong here goes wrong again, and is reported, in the episode that follows.
    """
    try:
        for log, agent in zip(_logs(env), agents, strict=True):
            agent.reset(env.robot_spec(log.robot), streams.agent_seed(0, log.index))
            agent.act(_sense(agent, observations[log.robot], env.state()))
    except BaseException as error:
        if is_interrupt(error):
            raise


def _logs(env: CrowdEnv) -> list[_Log]:
    return [_Log(f"robot_{r}", r) for r in range(env.scenario.robots.count)]


def _reset(log: _Log, agent: Agent, env: CrowdEnv, seed: int, on_call: OnCall) -> None:
    on_call(RESET)
    try:
        agent.reset(env.robot_spec(log.robot), streams.agent_seed(seed, log.index))
    except BaseException as error:
        log.fail(_described(error))
    finally:
        on_call(None)


def _act(
    log: _Log,
    agent: Agent,
    observation: Mapping[str, NDArray[np.float32]],
    state: State,
    on_call: OnCall,
) -> NDArray[np.float64]:
    """The agent's action, checked; zero once the agent has failed."""
    if log.outcome is not None:
        return np.zeros(2)
    sensed = _sense(agent, observation, state)
    on_call(len(log.actions))
    try:
        processor = time.process_time()
        start = time.perf_counter()
        action = agent.act(sensed)
        log.inference_s.append(time.perf_counter() - start)
        log.processor_s += time.process_time() - processor
        try:
            # A copy, as an agent may hand over the same array at every step.
            array = as_numbers(action)
        except (TypeError, ValueError):
            log.fail(f"act returned {short(action)}, expected two numbers, e.g. v [m/s], w [rad/s]")
            return np.zeros(2)
    except BaseException as error:
        log.fail(_described(error))
        return np.zeros(2)
    finally:
        on_call(None)
    if array.shape != (2,):
        log.fail(f"act returned shape {array.shape}, expected (2,), e.g. v [m/s], w [rad/s]")
    elif not np.isfinite(array).all():
        log.fail(f"act returned {array.tolist()}, expected finite numbers")
    return array if log.outcome is None else np.zeros(2)


def _described(error: BaseException) -> str:
    """What an agent's exception says; Ctrl-C is not the agent's."""
    if is_interrupt(error):
        raise error
    return describe_error(error)


def _sense(
    agent: Agent, observation: Mapping[str, NDArray[np.float32]], state: State
) -> Observation:
    """What the agent may know; a copy of the state, so that the log stays as it is."""
    known = {key: value.copy() for key, value in state.items()} if agent.privileged else None
    return Observation(**observation, state=known)


def _ask_diagnostics(log: _Log, agent: Agent, on_call: OnCall) -> None:
    on_call(len(log.actions))
    try:
        items = agent.diagnostics().items()
        log.diagnostics = {plain_text(str(key)): float(value) for key, value in items}
    except BaseException as error:
        log.error = log.error or f"diagnostics: {_described(error)}"
    finally:
        on_call(None)


def _top_speed(scenario: Scenario) -> float:
    """The fastest that a robot can travel [m/s]; it does so at a corner of the drive's bounds."""
    drive = make_drive(scenario)
    corners = product(*zip(drive.low.tolist(), drive.high.tolist(), strict=True))
    return max(abs(drive.travel(0.0, corner)[2]) for corner in corners)


def _episode(log: _Log, source: Source, label: str, states: Sequence[State]) -> Episode:
    scenario, steps = source.scenario, len(log.actions)
    arrays = {
        key: np.stack([state[key] for state in states[: steps + 1]])
        for key in states[0]
        if key.startswith(("robot_", "pedestrian_"))
    }
    poses, active = arrays["robot_pose"], arrays["robot_active"]
    # A robot is still there in the state in which it arrives or collides, and gone after it.
    present = np.vstack([active[:1], active[:-1]])
    others = np.where(present[:, :, None], poses, np.nan)
    assert log.outcome is not None
    return Episode(
        scenario=scenario.name,
        agent=label,
        seed=source.seed,
        robot=log.robot,
        control_period=scenario.control_period,
        footprint=(scenario.robots.length, scenario.robots.width),
        goal_tolerance=scenario.robots.goal_tolerance,
        top_speed=_top_speed(scenario),
        goal=states[0]["robot_goal"][log.index],
        walls=states[0]["walls"],
        obstacles=states[0]["obstacles"],
        pedestrian_radius=states[0]["pedestrian_radius"],
        robot_pose=poses[:, log.index],
        robot_world_velocity=arrays["robot_world_velocity"][:, log.index],
        robot_speed=arrays["robot_speed"][:, log.index],
        actions=np.array(log.actions).reshape(-1, 2),
        commands=source.commands[log.index],
        other_robots=np.delete(others, log.index, axis=1),
        pedestrian_reactive=states[0]["pedestrian_reactive"],
        pedestrian_attentive=arrays["pedestrian_attentive"],
        pedestrian_position=arrays["pedestrian_position"],
        pedestrian_velocity=arrays["pedestrian_velocity"],
        pedestrian_goal=arrays["pedestrian_goal"],
        pedestrian_intent=arrays["pedestrian_intent"],
        pedestrian_switch_time=arrays["pedestrian_switch_time"],
        pedestrian_group=states[0]["pedestrian_group"],
        pedestrian_queue=states[0]["pedestrian_queue"],
        pedestrian_place=arrays["pedestrian_place"],
        pedestrian_stop_time=arrays["pedestrian_stop_time"],
        pedestrian_stop_end=arrays["pedestrian_stop_end"],
        inference_s=np.array(log.inference_s[:steps]),
        outcome=log.outcome,
        contact=log.contact,
        error=log.error,
        diagnostics=log.diagnostics,
        processor_share=log.processor_s / max(sum(log.inference_s), 1e-9) if steps else 1.0,
        source=source,
    )
