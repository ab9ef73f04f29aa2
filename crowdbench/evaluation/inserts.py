"""Episodes into the database: cells, rows, metrics and commands."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING

from crowdbench.evaluation.database import CELL_IS
from crowdbench.evaluation.driven import packed
from crowdbench.evaluation.measured import definitions, metric_set, write_metrics
from crowdbench.scenario import Scenario

if TYPE_CHECKING:
    from crowdbench.evaluation.results import Cell, Result


def cell_number(connection: sqlite3.Connection, cell: Cell, scenario: Scenario | None) -> int:
    """The number of a cell, which is added where it is new."""
    definition = scenario.model_dump_json() if scenario else ""
    connection.execute(
        """
        INSERT INTO cells (scenario, scenario_digest, agent, weights_sha256, code, series,
            options, definition) VALUES (?, ?, ?, ?, ?, ?, ?, ?)
        ON CONFLICT DO UPDATE SET definition = excluded.definition WHERE definition = ''""",
        (*cell.identity, cell.options, definition),
    )
    found = connection.execute(f"SELECT id FROM cells {CELL_IS}", cell.identity)
    number: int = found.fetchone()[0]
    return number


def forget_error(connection: sqlite3.Connection, cell: int, seed: int) -> None:
    """Remove all robots of an episode in which one of them had an agent error."""
    rows = connection.execute(
        "SELECT id, outcome FROM episodes WHERE cell = ? AND seed = ?", (cell, seed)
    ).fetchall()
    if any(outcome == "agent_error" for _, outcome in rows):
        numbers = [(number,) for number, _ in rows]
        for table, key in (("actions", "episode"), ("metrics", "episode"), ("episodes", "id")):
            connection.executemany(f"DELETE FROM {table} WHERE {key} = ?", numbers)


def insert(connection: sqlite3.Connection, cell: int, result: Result) -> int:
    """Add an episode; 0 if it is there, else 1."""
    facts = {
        "cell": cell,
        "seed": result.seed,
        "robot": result.robot,
        "outcome": result.outcome,
        "steps": result.steps,
        "error": result.error,
        "diagnostics": counters(result.diagnostics),
        **asdict(result.origin),
        "metric_set": metric_set(connection, definitions(result.metrics)),
    }
    marks = ", ".join("?" * len(facts))
    added = connection.execute(
        f"INSERT INTO episodes ({', '.join(facts)}) VALUES ({marks}) ON CONFLICT DO NOTHING",
        tuple(facts.values()),
    )
    if not added.rowcount:
        return 0
    episode = added.lastrowid
    connection.execute("INSERT INTO metrics (episode) VALUES (?)", (episode,))
    write_metrics(connection, episode, result.metrics)
    if result.commands is not None and result.inference_s is not None:
        connection.execute(
            "INSERT INTO actions (episode, commands, inference_s) VALUES (?, ?, ?)",
            (episode, *packed(result.commands, result.inference_s)),
        )
    return 1


def counters(diagnostics: Mapping[str, float]) -> str:
    """An agent's counters as text."""
    return json.dumps(dict(diagnostics), sort_keys=True)
