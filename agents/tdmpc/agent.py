"""The TD-MPC-style baseline: the latent planner's code with weights trained another way.

No imitation of the planner, no social reward and no smoothness term, in training and in planning:
the weights' configuration has ``smoothness_weight`` 0.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from crowdbench_agents.latent_planner.agent import LatentPlanner


class Tdmpc(LatentPlanner):
    """MPPI in a learned latent space, scored by predicted rewards and the final Q alone.

    Options are those of LatentPlanner.
    """

    version: ClassVar[str] = "0.1.0"
    trainer: ClassVar[str] = "tdmpc"
    folder: ClassVar[Path] = Path(__file__).parent / "weights"
    own_weights: ClassVar[str] = "tdmpc"
