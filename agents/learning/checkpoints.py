"""A run's folder and its checkpoint: written atomically, tied to scenarios, kept to one process."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.sampler import scenario_digests


def save_checkpoint(folder: Path, state: Mapping[str, Any], digests: Mapping[str, str]) -> None:
    """Write a run's checkpoint atomically.

    Args:
        folder: of the run.
        state: what ``load_checkpoint`` will return: tensors, numbers and text.
        digests: of the scenarios that the run trains in, by name.

    Raises:
        TrainingError: no room on the disk.
    """
    part = folder / "checkpoint.part"
    try:
        torch.save({"scenarios": dict(digests), **state}, part)
        part.replace(folder / "checkpoint.pt")
    except (OSError, RuntimeError) as error:
        raise TrainingError(
            f"{part}: the checkpoint could not be written ({error}); make room on the disk "
            "and resume: the previous checkpoint is intact"
        ) from error


def load_checkpoint(folder: Path) -> dict[str, Any]:
    """Read a run's checkpoint.

    Raises:
        TrainingError: unreadable, of an earlier version, or a scenario of the run is no longer
            what it was.
    """
    path = folder / "checkpoint.pt"
    try:
        state = torch.load(path, weights_only=True)
    except Exception as error:  # of the zip reader, of the unpickler, or an OSError
        raise TrainingError(f"{path}: cannot be read ({error})") from error
    if "scenarios" not in state:
        raise TrainingError(
            f"{path}: written by an earlier version of crowdbench, which did not say in which "
            "scenarios it trained; train under a new name"
        )
    then = state.pop("scenarios")
    now = scenario_digests(then)
    changed = [
        f"{name} (then {then[name]}, now {now[name]})" for name in then if then[name] != now[name]
    ]
    if changed:
        raise TrainingError(
            f"{path}: scenarios have changed since this run was saved: {', '.join(changed)}; "
            "train under a new name"
        )
    return state


@contextmanager
def run_folder(folder: Path, resume: bool) -> Iterator[None]:
    """Make a run's folder and keep other processes out of it.

    Raises:
        TrainingError: there is a run and ``resume`` is not asked for, or the reverse, or another
            process is training it.
    """
    there = (folder / "checkpoint.pt").is_file()
    if resume and not there:
        raise TrainingError(f"nothing to resume: {folder / 'checkpoint.pt'} does not exist")
    if not resume and there:
        raise TrainingError(f"{folder} holds a run; resume it, or remove or rename the folder")
    folder.mkdir(parents=True, exist_ok=True)
    lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise TrainingError(f"{folder}: another process is training this run") from None
    try:
        yield
    finally:
        os.close(lock)
