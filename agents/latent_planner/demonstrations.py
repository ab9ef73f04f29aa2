"""What a teacher, another agent, would do: demonstrations, and advice where a learner drives.

Both are the same for all learned agents. In demonstrations the teacher drives, and in bursts noise
is added to what is driven, so that the data shows how to recover (cf. Laskey et al., "DART: noise
injection for robust imitation learning", 2017) and how collisions come about. What is kept as the
reference to imitate is the action without the noise. Where a learner drives, the teacher says at
each step what it would do there (cf. Ross et al., "A reduction of imitation learning and
structured prediction to no-regret online learning", 2011).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from crowdbench_agents.latent_planner.config import Config
from crowdbench_agents.latent_planner.crowds import Crowds, worlds_digest
from crowdbench_agents.latent_planner.replay import NOBODY, TEACHER, Detour, Replay, Rows
from crowdbench_agents.perception import MapGeometry
from numpy.typing import NDArray

import crowdbench

FIRST_SEED = 1_000_000
FOLLOW = np.array([0.7, 0.5])
"""Share of the change of (v, w) to what the teacher wants that is made at each step: teachers plan
from scratch at each step and are jerky."""
LANES = 8
BURST = 10  # steps between decisions whether noise is added
NOISE = 0.7  # std of the noise in a burst, actions in [-1, 1]
NOISE_CORRELATION = 0.8
# The share of episodes in each scenario: more where people are fast, blind or many.
SHARES = {
    "unimodal_slow": 1, "unimodal_fast": 2, "multimodal_slow": 1, "multimodal_fast": 2,
    "unimodal_slow_nonreactive": 2, "unimodal_fast_nonreactive": 4,
    "multimodal_slow_nonreactive": 2, "multimodal_fast_nonreactive": 4,
    "corridor_sparse": 1, "corridor_moderate": 1, "corridor_dense": 2, "corridor_very_dense": 3,
}  # fmt: skip


class Teachers:
    """One teacher for each of some environments.

    Args:
        name: of the agent; it may be a privileged one.
        crowds: the environments.
        which: (M,) in which of them there is a teacher.
    """

    def __init__(self, name: str, crowds: Crowds, which: NDArray[np.integer]) -> None:
        self.which, self._crowds = which, crowds
        self._agents = {index: crowdbench.AgentSpec.parse(name).make() for index in which}

    def begin(self, which: NDArray[np.integer]) -> None:
        """Start anew in those environments, of any, whose episodes begin."""
        for index in which:
            if index in self._agents:
                self._agents[index].reset(self._crowds.robot, seed=0)

    def advise(self) -> NDArray[np.float32]:
        """(M, 2) actions in [-1, 1]; to be asked once a step, as teachers may track people."""
        crowds = self._crowds
        wanted = np.array(
            [agent.act(crowds.observation(i, state=True)) for i, agent in self._agents.items()],
            np.float32,
        ).reshape(-1, 2)
        velocity = crowds.sensed.velocity[self.which]
        return crowds.bounds.normalised(velocity + FOLLOW * (wanted - velocity)).astype(np.float32)


def open_replays(
    folder: Path, config: Config, crowds: Crowds, social: bool
) -> tuple[Replay, Replay | None]:
    """The replay of a run in ``folder``, and the demonstrations where it has some."""
    settings, geometry = config.training, config.perception.geometry
    detour = Detour(settings.detour_price, crowds.robot.control_period)
    rows = -(-settings.replay // crowds.count)
    replay = Replay(crowds.count, rows, geometry.cells, social, detour, folder / "replay")
    if not settings.demonstrations:
        return replay, None
    return replay, load_demonstrations(
        folder.parent, settings.teacher, settings.demonstrations, geometry, social, detour
    )


def load_demonstrations(
    runs: Path,
    teacher: str,
    transitions: int,
    geometry: MapGeometry,
    social: bool,
    detour: Detour,
    progress: Callable[[int], None] = lambda done: None,
) -> Replay:
    """Open the demonstrations, recording what is missing of them.

    Args:
        runs: the folder of all runs, in which they are kept by teacher, number and the scenarios
            they show; a recording that was interrupted goes on.
        teacher: name of an agent.
        transitions: how many.
        geometry: of the obstacle maps.
        social, detour: what the sampled rewards are made of, as in ``Replay``.
        progress: called with the number of transitions there are.
    """
    # An episode that has begun is driven to its end, which takes some more rows.
    folder = runs / f"demonstrations-{teacher}-{transitions}-{worlds_digest()}"
    rows = -(-transitions // LANES) + 400
    replay = Replay(LANES, rows, geometry.cells, social, detour, folder)
    if len(replay) < transitions:
        replay.cut()
        _record(replay, teacher, transitions, geometry, progress)
    return replay


def _record(
    replay: Replay,
    teacher: str,
    transitions: int,
    geometry: MapGeometry,
    progress: Callable[[int], None],
) -> None:
    begun = len(replay)
    rng = np.random.default_rng([FIRST_SEED, begun])
    crowds, everywhere = Crowds(LANES, _episodes(begun), geometry), np.arange(LANES)
    teachers = Teachers(teacher, crowds, everywhere)
    noise, noisy = np.zeros((LANES, 2)), np.zeros(LANES, bool)
    age = np.zeros(LANES, np.int64)

    def begin(which: NDArray[np.integer]) -> None:
        crowds.begin(which)
        teachers.begin(which)
        age[which] = rng.integers(BURST, size=len(which))
        noisy[which] = False

    begin(everywhere)
    while len(replay) < transitions:
        reference = teachers.advise()
        noise = NOISE_CORRELATION * noise
        noise += np.sqrt(1 - NOISE_CORRELATION**2) * NOISE * rng.normal(size=noise.shape)
        noisy = np.where(age % BURST == 0, rng.random(LANES) < 0.4, noisy)
        action = np.clip(reference + noise * noisy[:, None], -1, 1).astype(np.float32)
        before = tuple(x.copy() for x in crowds.sensed)
        result = crowds.step(everywhere, crowds.bounds.physical(action))
        collided = result.outcome == "collision"
        no, source = np.zeros(LANES, bool), np.full(LANES, TEACHER, np.uint8)
        replay.append(
            everywhere,
            Rows(
                *before, action, result.reward, result.social, result.end, collided, no,
                reference, source,
            ),
        )  # fmt: skip
        age += 1
        over = np.flatnonzero(result.over)
        if len(over):
            replay.append(over, final_rows(*(x[over] for x in crowds.sensed)))
            begin(over)
        progress(len(replay))
    replay.cut()


def final_rows(maps: np.ndarray, velocity: np.ndarray, goal: np.ndarray) -> Rows:
    """The last rows of N episodes: observations only."""
    n = len(maps)
    no, zero, blank = np.zeros(n, bool), np.zeros(n, np.float32), np.zeros((n, 2), np.float32)
    nobody = np.full(n, NOBODY, np.uint8)
    return Rows(maps, velocity, goal, blank, zero, zero, no, no, ~no, blank, nobody)


def _episodes(begun: int) -> Iterator[tuple[str, int]]:
    """Episodes in turn, each scenario as often as its share says."""
    turn = [name for name, share in SHARES.items() for _ in range(share)]
    np.random.default_rng(0).shuffle(turn)
    number = 0
    while True:
        yield turn[number % len(turn)], FIRST_SEED + begun + number
        number += 1
