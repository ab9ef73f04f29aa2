"""Each kind of file gives the same walk."""

import numpy as np
import pytest
from recording_files import (
    FRAMES,
    POSITIONS,
    csv_frames,
    csv_more_columns,
    csv_times,
    hdf5,
    jupedsim,
    obsmat,
    obsmat_text,
    petrack,
    petrack_centimetres,
    table,
    trajnet,
)

from crowdbench.people import RecordingError, read_recording

SAID = [petrack, petrack_centimetres, csv_times, trajnet, obsmat, hdf5, jupedsim]
ASKED = [(csv_frames, {"unit": "m", "fps": 25}), (csv_more_columns, {"fps": 25})]


@pytest.mark.parametrize(
    ("make", "given"),
    [*((make, {}) for make in SAID), *ASKED],
    ids=lambda v: getattr(v, "__name__", ""),
)
def test_every_kind_gives_the_same_people(write, make, given):
    recording = read_recording(make(write), **given)
    assert recording.people.tolist() == [3, 8]
    assert recording.starts.tolist() == [0, 12, 24]
    assert recording.period == pytest.approx(0.04)
    assert recording.times == pytest.approx((FRAMES - 5) / 25)
    assert recording.positions == pytest.approx(POSITIONS, abs=1e-6)
    assert not recording.interpolated.any()


@pytest.mark.parametrize("make", [hdf5, jupedsim])
def test_walls_are_outline_and_holes(write, make):
    walls = read_recording(make(write)).walls
    corners = [{tuple(corner) for corner in wall.tolist()} for wall in walls]
    assert corners == [
        {(-1, -1), (9, -1), (9, 9), (-1, 9)},
        {(2, 2), (3, 2), (3, 3), (2, 3)},
    ]
    assert all(np.array_equal(wall[0], wall[-1]) for wall in walls)


def test_frames_are_numbered_as_in_the_file(write):
    assert np.array_equal(read_recording(petrack(write)).frames, FRAMES)
    assert np.array_equal(read_recording(obsmat(write)).frames, 6 * FRAMES)
    assert np.array_equal(read_recording(trajnet(write)).frames, 10 * FRAMES)


def test_millimetres_of_petrack_are_read(write):
    recording = read_recording(write(table(" ", 1000)), unit="mm", fps=25)
    assert recording.positions == pytest.approx(POSITIONS, abs=1e-6)


def test_petrack_with_as_many_columns_as_obsmat_is_petrack(write):
    body = table(" ", 100, height=["1.7", "1", "0", "0"])
    path = write(f"# framerate: 25 fps\n# id frame x/cm y/cm z/cm viewX viewY viewZ\n{body}")
    recording = read_recording(path, fps=25)
    assert recording.people.tolist() == [3, 8]
    assert recording.positions == pytest.approx(POSITIONS, abs=1e-6)


def test_the_frame_rate_of_obsmat_follows_from_its_velocities(write):
    for seconds in (0.04, 0.4, 1 / 3):
        recording = read_recording(write(obsmat_text(seconds)))
        assert recording.period == pytest.approx(seconds, rel=1e-3)


@pytest.mark.parametrize("fps", [25, 150])
def test_annotations_and_numbered_frames_a_second_are_the_same_statement(write, fps):
    assert read_recording(obsmat(write), fps=fps).period == pytest.approx(0.04)


def test_obsmat_without_velocities_needs_a_frame_rate(write):
    path = write(obsmat_text(wrong=0.0))
    with pytest.raises(RecordingError, match="how many frames a second"):
        read_recording(path)
    assert read_recording(path, fps=2.5).period == pytest.approx(0.4)


def test_velocities_that_contradict_each_other_say_no_frame_rate(write):
    lines = obsmat_text().splitlines(keepends=True)
    other = obsmat_text(0.4).splitlines(keepends=True)
    path = write("".join(pair[n % 2] for n, pair in enumerate(zip(lines, other, strict=True))))
    with pytest.raises(RecordingError, match="how many frames a second"):
        read_recording(path)


def test_hdf5_may_have_no_walls(write):
    h5py = pytest.importorskip("h5py")
    path = hdf5(write)
    with h5py.File(path, "r+") as file:
        del file.attrs["wkt_geometry"]
    assert read_recording(path).walls == ()


def test_what_is_given_and_said_alike_is_fine(write):
    assert read_recording(petrack_centimetres(write), unit="cm", fps=25).period == 0.04
    assert read_recording(petrack_centimetres(write), fps=25.2).period == 0.04
