"""Demonstrations: episodes of the privileged ``informed`` agent, the same for all learned agents.

Its actions are made smooth before they are driven, because it re-plans from scratch at each step,
and in bursts noise is added to what is driven, so that the data shows how to recover (cf. Laskey
et al., "DART: noise injection for robust imitation learning", 2017) and how collisions come about.
What is kept as the reference to imitate is the action without the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from crowdbench_agents.latent_planner.crowds import Crowds, worlds_digest
from crowdbench_agents.latent_planner.replay import Replay, Rows
from crowdbench_agents.perception import MapGeometry

import crowdbench

FIRST_SEED = 1_000_000
TEACHER = "informed"
FOLLOW = np.array([0.7, 0.5])
"""Share of a change of (v, w) that is made at each step."""
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


def load_demonstrations(
    runs: Path,
    transitions: int,
    geometry: MapGeometry,
    social: bool,
    progress: Callable[[int], None] = lambda done: None,
) -> Replay:
    """Open the demonstrations, recording what is missing of them.

    Args:
        runs: the folder of all runs, in which they are kept by number and by the scenarios they
            show; a recording that was interrupted goes on.
        transitions: how many.
        geometry: of the obstacle maps.
        social: whether the rewards include the social term.
        progress: called with the number of transitions there are.
    """
    # An episode that has begun is driven to its end, which takes some more rows.
    folder = runs / f"demonstrations-{transitions}-{worlds_digest()}"
    rows = -(-transitions // LANES) + 400
    replay = Replay(LANES, rows, geometry.cells, social=social, folder=folder)
    if len(replay) < transitions:
        replay.cut()
        _record(replay, transitions, geometry, progress)
    return replay


def _record(
    replay: Replay, transitions: int, geometry: MapGeometry, progress: Callable[[int], None]
) -> None:
    begun = len(replay)
    rng = np.random.default_rng([FIRST_SEED, begun])
    crowds = Crowds(LANES, _episodes(begun), geometry)
    teachers = [crowdbench.AgentSpec.parse(TEACHER).make() for _ in range(LANES)]
    everywhere = np.arange(LANES)
    last = np.zeros((LANES, 2))
    noise, noisy = np.zeros((LANES, 2)), np.zeros(LANES, bool)
    age = np.zeros(LANES, np.int64)

    def begin(which: np.ndarray) -> None:
        crowds.begin(which)
        age[which] = rng.integers(BURST, size=len(which))
        noisy[which], last[which] = False, 0.0
        for index in which:
            teachers[index].reset(crowds.robot, seed=0)

    begin(everywhere)
    while len(replay) < transitions:
        taught = np.array(
            [teachers[i].act(crowds.observation(i, state=True)) for i in everywhere], float
        )
        proposed = last + FOLLOW * (taught - last)
        noise = NOISE_CORRELATION * noise
        noise += np.sqrt(1 - NOISE_CORRELATION**2) * NOISE * rng.normal(size=noise.shape)
        noisy = np.where(age % BURST == 0, rng.random(LANES) < 0.4, noisy)
        reference = crowds.bounds.normalised(proposed)
        action = np.clip(reference + noise * noisy[:, None], -1, 1).astype(np.float32)
        last = crowds.bounds.physical(action)
        before = tuple(x.copy() for x in crowds.sensed)
        result = crowds.step(everywhere, last)
        collided = result.outcome == "collision"
        no, yes = np.zeros(LANES, bool), np.ones(LANES, bool)
        replay.append(
            everywhere,
            Rows(
                *before, action, result.reward, result.social, result.end, collided, no,
                reference.astype(np.float32), yes,
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
    return Rows(maps, velocity, goal, blank, zero, zero, no, no, ~no, blank, no)


def _episodes(begun: int) -> Iterator[tuple[str, int]]:
    """Episodes in turn, each scenario as often as its share says."""
    turn = [name for name, share in SHARES.items() for _ in range(share)]
    np.random.default_rng(0).shuffle(turn)
    number = 0
    while True:
        yield turn[number % len(turn)], FIRST_SEED + begun + number
        number += 1
