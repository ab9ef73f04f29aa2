"""Where rows are exported to."""

import os
import stat

import pytest

from crowdbench.cli import main


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_what_is_not_a_file_is_not_replaced_by_one(episodes, tmp_path, capsys, make):
    episodes.add("orca", success=[1.0])
    make(tmp_path / "place")
    before = (tmp_path / "place").stat()
    arguments = ["export", "--results", str(tmp_path), "--output", str(tmp_path / "place")]
    assert main(arguments) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "place: not a file, so nothing is put in its place" in told
    after = (tmp_path / "place").stat()
    assert (after.st_ino, stat.S_IFMT(after.st_mode)) == (
        before.st_ino, stat.S_IFMT(before.st_mode)
    )  # fmt: skip
