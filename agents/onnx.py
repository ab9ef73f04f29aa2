"""A policy from anywhere: a network in an ONNX file, evaluated by ONNX Runtime.

The network takes what it wants of an observation, by the names of its inputs, and gives the action.
Each may have a leading batch axis, of length 1 or without a fixed length.

============  ==============  =========  ==========================================================
input         shape           type       meaning
============  ==============  =========  ==========================================================
``lidar``     (beams,)        float32    as in ``crowdbench.Observation``
``velocity``  (2,)            float32    as in ``crowdbench.Observation``
``goal``      (2,)            float32    as in ``crowdbench.Observation``
``pose``      (3,)            float32    as in ``crowdbench.Observation``
``map``       (cells, cells)  uint8      the last eight scans as one obstacle map, see
                                         ``crowdbench.ObstacleMap``
============  ==============  =========  ==========================================================

With a ``map``, that, ``velocity`` and ``goal`` are as they will be when the action begins to act,
which matters where commands act late (``robots.latency``).

The output ``action`` (2,), float32, is what the robot's drive takes, for a differential one v [m/s]
and w [rad/s]; other outputs are ignored.

The file's metadata may hold two JSON objects: ``crowdbench.perception``, the map's ``cells``,
``size`` [m] and ``ahead`` [m], without which there is no map, and ``crowdbench.robot``, the robot
that the policy was trained with; whoever drives another one is warned. ``crowdbench export-onnx``
writes both.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from crowdbench_agents.geometry.under_way import CommandsUnderWay
from crowdbench_agents.learning.config import Perception
from crowdbench_agents.learning.trained_robot import TrainedRobot, warn_of_other_robot
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

import crowdbench
from crowdbench.messages import explain, setting, short

if TYPE_CHECKING:
    from onnxruntime import InferenceSession, NodeArg

PERCEPTION, ROBOT = "crowdbench.perception", "crowdbench.robot"
"""Keys of a file's metadata."""

_Shape = tuple[int | str, ...]
_INPUTS: dict[str, tuple[str, _Shape]] = {
    "lidar": ("float", ("beams",)),
    "velocity": ("float", (2,)),
    "goal": ("float", (2,)),
    "pose": ("float", (3,)),
    "map": ("uint8", ("cells", "cells")),
}
_ACTION: tuple[str, _Shape] = ("float", (2,))
_QUIET = 4  # ONNX Runtime's log level of what ends the process; errors are raised anyway

Model = TypeVar("Model", bound=BaseModel)


class Onnx(crowdbench.Agent):
    """Whatever policy an ONNX file holds."""

    drives = None
    version = "0.2.0"

    def __init__(self, file: str) -> None:
        """Load the network and make sure that it can be used.

        Args:
            file: path of the ONNX file; ``onnx:policy.onnx`` is enough.

        Raises:
            ValueError: no such file, not an ONNX model, inputs or an output that are not those
                above, or the extra ``onnx`` is not installed.
        """
        self._file = file
        try:
            content, self.weights_sha256 = _read(file)
            self._session = _session(file, content)
        except ImportError as error:
            raise ValueError(
                f"{error.name} is not installed: pip install 'crowdbench-nav[onnx]'"
            ) from error
        inputs = self._session.get_inputs()
        self._batched = {node.name: self._has_batch_axis(node) for node in inputs}
        self._shapes = {node.name: node.shape for node in inputs}
        self._check_output()
        metadata = self._session.get_modelmeta().custom_metadata_map
        self._perception = self._read_metadata(metadata, PERCEPTION, Perception)
        self._trained = self._read_metadata(metadata, ROBOT, TrainedRobot)
        if self._trained is not None:
            self.drives = (self._trained.drive,)
        self._check_map()
        self._map: crowdbench.ObstacleMap | None = None

    def reset(self, robot: crowdbench.RobotSpec, seed: int) -> None:
        """Forget the last episode; there is no randomness."""
        beams, found = len(robot.lidar_angles), self._shapes.get("lidar", [None])[-1]
        if isinstance(found, int) and found != beams:
            raise ValueError(
                f"{self._file}: input 'lidar' takes {found} beams, and the robot has {beams}"
            )
        if self._trained is not None:
            warn_of_other_robot(f"the policy in {self._file}", self._trained, robot)
        if self._perception is not None and "map" in self._shapes:
            geometry = self._perception.geometry
            self._map = crowdbench.ObstacleMap(robot, geometry)
        self._under_way = CommandsUnderWay(robot)

    def act(self, observation: crowdbench.Observation) -> crowdbench.Action:
        """Return the network's action."""
        seen: dict[str, NDArray[Any]] = {
            "lidar": observation.lidar,
            "velocity": observation.velocity,
            "goal": observation.goal,
            "pose": observation.pose,
        }
        if self._map is not None:
            ahead = self._under_way.foresee(observation)
            seen["map"] = self._map.update(observation.lidar, observation.pose, ahead.pose)
            seen["velocity"], seen["goal"] = ahead.velocity, ahead.goal
        given = {
            name: seen[name][None] if batched else seen[name]
            for name, batched in self._batched.items()
        }
        (action,) = self._session.run(["action"], given)
        if action.shape not in ((2,), (1, 2)):
            raise ValueError(f"{self._file}: output 'action' has the shape {action.shape}")
        return self._under_way.send(action.reshape(2))

    def _has_batch_axis(self, node: NodeArg) -> bool:
        if node.name not in _INPUTS:
            allowed = ", ".join(_INPUTS)
            raise ValueError(
                f"{self._file}: input {short(node.name)} is no part of an observation; "
                f"allowed: {allowed}"
            )
        kind, shape = _INPUTS[node.name]
        return self._check(f"input {node.name!r}", node, kind, shape)

    def _check_output(self) -> None:
        outputs = {node.name: node for node in self._session.get_outputs()}
        if "action" not in outputs:
            raise ValueError(
                f"{self._file}: expected an output 'action', found {short(', '.join(outputs))}"
            )
        self._check("output 'action'", outputs["action"], *_ACTION)

    def _check(self, what: str, node: NodeArg, kind: str, shape: _Shape) -> bool:
        """Make sure of type and shape; whether there is a batch axis."""
        found = list(node.shape)
        batched = len(found) == len(shape) + 1
        sizes = zip(found[batched:], shape, strict=False)
        fits = len(found) in (len(shape), len(shape) + 1) and all(
            not isinstance(size, int) or size == wanted or (isinstance(wanted, str) and size > 0)
            for size, wanted in sizes
        )
        if batched and isinstance(found[0], int):
            fits = fits and found[0] == 1
        if node.type != f"tensor({kind})" or not fits:
            raise ValueError(
                f"{self._file}: {what} is {short(node.type)} of shape {_text(found)}; allowed: "
                f"tensor({kind}) of shape {_text(shape)} or {_text((1, *shape))}"
            )
        return batched

    def _read_metadata(
        self, metadata: Mapping[str, str], key: str, model: type[Model]
    ) -> Model | None:
        if key not in metadata:
            return None
        try:
            return model.model_validate_json(metadata[key])
        except ValidationError as error:
            raise ValueError(f"{self._file}: metadata {key!r}: {explain(error, model)}") from error

    def _check_map(self) -> None:
        if "map" not in self._shapes:
            return
        if self._perception is None:
            raise ValueError(
                f"{self._file}: input 'map' needs the metadata {PERCEPTION!r}, a JSON object with "
                "cells, size [m] and ahead [m]"
            )
        cells, found = self._perception.cells, self._shapes["map"][-2:]
        if any(isinstance(size, int) and size != cells for size in found):
            raise ValueError(
                f"{self._file}: input 'map' has {_text(found)} cells, but the metadata "
                f"{PERCEPTION!r} says {cells}"
            )


def _read(file: str) -> tuple[bytes, str]:
    """The model with its weights, which may lie in files beside it, and the hash of both."""
    import onnx
    from onnx.external_data_helper import load_external_data_for_model, uses_external_data

    if not isinstance(file, str):
        raise ValueError(f"file: expected the name of an ONNX file, got {setting(file)}")
    try:
        content = Path(file).read_bytes()
    except OSError as error:
        raise ValueError(f"ONNX file {short(file)}: {error.strerror}") from error
    digest = hashlib.sha256(content)
    try:
        model = onnx.load_model_from_string(content)
        beside = [tensor for tensor in model.graph.initializer if uses_external_data(tensor)]
        load_external_data_for_model(model, str(Path(file).parent))
    except Exception as error:  # the libraries' own types have no common base
        raise ValueError(f"{file}: not an ONNX model ({short(str(error))})") from error
    for tensor in beside:
        digest.update(tensor.raw_data)
    return model.SerializeToString() if beside else content, digest.hexdigest()


def _session(file: str, content: bytes) -> InferenceSession:
    """One thread, so that an action depends on nothing but what is observed."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.log_severity_level = _QUIET
    try:
        return onnxruntime.InferenceSession(content, options, ["CPUExecutionProvider"])
    except Exception as error:  # the library's own types have no common base
        raise ValueError(
            f"{file}: not a model that ONNX Runtime {onnxruntime.__version__} can run "
            f"({short(str(error))})"
        ) from error


def _text(shape: Iterable[int | str | None]) -> str:
    sizes = ["?" if size is None else str(size) for size in shape]
    return f"({', '.join(sizes)}{',' * (len(sizes) == 1)})"
