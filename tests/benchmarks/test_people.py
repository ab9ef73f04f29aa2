"""How simulated people are compared with recorded ones, by hand and on a small recording."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from crossings import walking

from crowdbench.people import read_recording
from crowdbench.people.likeness import Frames

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "people.py"


@pytest.fixture(scope="module")
def benchmark():
    spec = importlib.util.spec_from_file_location("people_benchmark", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "walk.csv"
    path.write_text(walking(persons=8, every=1.0))
    return read_recording(path)


def pair(apart, steps=20):
    """Two people who walk beside each other, one of whom slows down."""
    place = np.cumsum(np.linspace(0.3, 0.1, steps))
    one = np.column_stack([0.2 * np.arange(steps), np.zeros(steps)])
    return Frames(np.stack([one, np.column_stack([place, np.full(steps, apart)])], axis=1), 0.2)


def test_a_crowd_does_not_differ_from_itself(benchmark):
    assert benchmark.mismatch(pair(1.0), pair(1.0)) == 0.0
    assert 0.0 < benchmark.mismatch(pair(1.0), pair(1.2)) < benchmark.mismatch(pair(1.0), pair(2.0))


def test_a_difference_counts_by_the_spread_of_what_was_recorded(benchmark, monkeypatch):
    monkeypatch.setattr(benchmark, "MEASURES", {"x": (lambda f: f.position[:, 0, 0], "m")})
    one, other = (Frames(np.array([[[x, 0.0]] for x in xs]), 0.2) for xs in ((0, 2), (3, 5)))
    assert benchmark.mismatch(one, other) == pytest.approx(3.0)  # 3 m by 1 m


@pytest.mark.parametrize("limit", [np.inf, 0.02])
def test_simulated_people_keep_to_the_fields(benchmark, recording, limit):
    found = benchmark.simulated(recording, "orca", benchmark.Fields(0.3, limit))
    assert found.missed == 0
    place = found.frames.position
    assert np.isfinite(place).any(axis=0).all()
    change = np.linalg.norm(np.diff(place, n=2, axis=0), axis=2) / 0.2**2
    assert (np.nanmax(change) <= 0.02 + 1e-9) == (limit == 0.02)


@pytest.mark.parametrize("model", ["orca", "social_force"])
def test_who_stands_is_there_as_long_as_recorded_and_in_the_way(benchmark, tmp_path, model):
    path = tmp_path / "walk.csv"
    rows = [f"9,{0.4 * k:.1f},0.0,{0.05 * (k % 2)}" for k in range(41)]  # 16 s, in the way of 0, 2
    path.write_text(walking(persons=4) + "\n".join(rows) + "\n")
    recording = read_recording(path)
    real, found = benchmark.recorded(recording), benchmark.simulated(recording, model)
    stands = recording.people.tolist().index(9)
    there = np.isfinite(found.frames.position[:, stands, 0])
    assert there.tolist() == np.isfinite(real.position[:, stands, 0]).tolist()
    assert np.nanmax(np.linalg.norm(found.frames.position[:, stands], axis=1)) < 1.0
    # Recorded ones walk through that place; those of a model do not walk through somebody.
    apart = [
        np.nanmin(np.linalg.norm(frames.position[:, 0] - frames.position[:, stands], axis=1))
        for frames in (real, found.frames)
    ]
    assert apart[0] < 0.2 < apart[1]


def test_fields_are_chosen_on_every_other_recording(benchmark, recording, capsys, monkeypatch):
    usual, other = benchmark.AS_USUAL, benchmark.Fields(0.25, 2.4)
    monkeypatch.setattr(benchmark, "FIELDS", [usual, other])
    monkeypatch.setattr(benchmark, "simulated", lambda _, name, fields: _Crowd(fields))
    # On the first and third the other fields are better, on the second worse.
    answers = {usual: iter([0.4, 0.1, 0.6]), other: iter([0.3, 0.9, 0.3])}
    monkeypatch.setattr(benchmark, "mismatch", lambda real, fields: next(answers[fields]))
    benchmark.fit([recording] * 3, ["orca"])
    assert capsys.readouterr().out.splitlines()[-2:] == [
        "| `orca` | 0.2 | inf | 0.500 | 0.100 |",
        "| `orca` | 0.25 | 2.4 | 0.300 | 0.900 |",
    ]


class _Crowd:
    def __init__(self, fields):
        self.frames = fields
