"""The same walk of two people as a file of each kind that is read."""

import json
import sqlite3

import numpy as np
import pytest

IDS = np.repeat([3, 8], 12)
FRAMES = np.concatenate([np.arange(5, 17), np.arange(9, 21)])
POSITIONS = np.column_stack([0.04 * FRAMES + 0.001 * IDS, 0.5 * IDS - 0.02 * FRAMES])
ROOM = "POLYGON ((-1 -1, 9 -1, 9 9, -1 9, -1 -1), (2 2, 3 2, 3 3, 2 3, 2 2))"


def table(separator, scale=1.0, time=False, height=()):
    rows = zip(IDS, FRAMES, POSITIONS * scale, strict=True)
    return "".join(
        separator.join([str(i), str(f / 25 if time else f), *(f"{v:.9g}" for v in p), *height])
        + "\n"
        for i, f, p in rows
    )


def petrack(write):
    return write(f"# framerate: 25 fps\n# id frame x/m y/m z/m\n{table(' ', 1, height=['1.7'])}")


def petrack_centimetres(write):
    return write(f"# framerate: 25.00\n# ID frame X/cm Y/cm\n{table(chr(9), 100)}")


def csv_frames(write):
    return write(f"person,frame,x,y\n{table(',', 1)}")


def csv_times(write):
    return write(f"\ufeff# a tracker\nID; Time [s]; X [mm]; Y [mm]\n{table(';', 1000, time=True)}")


def csv_more_columns(write):
    body = "".join(f"{line},standing\n" for line in table(",", 100).splitlines())
    return write(f"track_id,frame_number,x_cm,y_cm,state\n{body}")


def trajnet(write):
    rows = [
        {"track": {"f": int(f) * 10, "p": int(i), "x": x, "y": y}}
        for i, f, (x, y) in zip(IDS, FRAMES, POSITIONS.tolist(), strict=True)
    ]
    scene = {"scene": {"id": 0, "p": 3, "s": 50, "e": 200, "fps": 25.0, "tag": [1, []]}}
    return write("".join(json.dumps(entry) + "\n" for entry in [scene, *rows]))


def obsmat(write):
    return write(obsmat_text())


def obsmat_text(seconds=0.04, wrong=1.0):
    velocity = np.array([1.0, -0.5]) * 0.04 / seconds * wrong
    rows = np.column_stack(
        [6 * FRAMES, IDS, POSITIONS[:, 0], 0 * IDS, POSITIONS[:, 1],
         np.full(24, velocity[0]), 0 * IDS, np.full(24, velocity[1])]
    )  # fmt: skip
    return "".join("   " + "   ".join(f"{v:.7e}" for v in row) + "\n" for row in rows)


def hdf5(write):
    h5py = pytest.importorskip("h5py")
    path = write(b"", "walk.h5")
    kinds = [("id", "i8"), ("frame", "i8"), ("x", "f8"), ("y", "f8"), ("z", "f8")]
    rows = np.zeros(len(IDS), kinds)
    rows["id"], rows["frame"], rows["x"], rows["y"] = IDS, FRAMES, *POSITIONS.T
    with h5py.File(path, "w") as file:
        file.create_dataset("trajectory", data=rows).attrs["fps"] = 25.0
        file.attrs["wkt_geometry"] = ROOM
    return path


def jupedsim(write):
    path = write(b"", "walk.sqlite")
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE trajectory_data (frame, id, pos_x, pos_y, ori_x, ori_y)")
        database.execute("CREATE TABLE metadata (key, value)")
        database.execute("CREATE TABLE geometry (hash, wkt)")
        rows = zip(FRAMES.tolist(), IDS.tolist(), *POSITIONS.T.tolist(), strict=True)
        database.executemany("INSERT INTO trajectory_data VALUES (?, ?, ?, ?, 1, 0)", rows)
        database.executemany("INSERT INTO metadata VALUES (?, ?)", [("version", 2), ("fps", 25.0)])
        database.execute("INSERT INTO geometry VALUES (1, ?)", (ROOM,))
    database.close()
    return path
