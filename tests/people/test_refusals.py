"""Files that are no recording, or not a whole one, are refused in one line."""

import sqlite3
import sys

import numpy as np
import pytest
from crossings import crossing
from recording_files import csv_times, hdf5, jupedsim, obsmat, petrack, table, trajnet

from crowdbench import ScenarioError
from crowdbench.people import RecordingError, read_recording
from crowdbench.people.saved import save

PETRACK = "# framerate: 25 fps\n# id frame x/m y/m z/m\n"
WALK = "".join(f"1 {f} {0.04 * f:.3f} 2.0 1.7\n" for f in range(9))
HEADER = "id,time,x/m,y/m\n"


def refused(path, **given):
    with pytest.raises(RecordingError) as caught:
        read_recording(path, **given)
    told = str(caught.value)
    assert "\n" not in told
    assert told.startswith(str(path))
    return told.removeprefix(str(path))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", ": the file is empty"),
        (" \n\n", ": the file is empty"),
        ("It was a dark night.\n", ": not a recording of a known kind, which are: PeTrack text,"),
        ("1 2\n3 4\n", ": not a recording of a known kind"),
        (b"\x00\x01\x02\x03", ": not a recording of a known kind"),
        (b"id,time,x\xe4,y\n", ": not text in UTF-8"),
        (PETRACK, ": nothing but comments, no positions in it"),
        (f"{HEADER}1,0,2,3\n".encode("utf-16"), ": text in UTF-16 or UTF-32; allowed: UTF-8"),
        (f"\ufeff{HEADER}1,0,2,3\n".encode("utf-16-be"), ": text in UTF-16 or UTF-32; allowed"),
        (f"{HEADER}1,0,2,3\n".encode("utf-32"), ": text in UTF-16 or UTF-32; allowed: UTF-8"),
        (f"\ufeff{HEADER}1,0,2,3\n".encode("utf-32-be"), ": text in UTF-16 or UTF-32; allowed"),
        (PETRACK + WALK + "1 9 0.36 2.0\n", ": the last line, '1 9 0.36 2.0', has fewer columns"),
        (PETRACK + WALK + "1 9", ": the last line, '1 9', has fewer columns"),
        (PETRACK + WALK + "1 9 x 2.0 1.7\n", ": line 12: x 'x' is no finite number, in '1 9 x"),
        (PETRACK + WALK + "1 9 nan 2.0 1.7\n", ": line 12: x 'nan' is no finite number"),
        (PETRACK + WALK + "1 9 inf 2.0 1.7\n", ": line 12: x 'inf' is no finite number"),
        (PETRACK + WALK + "1 9.5 0 2.0 1.7\n", ": line 12: frame '9.5' is no whole number"),
        (PETRACK + WALK + "1 3 0.1 2.0 1.7\n", ": frame 3, person 1: is there twice"),
        (PETRACK + "1 -1 0 2 1.7\n" + WALK, ": frame -1, person 1: frames and times are 0"),
        (PETRACK + WALK + f"{10**20} 9 0 2 1.7\n" * 2, ": id 1e+20 is no whole number below 2^63"),
        (PETRACK.replace("25", "0") + WALK, ": its frame rate is 0, and has to be above 0"),
        (PETRACK + WALK + "2 7 1e9 2 1.7\n", ": frame 7, person 2: time, x and y have to"),
        (PETRACK + WALK + "2 26000000 0 2 0\n2 26000001 0 2 0\n", ": its last position is 1.04"),
        (HEADER, ": there are no positions in it"),
        (HEADER + "1,0,2,3\n1,0.1,2\n", ": line 3: y is missing, in '1,0.1,2'"),
        (HEADER + "1,0,2,3\n1,0.1,,3\n", ": line 3: x is missing, in '1,0.1,,3'"),
        (HEADER + "1,0,2,3\n1,-0.1,2,3\n", ": -0.1 s, person 1: frames and times are 0 or later"),
        (HEADER + "1,0,2,3\n1,0,2,3\n", ": 0 s, person 1: is there twice"),
        (HEADER + "1.5,0,2,3\n", ": line 2: id '1.5' is no whole number"),
        (HEADER + "1,0,2,3\n2,0,2,3\n", ": nobody is seen twice"),
        (HEADER + "anna,0,2,3\n", ": line 2: id 'anna' is no whole number, in 'anna,0,2,3'"),
        (HEADER + "1,noon,2,3\n", ": line 2: time 'noon' is no finite number"),
        ("id,time,x [ft],y [ft]\n1,2,3,4\n", ": column 'x [ft]': the unit 'ft'; allowed: m, cm"),
        ("id,time,X/px,Y/px\n1,2,3,4\n", ": column 'X/px': the unit 'px'; allowed: m, cm or mm"),
        ("id,time_of_day,x,y\n1,2,3,4\n", ": no column time or frame; there are: id, time_of_"),
        ("id,time [ms],x,y\n1,2,3,4\n", ": column 'time [ms]': the unit 'ms'; allowed: s"),
        ("id,time,x [m],y\n1,2,3,4\n1,3,3,x\n", ": line 3: y 'x' is no finite number"),
        ("id,x,y\n1,2,3\n", ": no column time or frame; there are: id, x, y"),
        ("who,when,x,y\n1,2,3,4\n", ": no column id and no time or frame; there are: who, when"),
        ("id,time,x_m,y_cm\n1,2,3,4\n", ": x and y are in different units"),
        ("id,time,t,x_m,y_m\n1,2,3,4,5\n", ": two columns for time"),
        ('{"track": {"f": 1, "p": 1, "x": 0.5}}\n', ": line 1: expected a track with p, f, x, y"),
        ('{"track": {"f": 1, "p": 1, "x": 0.5, "y"', ": line 1: expected a track with p, f, x, y"),
        ('{"track": {"f": ' + 400 * "9" + ', "p": 1, "x": 0, "y": 0}}\n', ": line 1: expected a"),
        ('{"track": ' + 100_000 * "[", ": line 1: expected a track with p, f, x, y"),
        (2 * '{"scene": {"fps": 1}}\n{"track": {"f": 3, "p": 1, "x": 0, "y": 0}}\n'
         '{"track": {"f": 4, "p": 1, "x": 0, "y": 0}}\n', ": frame 3, person 1: is there twice"),
        ('{"tracks": []}\n', ": line 1: expected a track"),
        ('{"scene": {"id": 0, "fps": 2.5}}\n', ": there are no positions in it"),
        ('{"scene": {"fps": 2.5}}\n{"scene": {"fps": 25}}\n', ": its scenes have different frame"),
        ('{"scene": {"fps": -1}}\n', ": its frame rate is -1, and has to be above 0"),
    ],
)  # fmt: skip
def test_text_that_is_no_recording_is_refused(write, text, told):
    assert refused(write(text)).startswith(told)


@pytest.mark.parametrize(
    ("text", "given", "told"),
    [
        (WALK, {}, "in which unit its positions are (unit: m, cm or mm), nor how many frames"),
        (WALK, {"fps": 25}, "in which unit its positions are (unit: m, cm or mm); please do"),
        (WALK, {"unit": "m"}, "does not say how many frames a second it has (fps: e.g. 25)"),
        ("id,frame,x,y\n1,0,0,0\n", {}, "(unit: m, cm or mm), nor how many frames a second"),
        ("id,time,x,y\n1,0,0,0\n", {}, "in which unit its positions are (unit: m, cm or mm); p"),
        ('{"track": {"f": 1, "p": 1, "x": 0.5, "y": 0}}\n', {}, "how many frames a second"),
        (PETRACK + WALK, {"unit": "cm"}, "it has positions in m, and cm is given"),
        (PETRACK + WALK, {"fps": 30}, "it has 25 frames a second, and 30 is given"),
        (HEADER + "1,0,0,0\n", {"fps": 30}, "it has times, so no fps can be given"),
    ],
)
def test_unit_and_frame_rate_are_asked_for_and_not_guessed(write, text, given, told):
    assert told in refused(write(text), **given)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"unit": "ft"}, "unit 'ft': has to be one of m, cm, mm"),
        ({"fps": 0}, "fps 0: has to be a number above 0"),
        ({"fps": float("nan")}, "fps nan: has to be"),
    ],
)
def test_units_and_rates_that_do_not_exist_are_refused(write, given, told):
    with pytest.raises(RecordingError, match=told):
        read_recording(write(WALK), **given)


def test_a_frame_rate_that_velocities_contradict_is_refused(write):
    assert "it has 25 or 150 frames a second, and 30 is given" in refused(obsmat(write), fps=30)


def test_what_binary_kinds_say_is_not_overruled(write):
    assert "it has positions in m, and cm is given" in refused(hdf5(write), unit="cm")
    assert "it has 25 frames a second, and 16 is given" in refused(jupedsim(write), fps=16)


@pytest.mark.parametrize("make", [hdf5, jupedsim, trajnet, obsmat, petrack, csv_times])
def test_a_file_that_has_been_cut_off_is_refused(write, make):
    whole = make(write).read_bytes()
    refused(write(whole[: len(whole) // 2 - 4], "cut"))


def test_a_damaged_database_is_called_so(write):
    whole = jupedsim(write).read_bytes()
    assert refused(write(whole[:-4000], "cut")).startswith(": the database is damaged (")


def test_a_saved_recording_that_has_been_cut_off_is_refused(write, tmp_path):
    save(read_recording(petrack(write)), tmp_path / "walk.npz")
    whole = (tmp_path / "walk.npz").read_bytes()
    told = refused(write(whole[:-200], "cut.npz"))
    assert told.startswith(": damaged, or not from `crowdbench people --save`")


def test_a_saved_recording_that_nobody_can_unpack_is_refused(write, tmp_path):
    save(read_recording(petrack(write)), tmp_path / "walk.npz")
    archive = bytearray((tmp_path / "walk.npz").read_bytes())
    archive[archive.index(b"PK\x01\x02") + 10] = 99  # a method of compression that is not known
    told = refused(write(bytes(archive), "odd.npz"))
    assert told.startswith(": damaged, or not from `crowdbench people --save` (That compression")


@pytest.mark.parametrize(
    "arrays",
    [
        {"x": np.zeros(3)},
        {"people": np.array([{}], dtype=object)},
    ],
)
def test_other_npz_files_are_refused(tmp_path, arrays):
    np.savez(tmp_path / "other.npz", **arrays)
    assert "not from `crowdbench people --save`" in refused(tmp_path / "other.npz")


def test_hdf5_and_sqlite_of_others_are_refused(write, tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = [1.0]
    assert "does not contain a 'trajectory' dataset" in refused(tmp_path / "other.h5")
    database = sqlite3.connect(tmp_path / "other.sqlite")
    database.execute("CREATE TABLE a (b)")
    database.close()
    assert "not contain a 'trajectory_data' table" in refused(tmp_path / "other.sqlite")


def test_hdf5_with_a_room_that_is_none_is_refused_in_a_line(write):
    h5py = pytest.importorskip("h5py")
    path = hdf5(write)
    with h5py.File(path, "r+") as file:
        file.attrs["wkt_geometry"] = f"POLYGON (({', '.join(['0 0'] * 200)}"
    told = refused(path)
    assert told.startswith(": HDF5 of the Juelich archive that pedpy cannot read: Could not create")
    assert len(told) < 300


def test_hdf5_that_is_damaged_inside_is_refused(write):
    whole = bytearray(hdf5(write).read_bytes())
    version = whole.index(b"wkt_geometry") - 8  # of the message that has the room
    assert whole[version] in (1, 3)
    whole[version] = 9
    told = refused(write(bytes(whole), "b.h5"))
    assert told.startswith(": HDF5 of the Juelich archive that pedpy cannot read")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("UPDATE trajectory_data SET pos_x = NULL WHERE frame = 9", ": frame 9, person 3: time, x"),
        ("UPDATE trajectory_data SET frame = NULL WHERE frame = 9", ": frame nan is no whole"),
        ("UPDATE metadata SET value = 'x' WHERE key = 'fps'", ": SQLite of JuPedSim that pedpy"),
        ("UPDATE metadata SET value = 0 WHERE key = 'fps'", ": its frame rate is 0, and has to be"),
        ("DELETE FROM geometry", ": SQLite of JuPedSim that pedpy cannot read"),
    ],
)
def test_databases_with_what_cannot_be_are_refused(write, change, told):
    path = jupedsim(write)
    with sqlite3.connect(path) as database:
        database.execute(change)
    database.close()
    assert refused(path).startswith(told)


@pytest.mark.parametrize("missing", ["pedpy", "h5py"])
@pytest.mark.parametrize("make", [hdf5, jupedsim])
def test_without_the_extra_it_says_in_a_line_what_to_install(write, monkeypatch, make, missing):
    path = make(write)
    for name in [name for name in sys.modules if name.partition(".")[0] == "pedpy"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    told = ": this kind of recording needs pedpy: pip install 'crowdbench-nav[people]'"
    assert refused(path) == told
    with pytest.raises(ScenarioError) as refusal:
        crossing(path)
    assert str(refusal.value).endswith(f"pedestrians.recording: {path}{told}")
    assert "\n" not in str(refusal.value)


def test_a_file_that_is_not_there_is_named(tmp_path):
    assert "No such file" in refused(tmp_path / "nowhere.txt")
    assert refused(tmp_path) == ": not a file"
    assert refused(tmp_path / ("long" * 100)) == ": cannot be read (File name too long)"


def test_a_table_of_many_lines_names_the_first_that_is_wrong(write):
    text = f"id,frame,x,y\n{table(',')}4,7,oops,1\n5,7,oops,1\n"
    assert ": line 26: x 'oops' is no finite number" in refused(write(text), unit="m", fps=25)
