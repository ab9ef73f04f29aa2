"""Recordings that pedpy reads: of the Juelich archive, as text or HDF5, and of JuPedSim."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd

from crowdbench.messages import brief
from crowdbench.people.cleaning import UNITS, Rows
from crowdbench.people.errors import RecordingError
from crowdbench.people.recording import FloatArray
from crowdbench.people.stated import Stated, settle
from crowdbench.people.table import require_numbers, require_whole_end, whole

PETRACK = {"id": 0, "frame": 1, "x": 2, "y": 3}
"""Where the columns of that text are; height or more may follow."""

_DAMAGE = (
    OSError, LookupError, ValueError, TypeError, AttributeError, RuntimeError
)  # fmt: skip


def read_petrack(path: Path, given: Stated) -> Rows:
    """Text with the columns id, frame, x, y, and comments that may say unit and frame rate.

    Raises:
        RecordingError: see ``read_recording``.
    """
    pedpy = _pedpy(path)
    require_whole_end(path)
    unit, fps = settle(path, petrack_header(path), given)
    assert unit is not None and fps is not None
    known = pedpy.TrajectoryUnit.CENTIMETER if unit == "cm" else pedpy.TrajectoryUnit.METER
    try:
        data = pedpy.load_trajectory(
            trajectory_file=path, default_frame_rate=fps, default_unit=known
        )
    except OverflowError as error:
        raise RecordingError(f"{path}: an id or frame is 2^63 or more") from error
    except (ValueError, TypeError) as error:
        require_numbers(path, PETRACK, None)
        raise RecordingError(f"{path}: {brief(error)}") from error
    table = data.data[["id", "frame", "x", "y"]]
    if table[["x", "y"]].isna().to_numpy().any():
        require_numbers(path, PETRACK, None)
    if unit == "mm":  # which pedpy does not know
        table = table.assign(x=table["x"] / UNITS["mm"], y=table["y"] / UNITS["mm"])
    return _rows(path, f"PeTrack text in {unit}", table, float(data.frame_rate), (), unit)


def petrack_header(path: Path) -> Stated:
    """What the comments say that such a text begins with."""
    unit = fps = None
    with path.open(encoding="utf-8-sig") as file:
        for line in file:
            if not line.startswith("#"):
                break
            rate = re.search(r"framerate\D*?(\d+(?:\.\d+)?)", line)
            fps = float(rate[1]) if rate and fps is None else fps
            named = re.search(r"(?:\bx/|\bin )(mm|cm|m)\b", line.lower())
            unit = named[1] if named else unit
    return Stated(unit, fps)


def read_hdf5(path: Path, given: Stated) -> Rows:
    """HDF5 of the archive: metres, with the frame rate and often the geometry.

    Raises:
        RecordingError: see ``read_recording``.
    """
    pedpy = _pedpy(path)
    import h5py

    def walls() -> Any:
        with h5py.File(path) as file:
            there = "wkt_geometry" in file.attrs
        return (
            pedpy.load_walkable_area_from_ped_data_archive_hdf5(trajectory_file=path)
            if there
            else None
        )

    load = pedpy.load_trajectory_from_ped_data_archive_hdf5
    return _binary(path, "HDF5 of the Juelich archive", load, walls, given)


def read_jupedsim(path: Path, given: Stated) -> Rows:
    """SQLite of JuPedSim: metres, with frame rate and geometry.

    Raises:
        RecordingError: see ``read_recording``.
    """
    pedpy = _pedpy(path)

    def walls() -> Any:
        return pedpy.load_walkable_area_from_jupedsim_sqlite(trajectory_file=path)

    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
        try:
            (state,) = database.execute("PRAGMA quick_check(1)").fetchone()
        except sqlite3.DatabaseError as error:
            state = str(error)
    if state != "ok":
        raise RecordingError(f"{path}: the database is damaged ({' '.join(state.split())})")
    load = pedpy.load_trajectory_from_jupedsim_sqlite
    return _binary(path, "SQLite of JuPedSim", load, walls, given)


def _binary(
    path: Path,
    kind: str,
    load: Callable[..., Any],
    walls: Callable[[], Any],
    given: Stated,
) -> Rows:
    from pedpy.errors import PedPyError

    try:
        data = load(trajectory_file=path)
        area, fps = walls(), float(data.frame_rate)
        table = data.data[["id", "frame", "x", "y"]].astype("float64")
    except (PedPyError, *_DAMAGE) as error:
        told = brief(error)
        raise RecordingError(f"{path}: {kind} that pedpy cannot read: {told}") from error
    settle(path, Stated("m", fps), given)
    lines = () if area is None else _lines(area.polygon)
    return _rows(path, kind, table, fps, lines)


def _rows(
    path: Path,
    kind: str,
    table: pd.DataFrame,
    fps: float,
    walls: tuple[FloatArray, ...] = (),
    unit: str = "m",
) -> Rows:
    """Rows of a table with the columns id, frame, and x and y in metres."""
    frames = whole(path, table["frame"], "frame")
    return Rows(
        f"{kind}, {fps:g} frames a second",
        whole(path, table["id"], "id"),
        frames / fps,
        table[["x", "y"]].to_numpy(),
        frames,
        walls,
        unit,
    )


def _lines(polygon: Any) -> tuple[FloatArray, ...]:
    """Outline and holes of a polygon of shapely, each (K, 2), the last point as the first."""
    rings = [polygon.exterior, *polygon.interiors]
    return tuple(np.asarray(ring.coords, dtype=np.float64)[:, :2] for ring in rings)


def _pedpy(path: Path) -> ModuleType:
    try:
        import pedpy
    except ImportError as error:
        raise RecordingError(
            f"{path}: this kind of recording needs pedpy: pip install 'crowdbench-nav[people]'"
        ) from error
    found: ModuleType = pedpy
    return found
