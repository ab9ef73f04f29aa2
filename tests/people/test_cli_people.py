"""``crowdbench people``: what is in a recording."""

import re

import pytest
from recording_files import csv_frames, hdf5, petrack

from crowdbench.cli import main


@pytest.fixture
def people(tmp_path, monkeypatch, capsys):
    """Run the command in a folder of its own; the exit code and what it says."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)

    def people(*arguments):
        code = main(["people", *map(str, arguments)])
        said = capsys.readouterr()
        return code, said.out, said.err

    return people


def test_it_says_what_is_there(people, write, tmp_path):
    code, said, complaints = people(hdf5(write))
    assert (code, complaints) == (0, "")
    assert "walk.h5: HDF5 of the Juelich archive, 25 frames a second" in said
    assert "people: 2, at most 2 at a time" in said
    assert "duration: 0.6 s, a position every 0.04 s, frames 5 to 20" in said
    assert "walls: 2 closed lines" in said
    assert re.search(r"0\.0 to 0\.6 +1\.5 ", said)  # each of the two is there for 0.44 s of 0.6
    assert (tmp_path / "here" / "walk.h5_tracks.png").read_bytes().startswith(b"\x89PNG")


def test_what_it_saves_it_reads_again(people, write, tmp_path):
    _, said, _ = people(petrack(write), "--save", "kept.npz", "-o", "a.png")
    again = people("kept.npz", "-o", "b.png")
    assert again[0] == 0
    told = said.partition("picture: ")[0]
    assert again[1].startswith(told) and len(told) > 200
    assert (tmp_path / "here" / "a.png").read_bytes() == (tmp_path / "here" / "b.png").read_bytes()


def test_a_picture_takes_the_place_of_no_other_unsaid(people, write, tmp_path):
    path = petrack(write)
    _, said, _ = people(path, "--save", "walk.npz")
    assert "picture: walk.txt_tracks.png\n" in said
    first = (tmp_path / "here" / "walk.txt_tracks.png").read_bytes()
    _, said, _ = people("walk.npz")
    assert "picture: walk.npz_tracks.png\n" in said
    assert (tmp_path / "here" / "walk.txt_tracks.png").read_bytes() == first
    _, said, _ = people(path)
    assert "picture: walk.txt_tracks.png (in place of an older file)\n" in said


def test_the_user_is_asked_for_unit_and_frame_rate(people, write, tmp_path):
    code, _, complaints = people(csv_frames(write))
    assert code == 2
    assert complaints.count("\n") == 1
    assert "does not say in which unit" in complaints and "fps: e.g. 25" in complaints
    assert not list((tmp_path / "here").iterdir())
    assert people(tmp_path / "walk.txt", "--unit", "m", "--fps", 25)[0] == 0


def test_jumps_are_told_with_frame_and_person(people, write):
    rows = [f"{p},{f},{0.1 * f + (f > 4) * (p > 1):.2f},{p}\n" for p in range(9) for f in range(9)]
    path = write("id,frame,x,y\n" + "".join(rows))
    code, _, complaints = people(path, "--unit", "m", "--fps", 10)
    assert code == 0
    assert "frame 5 person 2 (11.0 m/s), frame 5 person 3 (11.0 m/s)" in complaints
    assert complaints.rstrip().endswith("and 2 more")


def test_gaps_are_told(people, write):
    rows = [f"1,{f},{0.1 * f:.1f},0\n" for f in [0, 1, 2, 5, 6, 7, 30, 31]]
    path = write("id,frame,x,y\n" + "".join(rows))
    _, said, _ = people(path, "--unit", "m", "--fps", 10)
    assert "people: 1, at most 1 at a time; 2 tracks" in said
    assert "gaps: 2 positions filled in; tracks begun anew after a longer gap: 1" in said


def test_parts_of_the_table_last_a_second_or_more(people, write):
    rows = [f"1,{f},{0.1 * f:.1f},0\n" for f in [*range(11), *range(30, 36)]]
    path = write("id,frame,x,y\n" + "".join(rows))
    _, said, _ = people(path, "--unit", "m", "--fps", 10)
    parts = re.findall(r"^ *(\d\.\d to \d\.\d) +\S+ +\S+ +(\S+)", said, re.MULTILINE)
    assert [part for part, _ in parts] == ["0.0 to 1.2", "1.2 to 2.3", "2.3 to 3.5", "0.0 to 3.5"]
    assert [speed for _, speed in parts] == ["1.00", "-", "1.00", "1.00"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--save", "kept.npy"], "--save kept.npy: the name has to end with .npz"),
        (["--output", "a.xyz"], "a.xyz: cannot be written"),
        (["--unit", "ft"], "unit 'ft': has to be one of m, cm, mm"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_line(people, write, arguments, told):
    code, _, complaints = people(petrack(write), *arguments)
    assert code == 2
    assert told in complaints and complaints.count("\n") == 1
