"""A run's folder and its checkpoint: written atomically, tied to scenarios, kept to one process."""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import safetensors
import torch
from crowdbench_agents.learning.errors import TrainingError, to_disk
from crowdbench_agents.learning.weights import tensor_digest
from safetensors.torch import save
from torch import Tensor

from crowdbench.messages import short
from crowdbench.replacing import replacing

CHECKPOINT = "checkpoint.safetensors"
FORMAT = "crowdbench-checkpoint-2"
MOST_CHANGED = 3
"""Scenarios to be named that a run cannot go on in."""


class Checkpoint(NamedTuple):
    """What a run goes on from.

    Attributes:
        state: mappings and lists of tensors, numbers and text.
        scenarios: digests of those that the run trains in, by name.
    """

    state: dict[str, Any]
    scenarios: dict[str, str]


def save_checkpoint(
    folder: Path, state: Mapping[str, Any], digests: Mapping[str, str], form: str
) -> None:
    """Write a run's checkpoint atomically, unless there is something wrong with it.

    Args:
        folder: of the run.
        state: what ``load_checkpoint`` will return: mappings and lists of tensors, numbers and
            text.
        digests: of the scenarios that the run trains in, by name.
        form: which networks are trained, as in ``save_weights``.

    Raises:
        TrainingError: numbers that are not finite, or no room on the disk; the checkpoint that was
            there still is.
    """
    path = folder / CHECKPOINT
    if name := _not_finite(state):
        raise TrainingError(
            f"{path}: not written, since {name!r} has values that are not finite; the previous "
            "checkpoint is intact: lower the learning rates and resume"
        )
    tensors: dict[str, Tensor] = {}
    content = json.dumps(
        {"form": form, "scenarios": dict(digests), "state": _outline(state, "", tensors)}
    )
    metadata = {"format": FORMAT, "content": content, "sha256": _digest(content, tensors)}
    with to_disk(path, "resume: the previous checkpoint is intact"), replacing(path) as part:
        part.write_bytes(save(tensors, metadata))


def load_checkpoint(folder: Path, form: str) -> Checkpoint:
    """Read a run's checkpoint.

    Args:
        folder: of the run.
        form: of its networks.

    Raises:
        TrainingError: unreadable, damaged, of an earlier version or other networks, or with numbers
            that are not finite.
    """
    path = folder / CHECKPOINT
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except Exception as error:  # the library raises its own type, OSError or ValueError
        raise TrainingError(f"{path}: cannot be read ({short(str(error))})") from error
    if metadata.get("format") != FORMAT:
        raise TrainingError(
            f"{path}: no checkpoint, or one of another version of crowdbench; train under a "
            "new name"
        )
    if metadata.get("sha256") != _digest(metadata.get("content", ""), tensors):
        raise TrainingError(f"{path}: damaged: its hash does not match its content")
    content = json.loads(metadata["content"])
    state: dict[str, Any] = _filled(content["state"], tensors)
    if name := _not_finite(state):
        raise TrainingError(f"{path}: {name!r} has values that are not finite")
    if content["form"] != form:
        raise TrainingError(f"{path}: is of {content['form']!r} networks, expected {form!r}")
    return Checkpoint(state, content["scenarios"])


def require_same_scenarios(folder: Path, then: Mapping[str, str], now: Mapping[str, str]) -> None:
    """Make sure that a run goes on in the scenarios that it was begun in.

    Args:
        folder: of the run.
        then: digests of those of its checkpoint, by name.
        now: of those that are trained in now; others may have been added.

    Raises:
        TrainingError: the message names those that are no longer what they were.
    """
    changed = [
        f"{name} (then {digest}, now {now.get(name, 'none')})"
        for name, digest in then.items()
        if digest != now.get(name)
    ]
    if changed:
        more = f" and {len(changed) - MOST_CHANGED} more" if len(changed) > MOST_CHANGED else ""
        raise TrainingError(
            f"{folder / CHECKPOINT}: the run's scenarios are other ones now: "
            f"{', '.join(changed[:MOST_CHANGED])}{more}; resume with the training.tiers and "
            "training.variants that it was begun with, or train under a new name"
        )


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
            f"{folder / CHECKPOINT}: does not fit this configuration: {name!r} {problem}; "
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


def _outline(value: Any, name: str, tensors: dict[str, Tensor]) -> Any:
    """What JSON can hold of a state; the tensors go into ``tensors`` by their dotted names.

    Mappings become lists of pairs, since the keys of an optimiser's state are numbers.
    """
    if isinstance(value, Tensor):
        tensors[name] = value.detach().cpu().contiguous()
        return {"tensor": name}
    inside = f"{name}." if name else ""
    if isinstance(value, Mapping):
        pairs = [[key, _outline(item, f"{inside}{key}", tensors)] for key, item in value.items()]
        return {"mapping": pairs}
    if isinstance(value, list | tuple):
        return [_outline(item, f"{inside}{place}", tensors) for place, item in enumerate(value)]
    return value


def _filled(outline: Any, tensors: Mapping[str, Tensor]) -> Any:
    """The state that ``_outline`` was made of, tuples as lists."""
    if isinstance(outline, list):
        return [_filled(item, tensors) for item in outline]
    if not isinstance(outline, Mapping):
        return outline
    if "tensor" in outline:
        return tensors[outline["tensor"]]
    return {key: _filled(item, tensors) for key, item in outline["mapping"]}


def _not_finite(state: Mapping[str, Any]) -> str | None:
    """The name of a number or tensor with values that are not finite."""
    for name, value in _leaves(state):
        if isinstance(value, Tensor) and not torch.isfinite(value).all():
            return name
        if isinstance(value, float) and not math.isfinite(value):
            return name
    return None


def _digest(content: str, tensors: dict[str, Tensor]) -> str:
    """The sha256 of all that counts; the file itself is not checked when it is read."""
    return hashlib.sha256((content + tensor_digest(tensors)).encode()).hexdigest()


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

    A run that begins finds no replay of one that ended before its first checkpoint.

    Raises:
        TrainingError: there is a run and ``resume`` is not asked for, or the reverse, another
            process is training it, or the folder cannot be written to.
    """
    there = (folder / CHECKPOINT).is_file()
    if resume and not there:
        raise TrainingError(f"nothing to resume: {folder / CHECKPOINT} does not exist")
    if not resume and there:
        raise TrainingError(f"{folder} holds a run; resume it, or remove or rename the folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC)
    except OSError as error:
        raise TrainingError(f"{folder}: cannot be written to ({error})") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise TrainingError(f"{folder}: another process is training this run") from None
    try:
        if not resume and (folder / "replay").exists():
            shutil.rmtree(folder / "replay")
        yield
    finally:
        os.close(lock)
