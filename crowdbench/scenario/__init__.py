"""Scenarios: everything a scenario file may say, with units and ranges.

A scenario file is YAML; ``extends: NAME`` starts from another scenario, and any field can be
overridden (``pedestrians.count=12``) from the command line or from Python. Unknown keys, values out
of range and worlds in which not everybody fits are refused with an error that names the file, the
field and what is allowed.
"""

from crowdbench.messages import nearest
from crowdbench.scenario.digest import later
from crowdbench.scenario.errors import NoRoomError, ScenarioError
from crowdbench.scenario.files import load_scenario, parse_overrides, scenario_names, scenario_tiers
from crowdbench.scenario.model import Scenario
from crowdbench.scenario.people import Pedestrians
from crowdbench.scenario.sections import Arena, Lidar, Obstacles, Odometry, Reward, Robots

__all__ = [
    "Arena",
    "Lidar",
    "NoRoomError",
    "Obstacles",
    "Odometry",
    "Pedestrians",
    "Reward",
    "Robots",
    "Scenario",
    "ScenarioError",
    "later",
    "load_scenario",
    "nearest",
    "parse_overrides",
    "scenario_names",
    "scenario_tiers",
]
