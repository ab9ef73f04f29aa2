"""What the robots did in an episode, and the episode from that: no agent has a hand in it.

An agent's process says what each robot asked for, how long that took and how it ended. Everything
else is simulated again outside that process, so what the metrics see is the simulation's.
"""

from __future__ import annotations

import dataclasses
import json
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from crowdbench.evaluation.episode import Episode
    from crowdbench.scenario import Scenario
    from crowdbench.simulation.env import CrowdEnv


class ResimulationError(ValueError):
    """Commands that do not belong to the episode; the message says which robot and step."""


@dataclass(frozen=True)
class Driven:
    """One robot's part in an episode of T steps, as its agent's process tells it.

    Attributes:
        robot: name of the robot in the environment.
        commands: (T, 2), as in ``Episode.commands``.
        inference_s: (T,) wall-clock seconds spent in ``act``, NaN where that was not noted.
        outcome: how it ended.
        error: the agent's message, or None.
        diagnostics: the agent's own counters.
        processor_share: as in ``Episode``.
    """

    robot: str
    commands: NDArray[np.float64]
    inference_s: NDArray[np.float64]
    outcome: str
    error: str | None = None
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    processor_share: float = 1.0

    @classmethod
    def of(cls, episode: Episode) -> Driven:
        """What there is to say of an episode that was just run."""
        return cls(
            episode.robot,
            episode.commands,
            episode.inference_s,
            episode.outcome,
            episode.error,
            dict(episode.diagnostics),
            episode.processor_share,
        )

    @classmethod
    def lost(cls, robot: str, reason: str) -> Driven:
        """A robot whose agent's process was lost: no steps, and the reason."""
        return cls(robot, np.empty((0, 2)), np.empty(0), "agent_error", reason)


def packed(commands: NDArray[np.float64], inference_s: NDArray[np.float64]) -> tuple[bytes, bytes]:
    """Commands (T, 2), compressed, and times (T,) in single precision, as they are stored."""
    return zlib.compress(commands.astype("<f8").tobytes()), inference_s.astype("<f4").tobytes()


def unpacked(
    robot: str,
    outcome: str,
    error: str,
    diagnostics: str,
    steps: int,
    commands: bytes,
    inference_s: bytes,
) -> Driven:
    """What is stored of a robot's part in an episode.

    Raises:
        ValueError: it is damaged.
    """
    try:
        asked = np.frombuffer(zlib.decompress(commands), dtype="<f8").reshape(steps, 2)
        taken = np.frombuffer(inference_s, dtype="<f4").reshape(steps)
    except zlib.error as damage:
        raise ValueError(f"{robot}: {damage}") from damage
    counters = json.loads(diagnostics)
    return Driven(robot, asked.astype(float), taken.astype(float), outcome, error or None, counters)


def simulate(
    scenario: Scenario | CrowdEnv,
    seed: int,
    driven: Sequence[Driven],
    *,
    label: str,
    on_step: Callable[[CrowdEnv], None] | None = None,
) -> list[Episode]:
    """Simulate an episode again, with the times and diagnostics of the first time.

    Args:
        scenario: the world, or an environment to use again.
        seed: episode seed.
        driven: what each robot did, in the order of the robots.
        label: name of the agent in the log.
        on_step: called after the reset and after every step.

    Raises:
        ResimulationError: this is not what happens with these commands.
    """
    from crowdbench.evaluation.resimulate import resimulate

    where = f"{label}, seed {seed}"
    world = getattr(scenario, "scenario", scenario)
    if len(driven) != world.robots.count:
        raise ResimulationError(f"{where}: {len(driven)} robots, expected {world.robots.count}")
    for one in driven:
        steps = len(one.commands)
        if one.commands.shape != (steps, 2) or not np.isfinite(one.commands).all():
            raise ResimulationError(
                f"{where}, {one.robot}: commands that are not two finite numbers"
            )
        times = one.inference_s
        if times.shape != (steps,) or np.isinf(times).any() or (times < 0).any():
            raise ResimulationError(f"{where}, {one.robot}: times are not one for each step")
        if not isinstance(one.processor_share, float) or not one.processor_share >= 0:
            raise ResimulationError(f"{where}, {one.robot}: a processor time that cannot be")
    failed = [(one.error or "") if one.outcome == "agent_error" else None for one in driven]
    commands = [one.commands for one in driven]
    episodes = resimulate(scenario, seed, commands, label=label, errors=failed, on_step=on_step)
    for one, episode in zip(driven, episodes, strict=True):
        if (one.robot, one.outcome) != (episode.robot, episode.outcome):
            raise ResimulationError(
                f"{where}, {one.robot}: said to end with {one.outcome}, but {episode.robot} ends "
                f"with {episode.outcome}"
            )
    return [
        dataclasses.replace(
            episode,
            error=one.error,
            inference_s=one.inference_s,
            diagnostics=dict(one.diagnostics),
            processor_share=one.processor_share,
        )
        for one, episode in zip(driven, episodes, strict=True)
    ]
