"""What a worker on a Ray node leaves behind."""

import os
import tempfile

from crowdbench.evaluation.ray_node import own_folder


def test_folders_of_workers_that_were_killed_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    folders, locks = zip(*(own_folder() for _ in "abc"), strict=True)
    killed, young, living = folders
    (killed / "agent.py").write_text("")
    for lock in locks[:2]:  # as the kernel does when a process ends
        os.close(lock)
    for old in (killed, living):
        os.utime(old, (0, 0))
    (tmp_path / "crowdbench-somebody").mkdir()
    new, lock = own_folder()
    assert set(tmp_path.iterdir()) == {young, living, new, tmp_path / "crowdbench-somebody"}
    os.close(lock)
    os.close(locks[2])
