"""Expert demonstrations: what an agent that knows more does, recorded once for all learned agents.

The expert drives, and in bursts noise is added to what is driven, so that the data shows how to
recover (cf. Laskey et al., "DART: noise injection for robust imitation learning", 2017) and how
collisions come about. What is kept as the reference to imitate is the action without the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.detour import Detour
from crowdbench_agents.learning.experts import Experts
from crowdbench_agents.learning.lanes import Lanes
from crowdbench_agents.learning.noise import CorrelatedNoise
from crowdbench_agents.learning.replay import EXPERT, Replay
from crowdbench_agents.learning.sampler import TRAINING_SCENARIOS, joint_digest, scenario_digests
from crowdbench_agents.learning.seeds import DEMONSTRATIONS
from numpy.typing import NDArray

import crowdbench

LANES = 8
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


def open_demonstrations(
    folder: Path,
    config: Config,
    robot: crowdbench.RobotSpec,
    social: bool,
    progress: Callable[[int], None],
) -> Replay | None:
    """The demonstrations for a run in ``folder``, where it has some.

    Args:
        folder, config, robot, social: as above.
        progress: called with the number of transitions there are, while some are missing.
    """
    settings = config.training
    if not settings.demonstrations:
        return None
    return load_demonstrations(
        folder.parent, settings.expert, settings.demonstrations, config.perception.geometry, social,
        Detour(settings.detour_price, robot.control_period), progress,
    )  # fmt: skip


def load_demonstrations(
    runs: Path,
    expert: str,
    transitions: int,
    geometry: crowdbench.MapGeometry,
    social: bool,
    detour: Detour,
    progress: Callable[[int], None],
) -> Replay:
    """Open the demonstrations, recording what is missing of them.

    Args:
        runs: the folder of all runs, in which they are kept by expert, number and digest of the
            scenarios they show; a recording that was interrupted goes on.
        expert: name of an agent.
        transitions: how many.
        geometry: of the obstacle maps.
        social, detour: what the sampled rewards are made of, as in ``Replay``.
        progress: called with the number of transitions there are, while some are missing.
    """
    # An episode that has begun is driven to its end, which takes some more rows.
    digest = joint_digest(scenario_digests(TRAINING_SCENARIOS))
    folder = runs / f"demonstrations-{expert}-{transitions}-{digest}"
    rows = -(-transitions // LANES) + 400
    replay = Replay(LANES, rows, geometry.cells, social, detour, folder)
    if len(replay) < transitions:
        replay.mark_episode_ends(np.arange(LANES))
        _record(replay, expert, transitions, geometry, progress)
    return replay


def _record(
    replay: Replay,
    expert: str,
    transitions: int,
    geometry: crowdbench.MapGeometry,
    progress: Callable[[int], None],
) -> None:
    begun = len(replay)
    rng = np.random.default_rng([DEMONSTRATIONS[0], begun])
    envs = Lanes(LANES, list(TRAINING_SCENARIOS), _episodes(begun), geometry)
    everywhere = np.arange(LANES)
    experts = Experts(expert, envs, everywhere)
    noise = CorrelatedNoise((LANES, 2), NOISE, NOISE_CORRELATION, rng)
    noisy, age = np.zeros(LANES, bool), np.zeros(LANES, np.int64)
    source = np.full(LANES, EXPERT, np.uint8)

    def begin(which: NDArray[np.integer]) -> None:
        envs.begin(which)
        experts.begin(which)
        age[which] = rng.integers(BURST, size=len(which))
        noisy[which] = False

    begin(everywhere)
    progress(begun)
    while len(replay) < transitions:
        reference = experts.labels()
        added = noise.step()
        noisy = np.where(age % BURST == 0, rng.random(LANES) < 0.4, noisy)
        action = np.clip(reference + added * noisy[:, None], -1, 1).astype(np.float32)
        before = envs.sensed
        result = envs.step(envs.bounds.physical(action))
        replay.append_step(everywhere, before, action, result, reference, source, envs.sensed)
        age += 1
        begin(np.flatnonzero(result.over))
        progress(len(replay))
    replay.mark_episode_ends(everywhere)


def _episodes(begun: int) -> Iterator[tuple[str, int]]:
    """Episodes in turn, each scenario as often as its share says."""
    turn = [name for name, share in TRAINING_SCENARIOS.items() for _ in range(share)]
    np.random.default_rng(0).shuffle(turn)
    number = 0
    while True:
        yield turn[number % len(turn)], DEMONSTRATIONS[begun + number]
        number += 1
