"""What every test relies on: one thread per process and no screen."""

import os
import signal

import hypothesis
import pytest

# A test that fails is the fault of what was changed, not of new random examples.
# `pytest --hypothesis-profile default` looks for those.
hypothesis.settings.register_profile("repeatable", derandomize=True)
hypothesis.settings.load_profile("repeatable")

# Several test processes share the cores; this has to be said before numpy and torch are loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ["SDL_VIDEODRIVER"] = "dummy"

# A job in the background of a shell ignores Ctrl-C, and what it starts inherits that; some tests
# send it to programs that they have started.
signal.signal(signal.SIGINT, signal.default_int_handler)

pytest_plugins = ["stored_episodes"]


@pytest.fixture(scope="session", autouse=True)
def _nothing_is_published(tmp_path_factory):
    """What a test sees of the record is what it has put there, see the fixture ``record``."""
    folder = tmp_path_factory.mktemp("nothing")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("crowdbench.evaluation.record.record_folder", lambda: folder)
        yield


@pytest.fixture
def record(tmp_path, monkeypatch):
    """A record that belongs to the test, found as if it were installed."""
    folder = tmp_path / "record"
    monkeypatch.setattr("crowdbench.evaluation.record.record_folder", lambda: folder)
    return folder
