"""Files that are none, or cannot be used: one line each, and nothing is lost."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import sqlite3
import tempfile
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from crowdbench.evaluation import database
from crowdbench.evaluation.database import FILE, ResultsError, require_writable
from crowdbench.evaluation.results import Cell, Result, ResultsStore, load_results
from crowdbench.simulation import WORLD_VERSION

CELL = Cell("by_hand", "0123456789ab", "planner", "{}", WORLD_VERSION, "", "a file")


def row(seed, **values):
    commands = np.random.default_rng(seed).normal(size=(60, 2))
    facts = {"outcome": "success", "steps": 60, "metrics": {"success": 1.0}}
    return Result(seed, "robot_0", commands=commands, inference_s=np.ones(60), **facts, **values)


@pytest.fixture
def store(tmp_path):
    """A store with ten episodes and no writer."""
    ResultsStore(tmp_path).append(CELL, [row(seed) for seed in range(10)])
    return ResultsStore(tmp_path)


def refused(action, *arguments):
    """The one line of an error that is for the user."""
    with pytest.raises(ResultsError) as caught:
        action(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def added(folder):
    """Store one more episode, as a process of its own would."""
    return ResultsStore(folder).append(CELL, [row(10)])


def connected(store, **options):
    return contextlib.closing(sqlite3.connect(store.path, isolation_level=None, **options))


def test_a_locked_file_is_said_to_be_and_can_be_read(store, monkeypatch):
    monkeypatch.setattr(database, "PATIENCE", 0.05)
    with connected(store) as other:
        other.execute("BEGIN IMMEDIATE")
        for action in (
            lambda: store.append(CELL, [row(10)]),
            lambda: require_writable(store.folder),
        ):
            assert refused(action).startswith(
                f"{store.path}: another process has locked it for 0.05"
            )
        assert len(load_results(store.folder)) == 10
        other.execute("COMMIT")
    assert store.append(CELL, [row(10)]) == 1


def test_a_writer_waits_for_its_turn(store):
    with connected(store, check_same_thread=False) as other:
        other.execute("BEGIN IMMEDIATE")
        timer = threading.Timer(0.2, lambda: other.execute("COMMIT"))
        timer.start()
        assert store.append(CELL, [row(10)]) == 1
        timer.join()


def test_a_file_that_is_no_database_is_refused_and_left_alone(tmp_path):
    (tmp_path / FILE).write_text("a,b\n1,2\n" * 1000)
    for action in (load_results, require_writable, added):
        told = refused(action, tmp_path)
        assert told.startswith(f"{tmp_path / FILE}: not a database; move it away or choose")
    assert (tmp_path / FILE).read_text() == "a,b\n1,2\n" * 1000


def test_another_program_s_database_is_refused_and_left_alone(tmp_path):
    with contextlib.closing(sqlite3.connect(tmp_path / FILE)) as other, other:
        other.execute("CREATE TABLE songs (name)")
    before = (tmp_path / FILE).read_bytes()
    for action in (load_results, require_writable, added):
        assert "not a database of crowdbench's" in refused(action, tmp_path)
    assert (tmp_path / FILE).read_bytes() == before


def test_a_damaged_file_is_said_to_be(store):
    data = bytearray(store.path.read_bytes())
    for page in range(3, len(data) // 4096):
        data[page * 4096 : page * 4096 + 100] = bytes([0xA5]) * 100
    store.path.write_bytes(data)
    assert refused(load_results, store.folder).startswith(f"{store.path}: damaged (")
    told = refused(lambda: [store.append(CELL, [row(seed)]) for seed in range(10, 50)])
    assert told.startswith(f"{store.path}: damaged (")


def test_a_newer_schema_is_refused_and_left_alone(store):
    with connected(store) as newer:
        newer.execute("PRAGMA user_version = 2")
    told = f"{store.path}: written by a newer crowdbench (schema 2; this one knows 1); update"
    for action in (load_results, require_writable, added):
        assert refused(action, store.folder).startswith(told)
    with connected(store) as newer:
        assert newer.execute("SELECT count(*) FROM episodes").fetchone() == (10,)


def test_on_a_full_disk_what_was_stored_before_is_kept(store):
    connection = store._writer()
    (pages,) = connection.execute("PRAGMA page_count").fetchone()
    connection.execute(f"PRAGMA max_page_count = {pages + 2}")
    told = refused(lambda: [store.append(CELL, [row(seed)]) for seed in range(10, 100)])
    assert told.startswith(f"{store.path}: cannot be written (no space left on the disk)")
    kept = len(load_results(store.folder))
    assert 10 <= kept < 100
    connection.execute("PRAGMA max_page_count = 1000000")
    assert store.append(CELL, [row(seed) for seed in range(100)]) == 100 - kept


def test_a_folder_that_cannot_be_made_is_found_out_at_once(tmp_path):
    (tmp_path / "file").write_text("in the way")
    for folder in (tmp_path / "file", tmp_path / "file" / "results"):
        with pytest.raises(ResultsError, match=re.escape(str(folder))):
            require_writable(folder)
        assert str(folder) in refused(added, folder)
        assert load_results(folder).empty
    require_writable(tmp_path / "new" / "results")
    assert list((tmp_path / "new" / "results").iterdir()) == [], "the probe leaves nothing behind"


@pytest.fixture
def unprivileged():
    """Somebody who may not write everywhere, with a folder that anybody can reach."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o777)
        if os.geteuid() == 0:
            os.seteuid(65534)
            try:
                yield Path(folder)
            finally:
                os.seteuid(0)
        else:
            yield Path(folder)
        Path(folder).chmod(0o777)


def test_a_read_only_folder_is_found_out_at_once_and_can_be_read(unprivileged):
    folder = unprivileged / "results"
    ResultsStore(folder).append(CELL, [row(seed) for seed in range(10)])
    for path, mode in ((folder / FILE, 0o444), (folder, 0o555)):
        path.chmod(mode)
        for action in (require_writable, added):
            assert refused(action, folder).startswith(str(folder))
        assert len(load_results(folder)) == 10
        assert ResultsStore(folder).stored(CELL).keys() == set(range(10))
    folder.chmod(0o755)


def test_a_read_only_file_is_named(unprivileged):
    ResultsStore(unprivileged).append(CELL, [row(0)])
    (unprivileged / FILE).chmod(0o444)
    told = refused(require_writable, unprivileged)
    assert told.startswith(f"{unprivileged / FILE}: cannot be written or opened (attempt to write")


def test_what_does_not_fit_in_a_column_is_refused(store):
    assert "cannot hold this" in refused(lambda: store.append(CELL, [row(2**64)]))
    odd = replace(CELL, agent="a\udc80b.py:Planner")
    assert "cannot hold this" in refused(lambda: store.append(odd, [row(0)]))
    assert len(load_results(store.folder)) == 10


def test_nothing_is_left_beside_the_file_once_the_writer_is_gone(tmp_path):
    ResultsStore(tmp_path).append(CELL, [row(0)])
    assert [path.name for path in tmp_path.iterdir()] == [FILE]
    assert load_results(tmp_path / "nowhere").empty
    assert not (tmp_path / "nowhere").exists(), "reading makes no folder"


@pytest.mark.parametrize("what", ["folder removed", "folder moved", "file removed", "replaced"])
def test_what_is_written_to_a_file_that_is_gone_is_not_taken_for_stored(store, tmp_path, what):
    store.append(CELL, [row(10)])
    aside = tmp_path.with_name(f"{tmp_path.name}-aside")
    if what == "folder removed":
        shutil.rmtree(tmp_path)
    elif what == "file removed":
        store.path.unlink()
    else:
        tmp_path.rename(aside)
    if what == "replaced":
        ResultsStore(tmp_path).append(CELL, [row(0)])
    told = refused(store.append, CELL, [row(11)])
    assert re.search(r"results.sqlite: was removed, moved or replaced while it was in use", told)
    assert len(load_results(tmp_path)) == (what == "replaced")
    assert not aside.exists() or set(load_results(aside)["seed"]) >= set(range(11))


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_a_file_that_is_none_is_told_of(tmp_path, make):
    make(tmp_path / FILE)
    store = ResultsStore(tmp_path)
    for action in (
        lambda: store.append(CELL, [row(0)]), lambda: store.stored(CELL),
        lambda: load_results(tmp_path), lambda: require_writable(tmp_path),
    ):  # fmt: skip
        assert refused(action).startswith(f"{tmp_path / FILE}: not a file (a folder, pipe or dev")
