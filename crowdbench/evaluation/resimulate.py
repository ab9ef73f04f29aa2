"""An episode from its seed and what the robots did: no agent runs.

Scenario, seed and commands fix an episode to the last bit, whatever the processor, the number of
processes or threads, so metrics, replays and pictures can be computed from them at any time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from crowdbench.agent import Action, Agent
from crowdbench.evaluation.driven import ResimulationError
from crowdbench.evaluation.episode import Episode
from crowdbench.evaluation.rollout import run_episode
from crowdbench.robot import Observation, RobotSpec
from crowdbench.scenario import Scenario
from crowdbench.simulation.env import CrowdEnv


class _Repeats(Agent):
    """Asks for what was asked for before, and for nothing after that."""

    drives = None

    def __init__(self, commands: NDArray[np.float64]) -> None:
        self.commands = commands
        self.step = 0

    def reset(self, robot: RobotSpec, seed: int) -> None:
        self.step = 0

    def act(self, observation: Observation) -> Action:
        self.step += 1
        return self.commands[self.step - 1]


def resimulate(
    scenario: Scenario | CrowdEnv,
    seed: int,
    commands: Sequence[NDArray[np.float64]],
    *,
    label: str,
    errors: Sequence[str | None] | None = None,
    on_step: Callable[[CrowdEnv], None] | None = None,
) -> list[Episode]:
    """Simulate an episode again; ``inference_s`` is empty, since nobody decided anything.

    Args:
        scenario: the world, or an environment to use again.
        seed: episode seed.
        commands: for each robot (T_r, 2), as in ``Episode.commands``.
        label: name of the agent in the log.
        errors: for each robot the error that ended its commands, or None.
        on_step: called after the reset and after every step.

    Returns:
        One episode per robot, equal in all but times and diagnostics to what was logged before.

    Raises:
        ResimulationError: too few or too many commands for this scenario and seed, or an error
            that did not end them.
    """
    errors = errors or [None] * len(commands)
    agents = [_Repeats(item) for item in commands]
    episodes = run_episode(scenario, agents, seed, label=label, on_step=on_step)
    found = []
    for episode, given, error in zip(episodes, commands, errors, strict=True):
        where = f"{label}, {episode.scenario}, seed {seed}, {episode.robot}"
        if episode.steps < len(given):
            raise ResimulationError(
                f"{where}: ended after {episode.steps} steps ({episode.outcome}), but there are "
                f"commands for {len(given)}"
            )
        if (episode.outcome == "agent_error") != (error is not None):
            how = "goes on" if error is None else f"ended ({episode.outcome})"
            raise ResimulationError(f"{where}: {how} after the {len(given)} commands")
        found.append(
            dataclasses.replace(episode, error=error, inference_s=np.empty(0), processor_share=1.0)
        )
    return found
