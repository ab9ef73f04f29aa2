"""A learned policy as an ONNX file: from obstacle map, velocity and goal to v [m/s], w [rad/s].

The map is drawn outside the network, since it remembers scans; the file's metadata says where it
lies. Actions are scaled to the speeds of the robot that the policy was trained with, which the
metadata names as well. ``crowdbench_agents.onnx`` reads such files.
"""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from crowdbench_agents.learning.inputs import ActionBounds, Inputs
from torch import Tensor, nn

from crowdbench.replacing import replacing

if TYPE_CHECKING:
    from crowdbench_agents.learning.config import Config
    from crowdbench_agents.learning.trained_robot import TrainedRobot


class _Physical(nn.Module):
    """A policy with inputs by name and actions in physical units."""

    _centre: Tensor
    _half: Tensor

    def __init__(
        self, network: nn.Module, policy: Callable[[Inputs], Tensor], robot: TrainedRobot
    ) -> None:
        super().__init__()
        self.network, self.policy = network, policy
        bounds = ActionBounds.of(robot)
        self.register_buffer("_centre", torch.from_numpy(bounds.centre))
        self.register_buffer("_half", torch.from_numpy(bounds.half))

    def forward(self, map: Tensor, velocity: Tensor, goal: Tensor) -> Tensor:
        return self.policy(Inputs(map, velocity, goal)) * self._half + self._centre


def export_policy(
    path: Path,
    network: nn.Module,
    policy: Callable[[Inputs], Tensor],
    config: Config,
    robot: TrainedRobot,
) -> None:
    """Write an ONNX file with the inputs ``map``, ``velocity``, ``goal`` and the output ``action``.

    Args:
        path: the file, replaced only once it is complete.
        network: whose parameters the policy uses.
        policy: inputs (1, ...) -> actions (1, 2) in [-1, 1].
        config: says where the map lies.
        robot: what the policy was trained with.

    Raises:
        ValueError: the exporter's package is not installed.
        OSError: the file cannot be written.
    """
    if importlib.util.find_spec("onnxscript") is None:
        raise ValueError("onnxscript is not installed: pip install 'crowdbench-nav[onnx]'")
    cells = config.perception.cells
    example = (torch.zeros(1, cells, cells, dtype=torch.uint8), torch.zeros(1, 2), torch.ones(1, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter about itself
        program = torch.onnx.export(
            _Physical(network, policy, robot).eval(),
            example,
            input_names=list(Inputs._fields),
            output_names=["action"],
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    model = program.model
    for node in model.graph:
        node.metadata_props.clear()  # the exporter's notes, paths of this machine among them
    model.metadata_props["crowdbench.perception"] = config.perception.model_dump_json()
    model.metadata_props["crowdbench.robot"] = robot.model_dump_json()
    with replacing(path) as part:
        part.write_bytes(program.model_proto.SerializeToString())
