"""Stored episodes simulated and measured again, in processes: what is new, what has changed.

No agent runs. Where episodes are stored, and which of their metrics have to come out the same, is
said by whoever asks: ``recompute`` for local results, ``recompute_record`` for the published ones.
"""

from __future__ import annotations

import math
import multiprocessing
import signal
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from crowdbench.evaluation.database import ResultsError
from crowdbench.evaluation.driven import Driven, ResimulationError, simulate
from crowdbench.scenario import Scenario

CHUNK = 50
"""Episodes that a process gets at a time."""
_TIMED = "inference_s"


@dataclass
class Recomputed:
    """What was found.

    Attributes:
        episodes: simulated again, one per seed.
        filled: in how many rows each metric was filled in.
        disagreements: a line for each episode that came out otherwise; it stays as it was.
        without_commands: a line for each cell with episodes that cannot be simulated again.
    """

    episodes: int = 0
    filled: Counter[str] = field(default_factory=Counter)
    disagreements: list[str] = field(default_factory=list)
    without_commands: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class StoredRobot:
    """A row and its commands.

    Attributes:
        driven: what the robot did.
        known: metrics that have to come out the same, to the last bit; ``inference_s`` is what
            was timed and only has to be there.
    """

    driven: Driven
    known: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class StoredCell:
    """Whose episodes they are: an agent in a scenario, as ``label`` has it."""

    label: str
    agent: str
    scenario: Scenario

    @property
    def name(self) -> str:
        """As messages have it."""
        return f"{self.agent} in {self.label}"


C = TypeVar("C", bound=StoredCell)
R = TypeVar("R", bound=StoredRobot)


@dataclass(frozen=True)
class Piece(Generic[C, R]):
    """Some episodes of a cell, the robots of each seed in their order."""

    cell: C
    seeds: Sequence[tuple[int, Sequence[R]]]


News = list[dict[str, float]] | str
"""For each robot of an episode the metrics that are not known, or how it came out otherwise."""


def remeasure(pieces: Iterator[Piece[C, R]], jobs: int) -> Iterator[tuple[Piece[C, R], list[News]]]:
    """Each piece, in order, with the news of its episodes.

    Args:
        pieces: drawn as they are needed, a few ahead of what is yielded.
        jobs: processes; 1 is this one.

    Raises:
        ResultsError: a process was killed.
        MetricError, UnknownNameError: a metric that cannot be computed or loaded.
    """
    try:
        for piece, measured in _measured(pieces, jobs):
            yield (
                piece,
                [
                    _compared(piece.cell, seed, robots, values)
                    for (seed, robots), values in zip(piece.seeds, measured, strict=True)
                ],
            )
    except BrokenProcessPool as error:
        raise ResultsError(
            "a process that simulates was killed from outside, or for want of memory; what was "
            "written before is kept, and the same command does the rest"
        ) from error


_Values = list[dict[str, float]] | str
"""The metrics of each robot, or why there are none."""


def _measured(
    pieces: Iterator[Piece[C, R]], jobs: int
) -> Iterator[tuple[Piece[C, R], list[_Values]]]:
    if jobs == 1:
        for piece in pieces:
            yield piece, _measure(*_sent(piece))
        return
    waiting: deque[tuple[Piece[C, R], Future[list[_Values]]]] = deque()
    with ProcessPoolExecutor(
        jobs,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),  # Ctrl-C is for the process that writes
    ) as pool:
        for piece in pieces:
            waiting.append((piece, pool.submit(_measure, *_sent(piece))))
            if len(waiting) > 2 * jobs:
                first, future = waiting.popleft()
                yield first, future.result()
        for first, future in waiting:
            yield first, future.result()


def _sent(piece: Piece[C, R]) -> tuple[Scenario, str, list[tuple[int, list[Driven]]]]:
    """What a process needs to know of a piece."""
    seeds = [(seed, [robot.driven for robot in robots]) for seed, robots in piece.seeds]
    return piece.cell.scenario, piece.cell.agent, seeds


def _measure(
    scenario: Scenario, agent: str, seeds: Sequence[tuple[int, list[Driven]]]
) -> list[_Values]:
    """Simulate episodes and compute every metric of each robot."""
    from crowdbench.evaluation.metrics import metrics
    from crowdbench.simulation.env import CrowdEnv

    env, found = CrowdEnv(scenario), list[_Values]()
    for seed, driven in seeds:
        try:
            episodes = simulate(env, seed, driven, label=agent)
        except ResimulationError as error:
            found.append(str(error))
        else:
            found.append([metrics(episode) for episode in episodes])
    return found


def _compared(cell: StoredCell, seed: int, robots: Sequence[StoredRobot], values: _Values) -> News:
    if isinstance(values, str):
        return f"{cell.label}: {values}"
    for robot, computed in zip(robots, values, strict=True):
        for name in sorted((robot.known.keys() & computed.keys()) - {_TIMED}):
            if not _same(robot.known[name], computed[name]):
                return (
                    f"{cell.name}, seed {seed}, {robot.driven.robot}: {name} is "
                    f"{computed[name]!r}, stored as {robot.known[name]!r}"
                )
    return [
        {name: value for name, value in computed.items() if name not in robot.known}
        for robot, computed in zip(robots, values, strict=True)
    ]


def _same(one: float, other: float) -> bool:
    return one == other or (math.isnan(one) and math.isnan(other))
