"""Saving and loading networks: safetensors with the configuration and a hash inside."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import safetensors
import torch
from crowdbench_agents.learning.config import Config, parse_config, with_present_names
from safetensors.torch import save
from torch import Tensor

from crowdbench.messages import short
from crowdbench.replacing import replacing

Network = TypeVar("Network", bound=torch.nn.Module)


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

    Raises:
        OSError: it cannot be written.
    """
    tensors = {name: tensor.detach().contiguous() for name, tensor in tensors.items()}
    metadata = {
        "format": form,
        "config": config.model_dump_json(),
        "training": json.dumps(training),
        "sha256": tensor_digest(tensors),
    }
    with replacing(path) as part:
        part.write_bytes(save(tensors, metadata))


def load_network(
    path: Path, form: str, make: Callable[[Config], Network]
) -> tuple[Network, Config, dict[str, Any]]:
    """Make a network from a weights file, ready for use (no gradients).

    Args:
        path: the file.
        form: which networks it has to be of.
        make: the network of a configuration, whatever its parameters.

    Returns:
        The network, its configuration, and how it was trained.

    Raises:
        WeightsError: missing, damaged, of another kind, or with tensors that do not fit or are
            not finite; the message names the file and the tensor.
    """
    config, training, digest = _read_metadata(path, form)
    with _opened(path) as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    try:
        with torch.device("meta"):  # without memory: what a foreign file asks for may be endless
            expected = make(config).state_dict()
    except (RuntimeError, ValueError, TypeError, OverflowError) as error:
        raise WeightsError(
            f"weights {path}: no network has the sizes in their configuration ({short(error)})"
        ) from error
    if problem := misfit(tensors, expected):
        raise WeightsError(f"weights {path} do not fit the networks: {problem}")
    if digest != tensor_digest(tensors):
        raise WeightsError(f"weights {path} are damaged: their hash does not match their content")
    with torch.random.fork_rng(devices=[]):  # networks are made with random parameters
        network = make(config)
    network.load_state_dict(tensors)
    return network.eval().requires_grad_(False), config, training


def misfit(found: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> str | None:
    """Why tensors cannot take the place of others: the first that is wrong, by name.

    Names, shapes and types have to be the same, and values finite.
    """
    for name in expected:
        if name not in found:
            return f"tensor {name!r} is missing"
    for name, tensor in found.items():
        if name not in expected:
            return f"tensor {short(name)} is not one of them"
        wanted = expected[name]
        if tensor.shape != wanted.shape:
            return f"tensor {name!r} has shape {tuple(tensor.shape)}, not {tuple(wanted.shape)}"
        if tensor.dtype != wanted.dtype:
            return f"tensor {name!r} is of {tensor.dtype}, not {wanted.dtype}"
        if not torch.isfinite(tensor).all():
            return f"tensor {name!r} has values that are not finite"
    return None


def _read_metadata(path: Path, form: str) -> tuple[Config, dict[str, Any], str | None]:
    """The configuration of tensors, how they were trained, and the hash of their content."""
    if not path.is_file():
        raise WeightsError(f"weights {path} do not exist; `crowdbench train` makes them")
    with _opened(path) as file:
        metadata = file.metadata() or {}
    if metadata.get("format") != form:
        found = short(metadata["format"]) if "format" in metadata else "of no format that is known"
        raise WeightsError(f"weights {path} are {found}, expected {form!r}")
    try:
        stored = with_present_names(_json_object(metadata, "config"))
        config = parse_config(stored, source="their configuration")
        training = _json_object(metadata, "training")
    except (ValueError, RecursionError) as error:
        raise WeightsError(f"weights {path}: unusable metadata ({error})") from error
    return config, training, metadata.get("sha256")


def _json_object(metadata: Mapping[str, str], key: str) -> dict[str, Any]:
    value = json.loads(metadata.get(key, "null"))
    if not isinstance(value, dict):
        raise ValueError(f"{key!r} is missing or no JSON object")
    return value


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            yield file
    except Exception as error:  # the library raises its own type, OSError or ValueError
        raise WeightsError(f"weights {path} are damaged ({error})") from error


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
