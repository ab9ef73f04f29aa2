"""Replay: what happened, as rows of an observation and the action taken in it.

Rows are kept in lanes, one per environment, in the order of time. An episode of T steps takes
T + 1 rows; the last holds the final observation and no action and is marked ``final``. Maps stay
bit-packed, 2.3 kB per row. With a folder the arrays are files, mapped into memory: the replay
survives the process, and several processes may have it open, some of which append to lanes of their
own while another one samples.
"""

from __future__ import annotations

import os
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from crowdbench_agents.learning.batch import Batch
from crowdbench_agents.learning.detour import FREE, Detour
from crowdbench_agents.learning.inputs import Inputs, Sensed
from crowdbench_agents.learning.lanes import Outcomes
from crowdbench_agents.learning.shared import FileLock
from numpy.typing import NDArray
from torch import Tensor

from crowdbench.messages import short

NOBODY, PLANNER, EXPERT = 0, 1, 2
"""Whose a reference action is."""


class Rows(NamedTuple):
    """One row of each of N lanes; see Batch.

    ``reward`` is without the social term ``social``; ``source`` says whose the reference is.
    """

    map: NDArray[np.uint8]
    velocity: NDArray[np.float32]
    goal: NDArray[np.float32]
    action: NDArray[np.float32]
    reward: NDArray[np.float32]
    social: NDArray[np.float32]
    end: NDArray[np.bool_]
    collision: NDArray[np.bool_]
    final: NDArray[np.bool_]
    reference: NDArray[np.float32]
    source: NDArray[np.uint8]


class ReplayError(RuntimeError):
    """A replay that cannot be made or used; the message says why."""


class Replay:
    """Lanes of rows in a ring.

    Args:
        lanes: environments.
        rows: rows per lane; the oldest are overwritten.
        cells: cells along each side of the maps.
        social: whether sampled rewards include the social term.
        detour: whose price is taken off sampled rewards.
        folder: where the arrays live; None keeps them in memory. Existing ones are continued.
    """

    def __init__(
        self,
        lanes: int,
        rows: int,
        cells: int,
        social: bool = True,
        detour: Detour = FREE,
        folder: Path | None = None,
    ) -> None:
        self._social, self._detour = social, detour
        self.lanes, self.rows = lanes, rows
        shapes = {
            "map": ((cells, cells), np.uint8), "velocity": ((2,), np.float32),
            "goal": ((2,), np.float32), "action": ((2,), np.float32), "reward": ((), np.float32),
            "social": ((), np.float32),
            "end": ((), np.bool_), "collision": ((), np.bool_), "final": ((), np.bool_),
            "reference": ((2,), np.float32), "source": ((), np.uint8),
        }  # fmt: skip
        self._lock: AbstractContextManager[None] = nullcontext()
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            self._lock = FileLock(folder / "lock")
        with self._lock:  # two processes may make it at the same time
            self._data = Rows(
                **{
                    name: _array(folder, name, (lanes, rows, *shape), dtype)
                    for name, (shape, dtype) in shapes.items()
                }
            )
            self._written = _array(folder, "written", (lanes,), np.int64)

    def __len__(self) -> int:
        """Rows kept."""
        return int(self.lengths().sum())

    def lengths(self) -> NDArray[np.int64]:
        """(lanes,) rows kept per lane."""
        return np.minimum(self._written, self.rows)

    def append(self, lanes: NDArray[np.integer], rows: Rows) -> None:
        """Add one row to each of the given lanes (N,)."""
        with self._lock:
            at = self._written[lanes] % self.rows
            for name in Rows._fields:
                getattr(self._data, name)[lanes, at] = getattr(rows, name)
            self._written[lanes] += 1

    def append_step(
        self,
        lanes: NDArray[np.integer],
        before: Sensed,
        action: NDArray[np.float32],
        result: Outcomes,
        reference: NDArray[np.float32],
        source: NDArray[np.uint8],
        after: Sensed,
    ) -> None:
        """Add one step of some lanes, and the final observation of each episode that it ended.

        Args:
            lanes: (N,) which they are.
            before, after: their observations.
            action: (N, 2) executed, in [-1, 1].
            result: what it did.
            reference, source: as in ``Rows``.
        """
        collision, final = result.outcome == "collision", np.zeros(len(lanes), bool)
        rows = Rows(
            before.map, before.velocity, before.goal, action, result.reward, result.social,
            result.end, collision, final, reference, source,
        )  # fmt: skip
        self.append(lanes, rows)
        over = np.flatnonzero(result.over)
        last = final_rows(after.map[over], after.velocity[over], after.goal[over])
        self.append(lanes[over], last)

    def mark_episode_ends(self, lanes: NDArray[np.integer]) -> None:
        """Mark the newest row of some lanes (N,) as final: what follows is another episode."""
        with self._lock:
            begun = lanes[self._written[lanes] > 0]
            self._data.final[begun, (self._written[begun] - 1) % self.rows] = True

    def draw_observations(
        self, lanes: NDArray[np.integer], count: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.integer], Sensed]:
        """Draw single observations in which something was done that no expert has labelled.

        Args:
            lanes: (N,) to draw from.
            count: how many at most; others that are drawn are left out.
            rng: of all draws.

        Returns:
            (M, 2) which they are, by lane and number of the row, and the observations.
        """
        lengths = self.lengths()
        lane = rng.choice(lanes[lengths[lanes] > 0], size=count)
        number = self._written[lane] - 1 - rng.integers(lengths[lane])
        data, at = self._data, (lane, number % self.rows)
        wanted = ~data.final[at] & (data.source[at] != EXPERT)
        lane, number = lane[wanted], number[wanted]
        at = lane, number % self.rows
        return np.stack([lane, number], axis=-1), Sensed(
            data.map[at], data.velocity[at], data.goal[at]
        )

    def replace_references(
        self, which: NDArray[np.integer], reference: NDArray[np.float32], source: int
    ) -> None:
        """Give observations drawn before another reference, where they are still there.

        Args:
            which: (M, 2) as from ``draw_observations``.
            reference: (M, 2) actions in [-1, 1].
            source: whose they are.
        """
        with self._lock:
            lane, number = which.T
            kept = number >= self._written[lane] - self.rows
            at = lane[kept], number[kept] % self.rows
            self._data.reference[at], self._data.source[at] = reference[kept], source

    def sample(
        self,
        count: int,
        horizon: int,
        rng: np.random.Generator,
        collision_share: float = 0.0,
        reflect: bool = False,
    ) -> Batch:
        """Draw sequences of ``horizon`` steps.

        Args:
            count: sequences.
            horizon: H.
            rng: of all draws.
            collision_share: share of the sequences that end in a collision within H steps.
            reflect: mirror each sequence with probability one half.

        Raises:
            ReplayError: fewer rows than one sequence needs.
        """
        with self._lock:
            return self._sample(count, horizon, rng, collision_share, reflect)

    def _sample(
        self,
        count: int,
        horizon: int,
        rng: np.random.Generator,
        collision_share: float,
        reflect: bool,
    ) -> Batch:
        starts = np.maximum(self.lengths() - horizon, 0)
        if starts.sum() == 0:
            raise ReplayError(f"no lane has the {horizon + 1} rows that a sequence needs")
        bounds = np.cumsum(starts)
        oldest = np.where(self._written > self.rows, self._written, 0)
        lane, row = np.empty(0, np.int64), np.empty(0, np.int64)
        while len(lane) < count:
            chosen = rng.integers(bounds[-1], size=2 * count)
            lanes = np.searchsorted(bounds, chosen, side="right")
            rows = (oldest[lanes] + chosen - (bounds - starts)[lanes]) % self.rows
            acted = ~self._data.final[lanes, rows]  # a final row has no action
            lane, row = np.append(lane, lanes[acted]), np.append(row, rows[acted])
        lane, row = lane[:count], row[:count]
        special = round(collision_share * count)
        if special:
            lanes, ends = np.nonzero(self._data.collision & (starts > 0)[:, None])
            if len(lanes):
                pick = rng.integers(len(lanes), size=special)
                lane[:special] = lanes[pick]
                row[:special] = ends[pick] - rng.integers(horizon, size=special)
                self._keep_to_written(lane[:special], row[:special], horizon)
        return self._gather(lane, row, horizon, reflect * (rng.random(count) < 0.5))

    def _keep_to_written(self, lane: NDArray[Any], row: NDArray[Any], horizon: int) -> None:
        """Move starts (in place) so that no sequence crosses the ring's seam."""
        written = self._written[lane]
        oldest = np.where(written > self.rows, written, 0)
        kept = np.minimum(written, self.rows)
        offset = np.clip((row - oldest) % self.rows, 0, kept - horizon - 1)
        row[:] = (oldest + offset) % self.rows

    def _gather(
        self, lane: NDArray[Any], row: NDArray[Any], horizon: int, mirrored: NDArray[Any]
    ) -> Batch:
        data = self._data
        steps = (row + np.arange(horizon + 1)[:, None]) % self.rows
        actions = steps[:-1]
        # Behind a final row nothing counts.
        valid = ~np.logical_or.accumulate(data.final[lane, actions], axis=0)
        maps = data.map[lane, steps]
        flip = np.flatnonzero(mirrored)
        maps[:, flip] = maps[:, flip, :, ::-1]
        sign = np.ones((len(lane), 2), np.float32)
        sign[flip, 1] = -1

        reward = data.reward[lane, actions]
        if self._social:
            reward = reward + data.social[lane, actions]
        velocity, goal = data.velocity[lane, steps] * sign, data.goal[lane, steps] * sign
        reward = reward - self._detour.price(velocity, goal)

        def tensor(array: NDArray[Any]) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(array))

        def numbers(array: NDArray[Any]) -> Tensor:
            return tensor(array.astype(np.float32))

        return Batch(
            inputs=Inputs(
                tensor(maps),
                tensor(velocity),
                tensor(goal),
            ),
            action=tensor(data.action[lane, actions] * sign),
            reward=tensor(reward),
            end=numbers(data.end[lane, actions]),
            collision=numbers(data.collision[lane, actions]),
            valid=numbers(valid),
            reference=tensor(data.reference[lane, actions] * sign),
            planned=numbers((data.source[lane, actions] == PLANNER) & valid),
            labelled=numbers((data.source[lane, actions] == EXPERT) & valid),
        )


def final_rows(maps: np.ndarray, velocity: np.ndarray, goal: np.ndarray) -> Rows:
    """The last rows of N episodes: observations only."""
    n = len(maps)
    no, zero, blank = np.zeros(n, bool), np.zeros(n, np.float32), np.zeros((n, 2), np.float32)
    nobody = np.full(n, NOBODY, np.uint8)
    return Rows(maps, velocity, goal, blank, zero, zero, no, no, ~no, blank, nobody)


def _array(folder: Path | None, name: str, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    if folder is None:
        return np.zeros(shape, dtype)
    path = folder / f"{name}.npy"
    if path.is_file():
        try:
            array = np.load(path, mmap_mode="r+")
        except (OSError, ValueError, EOFError) as error:
            raise ReplayError(f"{path}: cannot be read ({short(str(error))})") from error
        if array.shape != shape or array.dtype != dtype:
            raise ReplayError(f"{path}: has shape {array.shape}, this run needs {shape}")
        return array
    try:
        array = np.lib.format.open_memmap(path, mode="w+", dtype=dtype, shape=shape)
        # Reserve the space now: a full disk must be an error here, not a crash hours later.
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise ReplayError(f"{path}: no room for the replay ({error.strerror})") from error
    return array
