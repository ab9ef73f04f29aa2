"""A picture has every track, by direction, and every wall."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from recording_files import hdf5

from crowdbench.people import read_recording
from crowdbench.people.picture import directions, draw, save_picture


@pytest.fixture
def cross(cleaned):
    """Four people, who walk to the right, up, to the left and down."""
    leads = {1: (1, 0), 2: (0, 1), 3: (-1, 0.3), 4: (-0.2, -1)}
    return cleaned(
        [(p, f, 0.1 * f * x, 0.1 * f * y) for p, (x, y) in leads.items() for f in range(20)]
    )


def test_tracks_lead_where_their_people_go(cross):
    assert directions(cross).tolist() == [0, 1, 2, 3]


def test_every_track_is_drawn_as_recorded(cross):
    (axes,) = draw(cross).axes
    lines = [c for c in axes.collections if isinstance(c, LineCollection)]
    drawn = [path.vertices for line in lines for path in line.get_paths()]
    assert np.concatenate(drawn) == pytest.approx(cross.positions)
    assert len(drawn) == 4
    assert len({tuple(line.get_color()[0][:3]) for line in lines}) == 4


def test_walls_are_drawn(write):
    recording = read_recording(hdf5(write))
    (axes,) = draw(recording).axes
    black = [line.get_xydata() for line in axes.lines if line.get_color() == "black"]
    assert all(map(np.array_equal, black, recording.walls)) and len(black) == 2


def test_a_name_is_no_formula(cross, tmp_path):
    save_picture(replace(cross, name=r"a $\nothing{ b$.txt"), tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_people_on_one_line_can_be_drawn(cleaned, tmp_path):
    straight = cleaned([(1, f, 0.1 * f, 3.0) for f in range(9)])
    save_picture(straight, tmp_path / "a.png")
    still = cleaned([(1, f, 3.0, 3.0) for f in range(9)])
    save_picture(still, tmp_path / "a.png")
