"""Recordings of real people are read as pedpy reads them and as their descriptions say."""

import warnings

import numpy as np
import pytest
from crossings import crossing
from PIL import Image

from crowdbench.people import read_recording
from crowdbench.people.summary import whole
from crowdbench.simulation.layout import place

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


@pytest.fixture
def street(recordings, tmp_path):
    """The map of the street in Zurich seen from above, as its homography says."""
    metres = 0.05  # per pixel
    x, y = np.meshgrid(np.arange(-9, 15, metres), np.arange(15, -5, -metres))
    seen = np.linalg.inv(np.loadtxt(recordings / "eth_ucy" / "eth_H.txt"))
    row, column, scale = np.einsum("ij,jkl->ikl", seen, [x, y, np.ones_like(x)])
    places = np.rint([row / scale, column / scale]).astype(int)
    walls = np.asarray(Image.open(recordings / "eth_ucy" / "eth_map.png").convert("L")) > 127
    known = ((places >= 0) & (places < np.reshape(walls.shape, (2, 1, 1)))).all(axis=0)
    solid = np.zeros(x.shape, bool)
    solid[known] = walls[tuple(places[:, known])]
    Image.fromarray(np.where(solid, 0, 254).astype(np.uint8)).save(tmp_path / "street.png")
    (tmp_path / "street.yaml").write_text(
        f"image: street.png\nresolution: {metres}\norigin: [-9, -5, 0]\n"
    )
    return {
        "kind": "map",
        "image": str(tmp_path / "street.yaml"),
        "regions": {"north": [2, 7, 10, 11], "south": [2, 0, 10, 2]},
    }


@pytest.mark.parametrize(
    "way",
    [
        {"pedestrians.recording.route": "across"},
        {"pedestrians.recording.route": "along"},
        {"robots.start": "south", "robots.goal": "north"},
    ],
    ids=["across", "along", "given"],
)
def test_a_recording_and_its_map_are_crossed(recordings, street, way):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nobody walks through the walls of this map
        scenario = crossing(recordings / "eth_ucy" / "eth_obsmat.txt", arena=street, **way)
    for seed in range(3):
        start, goal = (ends := place(scenario, seed)).robot_pose[0, :2], ends.robot_goal[0]
        assert 2.5 <= np.linalg.norm(goal - start) <= 14
