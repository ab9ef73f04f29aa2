"""Compiled functions: where their machine code is kept, and when it is used again."""

import gc
import json
import os
import subprocess
import sys

import numba
import pytest
from numba.core import event

import crowdbench.compiled  # noqa: F401 - stops the collector while numba compiles

INNER = """
from crowdbench.compiled import compiled

@compiled()
def inner(x):
    return x + {added}
"""
OUTER = """
from crowdbench.compiled import compiled
from sums.inner import inner

@compiled()
def outer(x):
    return 10 * inner(x)
"""
ASK = """
import json
from crowdbench.compiled import cache_folder
from sums.outer import outer
value = outer(1)
print(json.dumps([value, sum(outer.stats.cache_hits.values()), str(cache_folder())]))
"""


@pytest.fixture
def package(tmp_path):
    """A package of two files, one of which calls the other."""
    folder = tmp_path / "place" / "sums"
    folder.mkdir(parents=True)
    (folder / "__init__.py").touch()
    (folder / "inner.py").write_text(INNER.format(added=1))
    (folder / "outer.py").write_text(OUTER)
    return folder


def ask(package, **environment):
    """Value of outer(1), how often it came from the cache, and the cache's folder."""
    known = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    path = os.pathsep.join([str(package.parent), *filter(None, sys.path)])
    answer = subprocess.run(
        [sys.executable, "-c", ASK],
        env={**known, "PYTHONPATH": path, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(answer.stdout)


def test_machine_code_is_kept_in_the_users_cache_and_found_again(package, tmp_path):
    home = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "HOME": str(tmp_path)}
    value, hits, folder = ask(package, **home)
    assert (value, hits) == (20, 0)
    assert folder.startswith(str(tmp_path))
    assert not list(package.rglob("*.nbi"))
    # A reinstallation writes the same files anew.
    for path in package.glob("*.py"):
        text = path.read_text()
        path.unlink()
        path.write_text(text)
    assert ask(package, **home) == [20, 1, folder]


def test_a_change_in_another_file_counts(package, tmp_path):
    place = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    assert ask(package, **place) == [20, 0, place["NUMBA_CACHE_DIR"]]
    (package / "inner.py").write_text(INNER.format(added=5))
    assert ask(package, **place)[:2] == [60, 0]


def test_without_a_home_that_can_be_written_to(package, tmp_path):
    file = tmp_path / "no_folder"
    file.touch()
    shut = {"XDG_CACHE_HOME": str(file), "HOME": str(file), "NUMBA_CACHE_DIR": str(file)}
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    value, _, folder = ask(package, **shut, TMPDIR=str(temporary))
    assert (value, folder) == (20, str(temporary / f"crowdbench-{os.getuid()}"))
    assert ask(package, **shut, TMPDIR=str(temporary))[:2] == [20, 1]


def test_a_temporary_folder_that_others_may_write_to_is_not_trusted(package, tmp_path):
    file = tmp_path / "no_folder"
    file.touch()
    shut = {"XDG_CACHE_HOME": str(file), "HOME": str(file), "TMPDIR": str(tmp_path)}
    open_to_all = tmp_path / f"crowdbench-{os.getuid()}"
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    assert ask(package, **shut)[2] != str(open_to_all)


class Collector(event.Listener):
    """Whether garbage is collected when a compilation begins."""

    def __init__(self):
        self.enabled = []

    def on_start(self, event):
        self.enabled.append(gc.isenabled())

    def on_end(self, event):
        pass


def test_garbage_is_collected_again_after_a_compilation():
    inner = numba.njit(lambda x: x + 1)
    with event.install_listener("numba:compile", Collector()) as collector:
        assert numba.njit(lambda x: inner(x))(1) == 2
    assert collector.enabled == [False, False]
    assert gc.isenabled()


def test_garbage_is_collected_again_after_a_failed_compilation():
    with pytest.raises(numba.TypingError):
        numba.njit(lambda x: x.nothing)(1)
    assert gc.isenabled()


def test_a_collector_that_was_off_stays_off():
    gc.disable()
    try:
        numba.njit(lambda x: x + 1)(1)
        assert not gc.isenabled()
    finally:
        gc.enable()
