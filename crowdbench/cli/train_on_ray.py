"""``crowdbench train --executor ray``: each run is a task on a node of a Ray cluster.

A run is trained in a folder of its own there, and what it leaves is brought here: everything in its
folder but what is in folders below it, as a replay is, and its curve. To be resumed it is sent the
same. A node that dies costs the run that it was training, which Ray begins anew on another one.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from crowdbench.cli.common import UserError
from crowdbench.cli.trainers import CURVES, RUNS, Trainer
from crowdbench.evaluation.ray_cluster import connect, import_ray, reason_of

Files = dict[str, bytes]


def train_on_ray(
    trainer: str, runs: Sequence[Mapping[str, Any]], address: str | None
) -> Iterator[tuple[str, str]]:
    """Train, and yield each run's name as it ends and its files are here, with its error or "".

    Args:
        trainer: name of the trainer.
        runs: the arguments of each; ``actors`` and ``device`` say what a run needs of a node.
        address: of the cluster; by default ``RAY_ADDRESS``, else Ray is started on this machine.

    Raises:
        ExecutorError: Ray is missing, or there is no cluster.
        UserError: a run is in the way, or no node is large enough.
    """
    ray = import_ray()
    for run in runs:
        if not run["resume"] and any((RUNS / run["name"]).glob("*")):
            raise UserError(
                f"{RUNS / run['name']} holds a run; resume it, or remove or rename the folder"
            )
    connect(address)
    try:
        needed = {
            "num_cpus": 1 + runs[0].get("actors", 0),
            "num_gpus": int(runs[0].get("device") == "cuda"),
        }
        _require_room(ray, needed["num_cpus"])
        there = ray.remote(**needed)(_train)
        release = version("crowdbench-nav")
        names = {
            there.remote(trainer, run, _files(Path(), run["name"]), release): run["name"]
            for run in runs
        }
        while names:
            (ready, *_), _ = ray.wait(list(names))
            name = names.pop(ready)
            try:
                files, error = ray.get(ready)
            except ray.exceptions.RayError as lost:
                yield name, reason_of(lost)
                continue
            _write(Path(), files)
            yield name, error
    finally:
        ray.shutdown()


def _train(
    trainer: str, arguments: Mapping[str, Any], files: Files, release: str
) -> tuple[Files, str]:
    """Train once, on a node; the files that the run leaves, and its error."""
    here = version("crowdbench-nav")
    if here != release:
        return {}, f"a node has crowdbench {here}, not {release}; install the same version on all"
    before = Path.cwd()
    with tempfile.TemporaryDirectory(prefix="crowdbench-train-") as folder:
        os.chdir(folder)
        try:
            _write(Path(), files)
            Trainer(trainer).train(arguments)
            error = ""
        except UserError as problem:
            error = str(problem)
        finally:
            left = _files(Path(folder), arguments["name"])
            os.chdir(before)
    return left, error


def _files(root: Path, name: str) -> Files:
    """What a run has left below a folder, by relative paths."""
    found = [*(root / RUNS / name).glob("*"), *(root / CURVES).glob(f"{name}.csv")]
    return {str(path.relative_to(root)): path.read_bytes() for path in found if path.is_file()}


def _write(root: Path, files: Files) -> None:
    for name, content in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f"{path.name}.part")
        part.write_bytes(content)
        part.replace(path)


def _require_room(ray: Any, processors: int) -> None:
    largest = max((node["Resources"].get("CPU", 0) for node in ray.nodes()), default=0)
    if largest < processors:
        raise UserError(
            f"a run needs {processors} processors of one node, and the largest has {largest:g}; "
            "use fewer --actors"
        )
