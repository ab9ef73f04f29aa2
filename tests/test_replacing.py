"""Files take their place when they are whole; a full disk leaves what was there."""

import numpy as np
import pytest
from full_disk import room_for
from matplotlib.figure import Figure
from recording_files import petrack

from crowdbench.cli import main
from crowdbench.people import read_recording
from crowdbench.people.picture import save_picture
from crowdbench.people.saved import save
from crowdbench.replacing import replacing
from crowdbench.simulation.video import write_video
from crowdbench.study.figures import save_figures
from crowdbench.study.model import Drawing


def noise(count):
    return np.random.default_rng(0).integers(0, 256, (count, 64, 64, 3), dtype=np.uint8)


def recording(folder):
    path = folder / "walk.txt"
    return read_recording(petrack(lambda text: path.write_text(text) and path))


def figure(folder):
    drawn = Figure()
    drawn.subplots().plot(noise(1).ravel())
    save_figures([Drawing("a", "", "", lambda measured, source: drawn)], None, folder, folder)


WRITERS = {
    "a.gif": lambda folder: write_video(noise(3), folder / "a.gif", fps=5),
    # Of a short one ffmpeg writes nothing before it has all, of a long one it does.
    "a.mp4": lambda folder: write_video(noise(3), folder / "a.mp4", fps=5),
    "b.mp4": lambda folder: write_video(noise(300), folder / "b.mp4", fps=5),
    "a.jpg": lambda folder: save_picture(recording(folder.parent), folder / "a.jpg"),
    "a.npz": lambda folder: save(recording(folder.parent), folder / "a.npz"),
    "a.pdf": figure,
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_what_was_there(name, tmp_path):
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / name).write_text("before")
    with room_for(1000), pytest.raises(OSError):
        WRITERS[name](folder)
    assert [(path.name, path.read_text()) for path in folder.iterdir()] == [(name, "before")]
    WRITERS[name](folder)
    assert (folder / name).stat().st_size > 1000
    assert not list(folder.glob(".*"))


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_a_picture_that_has_no_room_leaves_no_file(name, tmp_path, capsys):
    arguments = ["show", "unimodal_slow", "--output", str(tmp_path / name)]
    with room_for(1000):
        assert main(arguments) == 2
    complaint = capsys.readouterr().err
    assert f"{name}: cannot be written" in complaint and complaint.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
    assert main(arguments) == 0


def test_a_link_leads_to_the_new_file(tmp_path):
    file, link = tmp_path / "file.txt", tmp_path / "link.txt"
    file.write_text("before")
    link.symlink_to(file)
    with replacing(link) as part:
        part.write_text("after")
    assert (file.read_text(), link.is_symlink()) == ("after", True)


def test_what_is_half_written_is_never_seen(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("before")
    with pytest.raises(KeyboardInterrupt), replacing(path) as part:
        part.write_text("half")
        assert path.read_text() == "before"
        raise KeyboardInterrupt
    assert [one.read_text() for one in tmp_path.iterdir()] == ["before"]
