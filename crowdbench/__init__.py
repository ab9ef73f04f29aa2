"""A benchmark for planning robot motion among pedestrians.

The names in ``__all__`` are the public interface:

- environments: ``parallel_env`` makes one for PettingZoo (a ``CrowdEnv``);
  ``gymnasium.make("crowdbench:CrowdNav-v0", scenario=...)`` one for Gymnasium (a ``CrowdNavEnv``);
  ``vector_env`` makes many at once (a ``CrowdVectorEnv``), ``parallel_vector_env`` many with
  several robots (a ``CrowdParallelVectorEnv``);
- planners: subclasses of ``Agent``, told about their robot by a ``RobotSpec``, and at every step
  given an ``Observation`` for an ``Action``; ``AgentSpec`` makes one from its name; privileged ones
  have ``walk_ahead`` to foresee how people will walk, and ``Ways`` that lead past walls;
- ``ObstacleMap``: scans of the last steps as one image, laid out by a ``MapGeometry``;
  ``ObstacleMaps`` are those of many robots;
- scenarios: ``load_scenario`` reads a ``Scenario``; ``scenario_names`` and ``scenario_tiers`` list
  them;
- ``read_yaml``: a configuration file of an agent, read as strictly as scenarios are;
- ``Episode``: the log of one robot's run; ``Metric``: a number that it yields;
- extensions: a ``Drive`` gives a robot's actions their meaning, a ``WalkingModel`` says how a
  ``Crowd`` walks, and ``orca_velocities`` is how the pedestrians avoid each other by default
  (``orca_velocities_with`` takes horizons).

``crowdbench --help`` says what the command line can do.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import gymnasium
import pettingzoo

from crowdbench.agent import Action, Agent, AgentError, AgentSpec
from crowdbench.robot import Observation, RobotSpec
from crowdbench.scenario import (
    NoRoomError,
    Scenario,
    ScenarioError,
    load_scenario,
    scenario_names,
    scenario_tiers,
)
from crowdbench.strict_yaml import YamlError, read_yaml

if TYPE_CHECKING:
    from crowdbench.evaluation.episode import Episode
    from crowdbench.evaluation.metric import Metric
    from crowdbench.simulation.env import CrowdEnv, parallel_env
    from crowdbench.simulation.foresight import walk_ahead
    from crowdbench.simulation.gym_env import CrowdNavEnv
    from crowdbench.simulation.kinematics import Drive
    from crowdbench.simulation.obstacle_map import MapGeometry, ObstacleMap, ObstacleMaps
    from crowdbench.simulation.orca import orca_velocities, orca_velocities_with
    from crowdbench.simulation.parallel_vector_env import (
        CrowdParallelVectorEnv,
        parallel_vector_env,
    )
    from crowdbench.simulation.vector_env import CrowdVectorEnv, vector_env
    from crowdbench.simulation.walking import Crowd, WalkingModel
    from crowdbench.simulation.ways import Ways

# Heavy, so imported on first use: ``crowdbench --help`` answers at once.
_LAZY = {
    "Crowd": "crowdbench.simulation.walking",
    "CrowdEnv": "crowdbench.simulation.env",
    "CrowdNavEnv": "crowdbench.simulation.gym_env",
    "CrowdParallelVectorEnv": "crowdbench.simulation.parallel_vector_env",
    "CrowdVectorEnv": "crowdbench.simulation.vector_env",
    "Drive": "crowdbench.simulation.kinematics",
    "Episode": "crowdbench.evaluation.episode",
    "MapGeometry": "crowdbench.simulation.obstacle_map",
    "Metric": "crowdbench.evaluation.metric",
    "ObstacleMap": "crowdbench.simulation.obstacle_map",
    "ObstacleMaps": "crowdbench.simulation.obstacle_map",
    "orca_velocities": "crowdbench.simulation.orca",
    "orca_velocities_with": "crowdbench.simulation.orca",
    "WalkingModel": "crowdbench.simulation.walking",
    "Ways": "crowdbench.simulation.ways",
    "parallel_env": "crowdbench.simulation.env",
    "parallel_vector_env": "crowdbench.simulation.parallel_vector_env",
    "vector_env": "crowdbench.simulation.vector_env",
    "walk_ahead": "crowdbench.simulation.foresight",
}

__all__ = [
    "Action",
    "Agent",
    "AgentError",
    "AgentSpec",
    "Crowd",
    "CrowdEnv",
    "CrowdNavEnv",
    "CrowdParallelVectorEnv",
    "CrowdVectorEnv",
    "Drive",
    "Episode",
    "MapGeometry",
    "Metric",
    "NoRoomError",
    "Observation",
    "ObstacleMap",
    "ObstacleMaps",
    "RobotSpec",
    "Scenario",
    "ScenarioError",
    "WalkingModel",
    "Ways",
    "YamlError",
    "load_scenario",
    "orca_velocities",
    "orca_velocities_with",
    "parallel_env",
    "parallel_vector_env",
    "read_yaml",
    "scenario_names",
    "scenario_tiers",
    "vector_env",
    "walk_ahead",
]


pettingzoo.register("parallel", "crowdbench/crowd-v0", "crowdbench.simulation.env:parallel_env")
gymnasium.register(
    "CrowdNav-v0",
    "crowdbench.simulation.gym_env:CrowdNavEnv",
    vector_entry_point="crowdbench.simulation.vector_env:CrowdVectorEnv",
)


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'crowdbench' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
