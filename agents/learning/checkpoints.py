"""A run's folder and its checkpoint: written atomically, tied to scenarios, kept to one process."""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.sampler import scenario_digests
from crowdbench_agents.learning.weights import tensor_digest
from torch import Tensor

from crowdbench.messages import short


def save_checkpoint(
    folder: Path, state: Mapping[str, Any], digests: Mapping[str, str], form: str
) -> None:
    """Write a run's checkpoint atomically.

    Args:
        folder: of the run.
        state: what ``load_checkpoint`` will return: tensors, numbers and text.
        digests: of the scenarios that the run trains in, by name.
        form: which networks are trained, as in ``save_weights``.

    Raises:
        TrainingError: no room on the disk.
    """
    part = folder / "checkpoint.part"
    content = {"form": form, "scenarios": dict(digests), "state": dict(state)}
    try:
        torch.save(content | {"sha256": _digest(content)}, part)
        part.replace(folder / "checkpoint.pt")
    except (OSError, RuntimeError) as error:
        raise TrainingError(
            f"{part}: the checkpoint could not be written ({error}); make room on the disk "
            "and resume: the previous checkpoint is intact"
        ) from error


def load_checkpoint(folder: Path, form: str) -> dict[str, Any]:
    """Read a run's checkpoint.

    Raises:
        TrainingError: unreadable, damaged, of an earlier version or other networks, with numbers
            that are not finite, or a scenario of the run is no longer what it was.
    """
    path = folder / "checkpoint.pt"
    try:
        content = torch.load(path, weights_only=True)
    except Exception as error:  # of the zip reader, of the unpickler, or an OSError
        raise TrainingError(f"{path}: cannot be read ({short(str(error))})") from error
    if not isinstance(content, dict) or content.keys() != {"form", "scenarios", "state", "sha256"}:
        raise TrainingError(
            f"{path}: no checkpoint, or one of an earlier version of crowdbench; train under a "
            "new name"
        )
    for name, value in _leaves(content["state"]):
        if isinstance(value, Tensor) and not torch.isfinite(value).all():
            raise TrainingError(f"{path}: tensor {name!r} has values that are not finite")
    if content.pop("sha256") != _digest(content):
        raise TrainingError(f"{path}: damaged: its hash does not match its content")
    if content["form"] != form:
        raise TrainingError(f"{path}: is of {content['form']!r} networks, expected {form!r}")
    then = content["scenarios"]
    now = scenario_digests(then)
    changed = [
        f"{name} (then {then[name]}, now {now[name]})" for name in then if then[name] != now[name]
    ]
    if changed:
        raise TrainingError(
            f"{path}: scenarios have changed since this run was saved: {', '.join(changed)}; "
            "train under a new name"
        )
    state: dict[str, Any] = content["state"]
    return state


def require_fitting(folder: Path, found: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    """Make sure that a checkpoint's state fits a run: the same names, and tensors of the same form.

    Args:
        folder: of the run.
        found: what ``load_checkpoint`` returned.
        expected: the state of a run that has just begun; where it has an empty mapping, as
            optimisers do, nothing is expected.

    Raises:
        TrainingError: the message names the tensor.
    """
    there, wanted = dict(_leaves(found)), dict(_leaves(expected))
    for name, value in wanted.items():
        if name not in there:
            problem = "is missing"
        elif _form(there[name]) != _form(value):
            problem = f"is {_form(there[name])}, not {_form(value)}"
        else:
            continue
        raise TrainingError(
            f"{folder / 'checkpoint.pt'}: does not fit this configuration: {name!r} {problem}; "
            "resume with the settings it was begun with"
        )


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Everything within mappings and lists, by its dotted name."""
    if not isinstance(value, Mapping | list | tuple):
        yield name, value
        return
    for key, item in value.items() if isinstance(value, Mapping) else enumerate(value):
        yield from _leaves(item, f"{name}.{key}" if name else str(key))


def _form(value: Any) -> str:
    if not isinstance(value, Tensor):
        return "no tensor"
    return f"a tensor of {value.dtype} and shape {tuple(value.shape)}"


def _digest(content: Mapping[str, Any]) -> str:
    """The sha256 over names and values; the file's own checksums are not looked at when read."""
    digest = hashlib.sha256()
    for name, value in _leaves(content):
        told = tensor_digest({name: value}) if isinstance(value, Tensor) else f"{name}={value!r};"
        digest.update(told.encode())
    return digest.hexdigest()


def run_name(name: str) -> str:
    """The name of a run, which is that of its folder and its curve, if it can be one.

    Raises:
        TrainingError: it cannot.
    """
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}", name):
        raise TrainingError(
            f"name {short(name)}: expected 1 to 100 letters, digits and _.-, the first of them a "
            "letter, digit or _"
        )
    return name


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
