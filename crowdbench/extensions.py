"""The extension points that a scenario names, known before any of the simulation is imported.

Reading a scenario must stay cheap, so that built-in objects are named here by where they are and
load when an environment is made. ``docs/add_a_drive.md`` and ``docs/add_a_walking_model.md`` show
how a package adds its own.
"""

from __future__ import annotations

from typing import Any

from crowdbench.registry import ClassRegistry

DRIVES: ClassRegistry[Any] = ClassRegistry(
    "drive",
    "crowdbench.drives",
    {
        "differential": "crowdbench.simulation.kinematics:Differential",
        "omnidirectional": "crowdbench.simulation.kinematics:Omnidirectional",
    },
    base="crowdbench:Drive",
)
"""Subclasses of ``Drive`` by the name that ``robots.drive`` gives."""

WALKING_MODELS: ClassRegistry[Any] = ClassRegistry(
    "walking model",
    "crowdbench.walking_models",
    {
        "orca": "crowdbench.simulation.walking:Orca",
        "recorded": "crowdbench.simulation.walking:Recorded",
        "social_force": "crowdbench.simulation.walking:SocialForce",
        "straight": "crowdbench.simulation.walking:Straight",
    },
    base="crowdbench:WalkingModel",
)
"""Subclasses of ``WalkingModel`` by the name that ``pedestrians.model`` gives."""
