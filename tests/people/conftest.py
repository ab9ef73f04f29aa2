"""Small recordings, and the folder of real ones where there is one."""

import os
from pathlib import Path

import numpy as np
import pytest

from crowdbench.people.cleaning import Rows, clean

VARIABLE = "CROWDBENCH_RECORDINGS"


@pytest.fixture
def recordings():
    folder = os.environ.get(VARIABLE)
    if folder is None:
        pytest.skip(f"{VARIABLE} names no folder with recordings")
    return Path(folder)


@pytest.fixture
def write(tmp_path):
    """Write a file and give its path."""

    def write(text, name="walk.txt"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


@pytest.fixture
def cleaned():
    """Clean rows (id, frame, x, y) of some frames a second."""

    def cleaned(rows, fps=10.0, **other):
        table = np.array(rows, dtype=float)
        ids, frames = table[:, 0].astype(int), table[:, 1].astype(int)
        return clean(
            Path("walk.csv"), Rows("test", ids, frames / fps, table[:, 2:], frames, **other)
        )

    return cleaned
