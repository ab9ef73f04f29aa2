"""Expert demonstrations: what an agent that knows more does, recorded once for all learned agents.

The expert drives, and in bursts noise is added to what is driven, so that the data shows how to
recover (cf. Laskey et al., "DART: noise injection for robust imitation learning", 2017) and how
collisions come about. What is kept as the reference to imitate is the action without the noise.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.detour import Detour
from crowdbench_agents.learning.experts import Experts
from crowdbench_agents.learning.lanes import Lanes
from crowdbench_agents.learning.noise import CorrelatedNoise
from crowdbench_agents.learning.replay import EXPERT, Replay
from crowdbench_agents.learning.seeds import DEMONSTRATIONS
from crowdbench_agents.learning.shared import FileLock
from crowdbench_agents.learning.worlds import Worlds, digests, joint_digest, robot_of, share
from numpy.typing import NDArray

import crowdbench
from crowdbench.agent import code_version
from crowdbench.simulation import WORLD_VERSION

LANES = 8
LOOK = 1.0  # between looks whether another run has recorded all [s]
BURST = 10  # steps between decisions whether noise is added
NOISE = 0.7  # std of the noise in a burst, actions in [-1, 1]
NOISE_CORRELATION = 0.8


def open_replay(folder: Path, config: Config, robot: crowdbench.RobotSpec, social: bool) -> Replay:
    """The replay of a run in ``folder``; several processes may have it open.

    Args:
        folder: of the run.
        config: all settings.
        robot: that is trained with.
        social: whether sampled rewards include the social term.
    """
    settings = config.training
    detour = Detour(settings.detour_price, robot.control_period)
    count = settings.environments
    rows = -(-settings.replay // count)
    return Replay(count, rows, config.perception.cells, social, detour, folder / "replay")


class Demonstrations(Replay):
    """Demonstrations of all runs in a folder: some for each expert, number, map and scenarios.

    A folder's name tells them apart; what the expert does, its weights, the scenarios and the
    world's version are in its last part as a digest.

    Args:
        runs: the folder of all runs, in which they are kept.
        config: all settings.
        social: whether sampled rewards include the social term.
        worlds: in which the expert drives.
    """

    def __init__(self, runs: Path, config: Config, social: bool, worlds: Worlds) -> None:
        settings = config.training
        self._expert, self._wanted = settings.expert, settings.demonstrations
        self._geometry = config.perception.geometry
        self._worlds = worlds
        digest = _digest(self._expert, worlds)
        seen = config.perception
        map_ = f"{seen.cells}x{seen.size:g}m-{seen.ahead:g}m"
        self._folder = runs / f"demonstrations-{self._expert}-{self._wanted}-{map_}-{digest}"
        # An episode that has begun is driven to its end, which takes some more rows.
        rows = -(-self._wanted // LANES) + 400
        detour = Detour(settings.detour_price, robot_of(worlds).control_period)
        super().__init__(LANES, rows, self._geometry.cells, social, detour, self._folder)

    def record(self, progress: Callable[[int], None], stopping: Callable[[], bool]) -> None:
        """Record what is missing, going on with what was interrupted.

        Where another run is recording, wait for it and take over if it ends before.

        Args:
            progress: called with the number of transitions there are, while some are missing.
            stopping: tells whether to leave it there.
        """
        lock = FileLock(self._folder / "recording")
        while len(self) < self._wanted and not stopping():
            if lock.attempt():
                try:
                    self._record(progress, stopping)
                finally:
                    lock.release()
            else:
                progress(len(self))
                time.sleep(LOOK)

    def _record(self, progress: Callable[[int], None], stopping: Callable[[], bool]) -> None:
        everywhere, begun = np.arange(LANES), len(self)
        self.mark_episode_ends(everywhere)
        rng = np.random.default_rng([DEMONSTRATIONS[0], begun])
        lanes = Lanes(LANES, self._worlds, _episodes(begun, self._worlds), self._geometry)
        experts = Experts(self._expert, lanes, everywhere)
        noise = CorrelatedNoise((LANES, 2), NOISE, NOISE_CORRELATION, rng)
        noisy, age = np.zeros(LANES, bool), np.zeros(LANES, np.int64)
        source = np.full(LANES, EXPERT, np.uint8)

        def begin(which: NDArray[np.integer]) -> None:
            lanes.begin(which)
            experts.begin(which)
            age[which] = rng.integers(BURST, size=len(which))
            noisy[which] = False

        begin(everywhere)
        progress(begun)
        while len(self) < self._wanted and not stopping():
            reference = experts.labels()
            added = noise.step()
            noisy = np.where(age % BURST == 0, rng.random(LANES) < 0.4, noisy)
            action = np.clip(reference + added * noisy[:, None], -1, 1).astype(np.float32)
            before = lanes.sensed
            result = lanes.step(lanes.bounds.physical(action))
            self.append_step(everywhere, before, action, result, reference, source, lanes.sensed)
            age += 1
            begin(np.flatnonzero(result.over))
            progress(len(self))
        self.mark_episode_ends(everywhere)


def _digest(expert: str, worlds: Worlds) -> str:
    """12 hex digits that change whenever the expert, a scenario or the world does."""
    spec = crowdbench.AgentSpec.parse(expert)
    agent = spec.make()
    parts = (
        code_version(spec.name, agent.version),
        agent.weights_sha256,
        WORLD_VERSION,
        joint_digest(list(digests(worlds).values())),
    )
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:12]


def _episodes(begun: int, worlds: Worlds) -> Iterator[tuple[str, int]]:
    """Episodes in turn, each scenario as often as its share says."""
    turn = [name for name in worlds for _ in range(share(name))]
    np.random.default_rng(0).shuffle(turn)
    number = 0
    while True:
        yield turn[number % len(turn)], DEMONSTRATIONS[begun + number]
        number += 1
