"""Stored episodes to be seen again, local or published: simulated from seed and commands."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crowdbench.evaluation.apart import apart
from crowdbench.evaluation.driven import Driven, ResimulationError, simulate
from crowdbench.evaluation.episode import Episode
from crowdbench.evaluation.joined import PUBLISHED, cells_of
from crowdbench.evaluation.record import Commands, load_commands
from crowdbench.evaluation.results import Cell, ResultsError, load_driven
from crowdbench.evaluation.stored import defined_scenario, find_scenario, replayable_seeds
from crowdbench.scenario import Scenario

if TYPE_CHECKING:
    import pandas as pd

    from crowdbench.simulation.env import CrowdEnv


@dataclass(frozen=True)
class Recording:
    """The stored episodes of one agent in one scenario that can be seen again.

    Attributes:
        cell: whose episodes they are.
        scenario: its definition.
        sources: where each seed's episode is from, in order: "published" or a results folder.
        load: gives what the robots did with a seed.
    """

    cell: Cell
    scenario: Scenario
    sources: Mapping[int, str]
    load: Callable[[int], list[Driven]] = field(repr=False)

    @property
    def seeds(self) -> tuple[int, ...]:
        """The episodes to show."""
        return tuple(self.sources)

    def episodes(
        self,
        seed: int,
        env: CrowdEnv | None = None,
        on_step: Callable[[CrowdEnv], None] | None = None,
    ) -> list[Episode]:
        """What happened with a seed, one log per robot, simulated again.

        Without an environment or anybody to watch, that is done in a process apart.

        Args:
            seed: one of ``seeds``.
            env: of the same scenario, to use again.
            on_step: called after the reset and after every step.

        Raises:
            ResultsError: the commands cannot be read, or are not those of this episode.
        """
        try:
            again = partial(simulate, label=self.cell.agent)
            if env is None and on_step is None:
                return apart(again, self.scenario, seed, self.load(seed))
            return again(env or self.scenario, seed, self.load(seed), on_step=on_step)
        except ResimulationError as error:
            raise ResultsError(f"{self.sources[seed]}: {error}") from error


def find_recordings(rows: pd.DataFrame, at_most: int | None = None) -> list[Recording]:
    """Those of some episodes that can be seen again.

    Args:
        rows: as ``published_and_local`` gives them, or a part.
        at_most: episodes of each scenario and agent, the lowest seeds.

    Returns:
        One for each scenario and agent of which the commands of an episode are stored.

    Raises:
        ResultsError: something cannot be read.
    """
    groups = rows.groupby(["scenario", "agent"], sort=False).indices
    found = (
        _recording(cell, rows.iloc[groups[key]], at_most) for key, cell in cells_of(rows).items()
    )
    return [recording for recording in found if recording is not None]


def scenario_of(cell: Cell, rows: pd.DataFrame) -> Scenario | None:
    """The scenario of the rows of a cell, as it was; None if that is not known any more."""
    for source in set(rows["source"]) - {PUBLISHED}:
        found = find_scenario(Path(source), cell)
        if found is not None:
            return found
    return defined_scenario(cell.scenario, cell.scenario_digest, definition="")


def published_driven(
    rows: Iterable[Mapping[Hashable, Any]], commands: Commands, seed: int
) -> list[Driven]:
    """What the robots of a published episode did, in their order; those with commands only.

    Args:
        rows: the episode's.
        commands: of the cell.
        seed: of the episode.

    Returns:
        With the row's mean time wherever a step's was not noted.
    """
    told, times = commands.of(seed), commands.times(seed)
    known = {str(row["robot"]): row for row in rows}
    return [
        Driven(
            robot,
            told[robot],
            np.where(np.isfinite(times[robot]), times[robot], known[robot]["inference_s"]),
            str(known[robot]["outcome"]),
            str(known[robot]["error"]) or None,
            json.loads(known[robot]["diagnostics"]),
        )
        for robot in sorted(known.keys() & told.keys(), key=lambda name: (len(name), name))
    ]


def _recording(cell: Cell, rows: pd.DataFrame, at_most: int | None) -> Recording | None:
    """What can be seen again of the rows of a cell; None if that is nothing."""
    published = rows["source"] == PUBLISHED
    kept = dict.fromkeys(set(rows.loc[published, "seed"]), PUBLISHED)
    there = load_commands(cell).seeds if kept else set()
    kept = {seed: source for seed, source in kept.items() if seed in there}
    for source, part in rows[~published].groupby("source"):
        there = {*replayable_seeds(Path(str(source)), cell)}
        kept |= {seed: str(source) for seed in there & {*part["seed"]}}
    scenario = scenario_of(cell, rows)
    seeds = tuple(sorted(int(seed) for seed in kept))[:at_most]
    if scenario is None or not seeds:
        return None
    # A page has recordings of every cell, so none of them holds on to all there is of its cell.
    shown = rows[rows["seed"].isin(seeds)]

    def load(seed: int) -> list[Driven]:
        if kept[seed] != PUBLISHED:
            return load_driven(kept[seed], cell, seed) or []
        return published_driven(
            shown[shown["seed"] == seed].to_dict("records"), load_commands(cell), seed
        )

    return Recording(cell, scenario, {seed: kept[seed] for seed in seeds}, load)
