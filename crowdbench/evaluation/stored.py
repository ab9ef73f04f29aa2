"""Stored episodes to be seen again: which there are, of which scenario, and what happened."""

from __future__ import annotations

import warnings
from pathlib import Path

from pydantic import ValidationError

from crowdbench.evaluation.database import CELL_IS, opened_for_reading
from crowdbench.evaluation.driven import simulate
from crowdbench.evaluation.episode import Episode
from crowdbench.evaluation.results import Cell, latest_cells, load_driven
from crowdbench.messages import explain
from crowdbench.scenario import Scenario, ScenarioError, load_scenario


def find_cells(folder: Path, scenario: str | None = None, agent: str | None = None) -> list[Cell]:
    """The cells that ``load_results`` gives rows of, in the order of their latest episodes."""
    with opened_for_reading(folder) as connection:
        if connection is None:
            return []
        query = """
            SELECT scenario, scenario_digest, agent, options, series, weights_sha256, code
            FROM cells WHERE id = ?"""
        return [
            Cell(*connection.execute(query, (number,)).fetchone())
            for number, label, name in latest_cells(connection)
            if scenario in (None, label) and agent in (None, name)
        ]


def find_scenario(folder: Path, cell: Cell) -> Scenario | None:
    """The scenario of a cell, as it was; None if that is not known any more.

    Warns where it is known, but cannot be made, as of a recording that is gone.
    """
    definition = ""
    with opened_for_reading(folder) as connection:
        if connection is not None:
            query = f"SELECT definition FROM cells {CELL_IS}"
            definition = (connection.execute(query, cell.identity).fetchone() or [""])[0]
    try:
        return defined_scenario(cell.scenario, cell.scenario_digest, definition)
    except ScenarioError as error:
        warnings.warn(str(error), stacklevel=2)
        return None


def defined_scenario(label: str, digest: str, definition: str) -> Scenario | None:
    """The scenario with a digest, from its JSON or else by its name; None if it is neither.

    Raises:
        ScenarioError: it cannot be made of its JSON; the message says why.
    """
    if definition:
        try:
            found = Scenario.model_validate_json(definition)
        except ValidationError as error:
            why = explain(error, Scenario)
            raise ScenarioError(f"scenario {label!r} cannot be made again: {why}") from error
    else:
        try:
            found = load_scenario(label)
        except ScenarioError:
            return None
    return found if found.digest == digest else None


def replayable_seeds(folder: Path, cell: Cell) -> list[int]:
    """The seeds of a cell whose commands are stored."""
    with opened_for_reading(folder) as connection:
        if connection is None:
            return []
        query = f"""
            SELECT DISTINCT seed FROM episodes JOIN cells ON cell = cells.id
            JOIN actions ON episode = episodes.id {CELL_IS} ORDER BY seed"""
        return [seed for (seed,) in connection.execute(query, cell.identity)]


def load_episodes(folder: Path, cell: Cell, scenario: Scenario, seed: int) -> list[Episode] | None:
    """A stored episode, simulated again, one log per robot; None if its commands are not stored.

    Raises:
        ResultsError: it cannot be read.
        ResimulationError: this is not what happens in this scenario.
    """
    driven = load_driven(folder, cell, seed)
    return None if driven is None else simulate(scenario, seed, driven, label=cell.agent)
