"""Recordings of real people are read as pedpy reads them and as their descriptions say."""

import numpy as np
import pytest

from crowdbench.people import read_recording
from crowdbench.people.summary import whole

JUELICH = {
    "bottleneck_040_c_56_h.txt": ({}, 75, 25.0),
    "bidirectional_corridor_400_b_03.txt": ({}, 480, 25.0),
    "unidirectional_uo_180.txt": ({"unit": "cm", "fps": 16}, 220, 16.0),
    "single_file_00_01a.h5": ({}, 46, 25.0),
}


@pytest.mark.parametrize("name", JUELICH)
def test_files_of_the_archive_are_as_pedpy_reads_them(recordings, name):
    pedpy = pytest.importorskip("pedpy")
    given, people, fps = JUELICH[name]
    path = recordings / "juelich" / name
    if path.suffix == ".h5":
        theirs = pedpy.load_trajectory_from_ped_data_archive_hdf5(trajectory_file=path)
    else:
        units = {"cm": pedpy.TrajectoryUnit.CENTIMETER}
        theirs = pedpy.load_trajectory(
            trajectory_file=path,
            default_frame_rate=given.get("fps"),
            default_unit=units.get(given.get("unit")),
        )
    recording = read_recording(path, **given)
    table = theirs.data.sort_values(["id", "frame"])
    assert theirs.frame_rate == fps
    assert len(recording.people) == theirs.number_pedestrians == people
    assert np.array_equal(recording.frames, table["frame"])
    assert recording.positions == pytest.approx(table[["x", "y"]].to_numpy())
    assert np.concatenate(recording.extent) == pytest.approx(theirs.bounds)
    first, last = theirs.frame_range
    assert recording.duration == pytest.approx((last - first) / fps)
    assert not recording.interpolated.any()
    slow, _, fast = whole(recording).speeds
    assert 0 <= slow < fast < 2
    assert len(recording.jumps()) < 0.001 * len(recording.times)


def test_the_door_has_its_walls(recordings):
    walls = read_recording(recordings / "juelich" / "single_file_00_01a.h5").walls
    outline, *blocks = sorted(walls, key=len)
    assert len(blocks) == 2
    assert np.concatenate([outline.min(0), outline.max(0)]) == pytest.approx([-4, -4, 4, 6])


def test_the_street_in_zurich_is_as_annotated(recordings):
    recording = read_recording(recordings / "eth_ucy" / "eth_obsmat.txt")
    assert recording.period == pytest.approx(0.4)
    assert len(set(recording.people.tolist())) == 360
    assert len(recording.times) == 8908
    assert recording.duration == pytest.approx((12381 - 780) / 15)
    assert 1.2 < whole(recording).speeds[1] < 1.6  # of people who walk freely
