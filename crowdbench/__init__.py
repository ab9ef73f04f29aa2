"""crowdbench: a benchmark for planning robot motion among pedestrians.

The names below are the public interface; everything heavy is imported on first use, so that
``import crowdbench`` and ``crowdbench --help`` stay fast.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import gymnasium
import pettingzoo

from crowdbench.agent import Action, Agent, AgentSpec, Observation, RobotSpec
from crowdbench.scenario import Scenario, ScenarioError, load_scenario, scenario_names

if TYPE_CHECKING:
    from crowdbench.evaluation.episode import Episode
    from crowdbench.simulation.env import CrowdEnv, parallel_env
    from crowdbench.simulation.gym_env import CrowdNavEnv
    from crowdbench.simulation.orca import orca_velocities

_LAZY = {
    "CrowdEnv": "crowdbench.simulation.env",
    "CrowdNavEnv": "crowdbench.simulation.gym_env",
    "Episode": "crowdbench.evaluation.episode",
    "orca_velocities": "crowdbench.simulation.orca",
    "parallel_env": "crowdbench.simulation.env",
}

__all__ = [
    "Action",
    "Agent",
    "AgentSpec",
    "CrowdEnv",
    "CrowdNavEnv",
    "Episode",
    "Observation",
    "RobotSpec",
    "Scenario",
    "ScenarioError",
    "load_scenario",
    "orca_velocities",
    "parallel_env",
    "scenario_names",
]


pettingzoo.register("parallel", "crowdbench/crowd-v0", "crowdbench.simulation.env:parallel_env")
gymnasium.register("CrowdNav-v0", "crowdbench.simulation.gym_env:CrowdNavEnv")


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'crowdbench' has no attribute {name!r}")
