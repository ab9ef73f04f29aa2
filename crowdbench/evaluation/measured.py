"""Metrics in the database: a column each, and for every episode what they were said to measure.

The definitions tell a value that is not defined (NULL) from one that was never computed, and a
metric that was redefined since from one that was not.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Mapping

OUTCOMES = ("success", "collision", "timeout", "agent_error")
NOT_COMPUTED = "not_computed"
"""Column of rows: the metrics that they were never measured with, separated by spaces."""


def definitions(names: Iterable[str]) -> dict[str, str]:
    """What metrics are said to measure; empty for those that nothing here computes."""
    from crowdbench.evaluation.metrics import METRICS

    return {name: METRICS[name].definition if name in METRICS else "" for name in names}


def described(text: str) -> dict[str, str]:
    """Definitions by the names of metrics, from their text in the database.

    Raises:
        ValueError: it is something else.
    """
    found = json.loads(text)
    if not isinstance(found, dict) or not all(isinstance(told, str) for told in found.values()):
        raise ValueError("expected definitions by names")
    return found


def lacking(known: Iterable[str]) -> str:
    """What ``NOT_COMPUTED`` says of rows that were measured with the metrics ``known``."""
    from crowdbench.evaluation.metrics import METRICS

    there = set(known)
    return " ".join(name for name in METRICS if name not in there)


def is_proportion(name: str) -> bool:
    """Whether a metric is a yes or a no for each episode."""
    from crowdbench.evaluation.metrics import METRICS

    return name in METRICS and METRICS[name].kind == "proportion"


def metric_set(connection: sqlite3.Connection, described: Mapping[str, str]) -> int:
    """The number of a set of metrics with their definitions."""
    text = json.dumps(dict(described), sort_keys=True)
    connection.execute(
        "INSERT INTO metric_sets (definitions) VALUES (?) ON CONFLICT DO NOTHING", (text,)
    )
    found = connection.execute("SELECT id FROM metric_sets WHERE definitions = ?", (text,))
    number: int = found.fetchone()[0]
    return number


def write_metrics(
    connection: sqlite3.Connection, episode: int | None, values: Mapping[str, float]
) -> None:
    """Write values of an episode; metrics that the file has no column for get one."""
    there = {row[1] for row in connection.execute("PRAGMA table_info(metrics)")}
    for name in values:
        if name not in there:
            connection.execute(f"ALTER TABLE metrics ADD COLUMN {quoted(name)} REAL")
    if values:
        changes = ", ".join(f"{quoted(name)} = ?" for name in values)
        connection.execute(
            f"UPDATE metrics SET {changes} WHERE episode = ?",
            (*(float(value) for value in values.values()), episode),
        )


def quoted(name: str) -> str:
    """A name as SQL has it."""
    return '"' + name.replace('"', '""') + '"'
