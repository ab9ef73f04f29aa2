"""The worlds that are trained in: the scenarios of some tiers, as they are and varied."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from crowdbench_agents.learning.config import Training
from crowdbench_agents.learning.errors import TrainingError

import crowdbench
from crowdbench import Scenario

Worlds = Mapping[str, Sequence[Scenario]]
"""By the name of a scenario those that its episodes are in, itself first; seeds take turns."""

SHARES = {
    "unimodal_slow": 1, "unimodal_fast": 2, "multimodal_slow": 1, "multimodal_fast": 2,
    "unimodal_slow_nonreactive": 2, "unimodal_fast_nonreactive": 4,
    "multimodal_slow_nonreactive": 2, "multimodal_fast_nonreactive": 4,
    "corridor_sparse": 1, "corridor_moderate": 1, "corridor_dense": 2, "corridor_very_dense": 3,
}  # fmt: skip
"""Of the demonstrations: more where people are fast, non-reactive or many."""
OTHER_SHARE = 2
"""Of scenarios that are not named there."""

CROWD, PACE = (0.6, 1.2), (0.85, 1.15)
"""Between which factors variants have other numbers of people, and speeds."""
ATTENTION, RESPONSIBILITY = 0.3, (0.1, 0.5)
"""By how much the share of the reactive is another one; how much of an evasion people take on."""
NOISE, DROPOUT = 0.04, 0.02
"""The most of a variant's LiDAR, where the scenario's own has any [m]."""
ATTEMPTS = 100
"""To draw a variant into which everybody fits."""


def training_worlds(settings: Training) -> dict[str, list[Scenario]]:
    """Those of some settings.

    All have the robot and the LiDAR of the tier that is named last: networks learn to drive one
    robot, and one without limits on its acceleration can be driven as if it had them.
    """
    tiers = [crowdbench.scenario_names(tier) for tier in settings.tiers]
    last = crowdbench.load_scenario(tiers[-1][0])
    robot = {
        "robots": {"acceleration": last.robots.acceleration, "latency": last.robots.latency},
        "lidar": {"noise": last.lidar.noise, "dropout": last.lidar.dropout},
    }
    return {
        name: _varied(crowdbench.load_scenario(name, **robot), settings.variants)
        for tier in tiers
        for name in tier
    }


def robot_of(worlds: Worlds) -> crowdbench.RobotSpec:
    """What a planner may know about the robot in all of them."""
    return crowdbench.RobotSpec.from_scenario(next(iter(worlds.values()))[0])


def as_they_are(names: Iterable[str]) -> dict[str, list[Scenario]]:
    """Scenarios by name or path, each itself alone."""
    return {name: [crowdbench.load_scenario(name)] for name in names}


def digests(worlds: Worlds) -> dict[str, str]:
    """By name what changes whenever a scenario does: its digest, or that of all variants."""
    return {name: joint_digest([one.digest for one in ones]) for name, ones in worlds.items()}


def joint_digest(digests: Sequence[str]) -> str:
    """12 hex digits that change whenever one of some digests does; of one alone, itself."""
    if len(digests) == 1:
        return digests[0]
    return hashlib.sha256("".join(digests).encode()).hexdigest()[:12]


def share(name: str) -> int:
    """How much of the demonstrations is of a scenario, relative to others."""
    return SHARES.get(name, OTHER_SHARE)


def _varied(scenario: Scenario, variants: int) -> list[Scenario]:
    rng = np.random.default_rng(list(scenario.name.encode()))
    return [scenario, *(_variant(scenario, rng) for _ in range(variants - 1))]


def _variant(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    """A scenario with other people and another quality of its scans.

    Raises:
        TrainingError: people hardly ever fit into it.
    """
    people, lidar = scenario.pedestrians, scenario.lidar
    for _ in range(ATTEMPTS):
        pace = rng.uniform(*PACE)
        changed = {
            "count": max(1, round(people.count * rng.uniform(*CROWD))),
            "reactive": float(np.clip(people.reactive + rng.uniform(-1, 1) * ATTENTION, 0, 1)),
            "responsibility": rng.uniform(*RESPONSIBILITY),
            "speed": tuple(pace * speed for speed in people.speed),
        }
        if people.speed_mean is not None:
            changed["speed_mean"] = pace * people.speed_mean
        scans = {
            "noise": rng.uniform(0, NOISE) if lidar.noise else 0.0,
            "dropout": rng.uniform(0, DROPOUT) if lidar.dropout else 0.0,
        }
        with contextlib.suppress(crowdbench.ScenarioError):
            return scenario.override({"pedestrians": changed, "lidar": scans})
    raise TrainingError(f"training.variants: {scenario.name!r} has no room for any; allowed: 1")
