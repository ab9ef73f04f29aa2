"""``crowdbench train --executor ray``: each run is a task on a node of a Ray cluster.

A run is trained in a folder of its own there, and what it leaves is brought here: everything in its
folder but what is in folders below it, as a replay is, and its curve. To be resumed it is sent the
same. A node that dies costs the run that it was training, which Ray begins anew on another one.
Where none is left, what has ended stays.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from crowdbench.cli.common import UserError
from crowdbench.cli.trainers import CURVES, RUNS, Trainer
from crowdbench.evaluation.executors import ExecutorError
from crowdbench.evaluation.ray_cluster import LOOK, WITHOUT_NODES, connect, import_ray, reason_of
from crowdbench.replacing import replacing

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
        ExecutorError: Ray is missing, there is no cluster, or it has lost all nodes.
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
        _require_room(ray, **needed)
        there = ray.remote(**needed)(_train)
        release = version("crowdbench-nav")
        names = {
            there.remote(trainer, run, _files(Path(), run["name"]), release): run["name"]
            for run in runs
        }
        room = time.monotonic()
        while names:
            ready, _ = ray.wait(list(names), timeout=LOOK)
            if not ready:
                room = _watch_room(ray, room, **needed)
                continue
            name = names.pop(ready[0])
            try:
                files, error = ray.get(ready[0])
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
        with replacing(path) as part:
            part.write_bytes(content)


def _require_room(ray: Any, num_cpus: int, num_gpus: int) -> None:
    if not _has_room(ray, num_cpus, num_gpus):
        more = (" and a GPU", " or --device cpu") if num_gpus else ("", "")
        raise UserError(
            f"a run needs {num_cpus} processors{more[0]} of one node, and no node has that; "
            f"use fewer --actors{more[1]}"
        )


def _watch_room(ray: Any, last: float, num_cpus: int, num_gpus: int) -> float:
    """When a run last had a node that it fits on, given when it had before.

    Raises:
        ExecutorError: that is too long ago.
    """
    now = time.monotonic()
    if _has_room(ray, num_cpus, num_gpus):
        return now
    if now - last > WITHOUT_NODES:
        raise ExecutorError(
            f"the Ray cluster has had no node for a run for {WITHOUT_NODES:g} s; runs that have "
            "ended are here, train the others again"
        )
    return last


def _has_room(ray: Any, num_cpus: int, num_gpus: int) -> bool:
    """Whether a node of the cluster is large enough for a run."""
    return any(
        node["Resources"].get("CPU", 0) >= num_cpus and node["Resources"].get("GPU", 0) >= num_gpus
        for node in ray.nodes()
        if node["Alive"]
    )
