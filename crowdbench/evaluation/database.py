"""The database of local results: one SQLite file with a schema, opened to read or to write.

Writers take turns (write-ahead log, one immediate transaction each) and readers see what is
committed, so any number of processes of one machine may work on one file, and a kill at any
moment loses what was not committed and nothing else.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
import tempfile
from collections.abc import Iterator
from pathlib import Path

FILE = "results.sqlite"
SCHEMA = 1
"""Version of the schema below, in ``PRAGMA user_version``."""
PATIENCE = 60.0
"""How long a writer waits for its turn [s]."""
_APPLICATION = 0x43524244  # "CRBD", tells the file from other databases
_PROBE = bytes(1 << 16)

_TABLES = f"""
CREATE TABLE cells (
    id INTEGER PRIMARY KEY,
    scenario TEXT NOT NULL,
    scenario_digest TEXT NOT NULL,
    agent TEXT NOT NULL,
    options TEXT NOT NULL,
    weights_sha256 TEXT NOT NULL,
    code TEXT NOT NULL,
    series TEXT NOT NULL,       -- version of the world
    definition TEXT NOT NULL,   -- the scenario as JSON, empty if it is not known
    UNIQUE (scenario, scenario_digest, agent, weights_sha256, code, series)
) STRICT;
CREATE TABLE metric_sets (      -- with which metrics an episode was measured, as JSON:
    id INTEGER PRIMARY KEY,     -- their definitions by name
    definitions TEXT NOT NULL UNIQUE
) STRICT;
CREATE TABLE episodes (         -- one row per robot
    id INTEGER PRIMARY KEY,
    cell INTEGER NOT NULL REFERENCES cells,
    seed INTEGER NOT NULL CHECK (seed >= 0),
    robot TEXT NOT NULL,
    outcome TEXT NOT NULL CHECK (outcome IN ('success', 'collision', 'timeout', 'agent_error')),
    steps INTEGER NOT NULL CHECK (steps >= 0),
    error TEXT NOT NULL,
    diagnostics TEXT NOT NULL,  -- JSON
    machine TEXT NOT NULL,
    architecture TEXT NOT NULL,
    version TEXT NOT NULL,      -- of crowdbench
    pymunk TEXT NOT NULL,
    numpy TEXT NOT NULL,
    torch TEXT NOT NULL,
    timestamp TEXT NOT NULL,    -- UTC
    metric_set INTEGER NOT NULL REFERENCES metric_sets,
    UNIQUE (cell, seed, robot)
) STRICT;
CREATE TABLE metrics (          -- one column per metric; NULL where it is not defined
    episode INTEGER PRIMARY KEY REFERENCES episodes
) STRICT;
CREATE TABLE actions (
    episode INTEGER PRIMARY KEY REFERENCES episodes,
    commands BLOB NOT NULL,     -- (T, 2) little-endian float64, zlib
    inference_s BLOB NOT NULL   -- (T,) little-endian float32
) STRICT;
PRAGMA application_id = {_APPLICATION};
PRAGMA user_version = {SCHEMA};
"""

CELL_IS = """
    WHERE (scenario, scenario_digest, agent, weights_sha256, code, series) = (?, ?, ?, ?, ?, ?)"""
"""Of a query for one cell, given ``Cell.identity``."""


class ResultsError(RuntimeError):
    """Results that cannot be read or written; the message names the path and the reason."""


@contextlib.contextmanager
def reported(path: Path) -> Iterator[None]:
    """Turn whatever SQLite and the operating system refuse into a line that names the file."""
    try:
        yield
    except sqlite3.Error as error:
        raise ResultsError(f"{path}: {_reason(error)}") from error
    except OSError as error:
        raise ResultsError(f"{path}: cannot be opened ({error.strerror or error})") from error
    except (UnicodeError, OverflowError) as error:
        raise ResultsError(f"{path}: cannot hold this ({error})") from error


class Writer(sqlite3.Connection):
    """A connection that knows which file it writes to."""

    path: Path
    file: tuple[int, int]

    def require_its_file(self) -> None:
        """Make sure that what was written is where it will be looked for.

        A file that is removed or moved can be written to without an error as long as it is open.

        Raises:
            ResultsError: another file or none is in its place.
        """
        try:
            there = _file(self.path)
        except FileNotFoundError:
            there = None
        if there != self.file:
            raise ResultsError(
                f"{self.path}: was removed, moved or replaced while it was in use; what was "
                "stored last is not in it, and the same command runs that again"
            )


def open_for_writing(folder: Path) -> Writer:
    """Open the database of a folder, both made if need be.

    Raises:
        ResultsError: the folder cannot be made, or the file is not one that can be written.
    """
    path = folder / FILE
    with reported(path):
        folder.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            _create(path)
        _require_file(path)
        connection = sqlite3.connect(path, PATIENCE, isolation_level=None, factory=Writer)
        try:
            connection.path, connection.file = path, _file(path)
            _check(connection, path)
            # A crash of the machine may cost the last episodes, never the file.
            connection.execute("PRAGMA synchronous = NORMAL")
        except BaseException:
            connection.close()
            raise
    return connection


@contextlib.contextmanager
def opened_for_reading(folder: Path) -> Iterator[sqlite3.Connection | None]:
    """Open the database of a folder; None if there is none. Errors are reported.

    Raises:
        ResultsError: not a database of crowdbench's, damaged, or of a newer schema.
    """
    path = folder / FILE
    with reported(path):
        if not path.exists():
            yield None
            return
        _require_file(path)
        with contextlib.closing(_readable(path)) as connection:
            yield connection


@contextlib.contextmanager
def transaction(connection: Writer) -> Iterator[None]:
    """All or nothing, and nobody else writes meanwhile.

    Raises:
        ResultsError: the file is no longer where it was.
    """
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        connection.rollback()
        raise
    connection.require_its_file()


def require_writable(folder: Path) -> list[Path]:
    """Find out before hours are spent whether results can be stored in a folder.

    Returns:
        The folders that were made for it, the innermost first.

    Raises:
        ResultsError: the folder cannot be made or written to, its disk is full, or the database
            in it is locked, damaged or not crowdbench's.
    """
    try:
        new = [path for path in (folder, *folder.parents) if not path.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(_PROBE)
            probe.flush()
            os.fsync(probe.fileno())
    except OSError as error:
        reason = error.strerror or str(error)
        raise ResultsError(f"{folder}: results cannot be written here ({reason})") from error
    path = folder / FILE
    if path.exists():
        with contextlib.closing(open_for_writing(folder)) as connection, reported(path):
            connection.execute("BEGIN IMMEDIATE")
            connection.execute(f"PRAGMA user_version = {SCHEMA}")  # finds a read-only file out
            connection.rollback()
    return new


@contextlib.contextmanager
def used(folder: Path) -> Iterator[None]:
    """A folder to store results in, see ``require_writable``; none is left where none are stored.

    Raises:
        ResultsError: results cannot be stored there.
    """
    new = require_writable(folder)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):  # in use
            for path in new:
                path.rmdir()


def _require_file(path: Path) -> None:
    if not path.is_file():
        raise ResultsError(
            f"{path}: not a file (a folder, pipe or device); move it away or choose another folder "
            "with --results"
        )


def _file(path: Path) -> tuple[int, int]:
    """What tells a file from every other one."""
    status = path.stat()
    return status.st_dev, status.st_ino


def _create(path: Path) -> None:
    """Make an empty database: whole or not at all, and one only if several do so at once."""
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".new-") as folder:
        made = Path(folder) / FILE
        with contextlib.closing(sqlite3.connect(made, isolation_level=None)) as connection:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.executescript(_TABLES)
        with contextlib.suppress(FileExistsError):
            path.hardlink_to(made)


def _readable(path: Path) -> sqlite3.Connection:
    address = path.resolve().as_uri() + "?mode=rw"
    try:
        return _checked(address, path)
    except sqlite3.OperationalError:
        # Where nothing can be written there is no index of the log; without a log none is needed.
        log = path.with_name(FILE + "-wal")
        if log.exists() and log.stat().st_size:
            raise
        return _checked(address + "&immutable=1", path)


def _checked(address: str, path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(address, uri=True, timeout=PATIENCE, isolation_level=None)
    try:
        connection.execute("PRAGMA query_only = ON")
        _check(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


def _check(connection: sqlite3.Connection, path: Path) -> None:
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (schema,) = connection.execute("PRAGMA user_version").fetchone()
    if application != _APPLICATION:
        raise ResultsError(
            f"{path}: not a database of crowdbench's; move it away or choose another folder with "
            "--results"
        )
    if schema > SCHEMA:
        raise ResultsError(
            f"{path}: written by a newer crowdbench (schema {schema}; this one knows {SCHEMA}); "
            "update crowdbench or choose another folder with --results"
        )


def _reason(error: sqlite3.Error) -> str:
    code = getattr(error, "sqlite_errorcode", None)
    if code is None:
        return str(error)
    primary = code & 0xFF
    if primary in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return f"another process has locked it for {PATIENCE:g} s; end that one or try again"
    if primary == sqlite3.SQLITE_NOTADB:
        return "not a database; move it away or choose another folder with --results"
    if primary == sqlite3.SQLITE_CORRUPT:
        return (
            f"damaged ({error}); the command sqlite3 with .recover saves what can be read, and "
            "another folder with --results goes on"
        )
    if primary == sqlite3.SQLITE_FULL:
        return "cannot be written (no space left on the disk); what was stored before is kept"
    if primary in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM):
        return f"cannot be written or opened ({error})"
    return str(error)
