"""Recordings that pedpy reads: HDF5 of the Juelich archive, and SQLite of JuPedSim."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd

from crowdbench.messages import brief
from crowdbench.people.cleaning import Rows
from crowdbench.people.errors import RecordingError
from crowdbench.people.recording import FloatArray
from crowdbench.people.stated import Stated, settle
from crowdbench.people.table import whole

_DAMAGE = (
    OSError, LookupError, ValueError, TypeError, AttributeError, RuntimeError
)  # fmt: skip


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
    walls: tuple[FloatArray, ...],
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
