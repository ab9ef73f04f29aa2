"""Saving and loading networks: safetensors with the configuration and a hash inside."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import safetensors
import torch
from crowdbench_agents.learning.config import Config, ConfigError, parse_config, with_present_names
from safetensors.torch import save
from torch import Tensor


class WeightsError(ValueError):
    """Weights that cannot be used; the message names the file and what is wrong with it."""


def save_weights(
    path: Path, tensors: dict[str, Tensor], config: Config, training: dict[str, Any], form: str
) -> None:
    """Write tensors atomically with all that is needed to check and use them.

    Args:
        path: the file, replaced only once it is complete.
        tensors: parameters by name.
        config: what they were trained with.
        training: how they came about (command, seeds, steps), free form.
        form: which networks these are; each kind has a name of its own.
    """
    tensors = {name: tensor.detach().contiguous() for name, tensor in tensors.items()}
    metadata = {
        "format": form,
        "config": config.model_dump_json(),
        "training": json.dumps(training),
        "sha256": tensor_digest(tensors),
    }
    part = path.with_name(path.name + ".part")
    part.write_bytes(save(tensors, metadata))
    part.replace(path)


def load_tensors(path: Path, form: str) -> tuple[dict[str, Tensor], Config, dict[str, Any]]:
    """Read tensors, their configuration and how they were trained.

    Raises:
        WeightsError: missing, damaged or of another kind.
    """
    config, training, digest = read_metadata(path, form)
    with _opened(path) as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    if digest != tensor_digest(tensors):
        raise WeightsError(f"weights {path} are damaged: their hash does not match their content")
    return tensors, config, training


def read_metadata(path: Path, form: str) -> tuple[Config, dict[str, Any], str | None]:
    """Read the configuration of tensors, how they were trained, and the hash of their content.

    Raises:
        WeightsError: missing, unreadable or of another kind.
    """
    if not path.is_file():
        raise WeightsError(f"weights {path} do not exist; `crowdbench train` makes them")
    with _opened(path) as file:
        metadata = file.metadata() or {}
    if metadata.get("format") != form:
        raise WeightsError(f"weights {path} are {metadata.get('format')!r}, expected {form!r}")
    try:
        stored = with_present_names(json.loads(metadata["config"]))
        config = parse_config(stored, source=f"configuration in {path}")
        training = json.loads(metadata["training"])
    except (KeyError, json.JSONDecodeError, ConfigError) as error:
        raise WeightsError(f"weights {path}: unusable metadata ({error})") from error
    return config, training, metadata.get("sha256")


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            yield file
    except Exception as error:  # the library raises its own type, OSError or ValueError
        raise WeightsError(f"weights {path} are damaged ({error})") from error


def fill(module: torch.nn.Module, tensors: dict[str, Tensor], path: Path) -> None:
    """Copy tensors into a module of exactly their names and shapes.

    Raises:
        WeightsError: names or shapes differ.
    """
    try:
        module.load_state_dict(tensors)
    except RuntimeError as error:
        raise WeightsError(f"weights {path} do not fit the networks: {error}") from error


def tensor_digest(tensors: dict[str, Tensor]) -> str:
    """Return the sha256 over names, types, shapes and contents."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(f"{name}:{tensor.dtype}:{tuple(tensor.shape)};".encode())
        content = tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8)
        digest.update(content.numpy().data)
    return digest.hexdigest()


def file_digest(path: Path) -> str:
    """Return the sha256 of a weights file, as stored with results."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
