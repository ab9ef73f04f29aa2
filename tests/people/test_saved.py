"""A recording that is saved is read as it was."""

import dataclasses
import zipfile

import numpy as np
import pytest
from recording_files import hdf5, petrack

from crowdbench.people import RecordingError, read_recording
from crowdbench.people.saved import save


@pytest.fixture
def recording(cleaned):
    """With a gap that is filled and one that ends a track."""
    frames = [0, 1, 2, 4, 5, 30, 31, 32]
    return cleaned([(p, f, 0.1 * f, float(p)) for p in (2, 5) for f in frames])


def assert_same(one, other):
    for field in dataclasses.fields(one):
        first, second = getattr(one, field.name), getattr(other, field.name)
        if field.name == "walls":
            assert len(first) == len(second)
            assert all(map(np.array_equal, first, second))
        else:
            assert np.array_equal(first, second)


def test_everything_is_read_again(recording, tmp_path):
    assert recording.interpolated.any() and recording.people.tolist() == [2, 2, 5, 5]
    save(recording, tmp_path / "walk.npz")
    assert_same(read_recording(tmp_path / "walk.npz"), recording)


def test_walls_are_read_again(write, tmp_path):
    recording = read_recording(hdf5(write))
    assert len(recording.walls) == 2
    save(recording, tmp_path / "walk.npz")
    assert_same(read_recording(tmp_path / "walk.npz"), recording)


def test_the_file_is_compressed_and_has_no_objects(recording, tmp_path):
    save(recording, tmp_path / "walk.npz")
    with zipfile.ZipFile(tmp_path / "walk.npz") as archive:
        assert {entry.compress_type for entry in archive.infolist()} == {zipfile.ZIP_DEFLATED}
    with np.load(tmp_path / "walk.npz", allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)


def test_the_same_recording_has_the_same_bytes(recording, tmp_path):
    save(recording, tmp_path / "one.npz")
    save(recording, tmp_path / "two.npz")
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()


def test_it_says_unit_and_frame_rate(write, tmp_path):
    save(read_recording(petrack(write)), tmp_path / "walk.npz")
    assert read_recording(tmp_path / "walk.npz", unit="m", fps=25).people.tolist() == [3, 8]
    with pytest.raises(RecordingError, match="it has positions in m, and cm is given"):
        read_recording(tmp_path / "walk.npz", unit="cm")


@pytest.mark.parametrize(
    "change",
    [
        {"starts": np.array([0, 3, 6, 9, 99])},
        {"starts": np.array([0, 1, 6, 9, 18])},
        {"times": np.zeros(18)},
        {"positions": np.full((18, 2), np.nan)},
        {"positions": np.zeros((17, 2))},
        {"people": np.zeros(0, int), "starts": np.zeros(1, int)},
        {"period": np.array(0.0)},
        {"frames": np.zeros(18)},
        {"times": np.array(1.0)},
        {"times": np.append(0.1 * np.arange(17), np.inf)},
        {"period": np.ones(3)},
        {"wall_starts": np.array([0.0, 5.0])},
        {"wall_points": np.zeros((5, 2)), "wall_starts": np.array([0, 9])},
        {"wall_points": np.zeros((5, 2)), "wall_starts": np.array([0, 1, 5])},
        {"wall_points": np.full((5, 2), np.nan), "wall_starts": np.array([0, 5])},
    ],
)
def test_arrays_that_do_not_fit_together_are_refused(recording, tmp_path, change):
    path = tmp_path / "walk.npz"
    save(recording, path)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    assert len(arrays["times"]) == 18
    np.savez(path, **arrays)
    assert_same(read_recording(path), recording)
    np.savez(path, **arrays | change)
    with pytest.raises(RecordingError, match=r"do not fit together|not from `crowdbench people"):
        read_recording(path)
