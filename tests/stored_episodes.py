"""Stored episodes made by hand: only what a test is about is written down."""

from __future__ import annotations

import dataclasses
import json
import math

import pytest
from crowdbench_studies.paper import STUDY

from crowdbench.agent import AgentSpec
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.results import Cell, Origin, Result, ResultsStore
from crowdbench.scenario import load_scenario
from crowdbench.simulation import WORLD_VERSION
from crowdbench.study.measurements import Measurements


class Episodes:
    """A results folder to which episodes are added."""

    def __init__(self, folder):
        self.folder = folder

    def add(
        self,
        agent,
        scenario="unimodal_slow",
        first=0,
        robot="robot_0",
        fixed=None,
        older=(),
        **values,
    ):
        """Store episodes with seeds from ``first`` on.

        ``values``: a list of numbers per metric, one per episode; other metrics are NaN.
        ``fixed``: other columns, e.g. ``{"machine": "m"}``.
        ``older``: metrics that the episodes were never measured with.
        """
        facts = {
            "scenario": scenario,
            "scenario_digest": load_scenario(scenario).digest,
            "agent": agent,
            "options": json.dumps(dict(AgentSpec.parse(agent).options)),
            "world": WORLD_VERSION,
            "version": "0.1.0",
            "weights_sha256": "",
            "code": "crowdbench-nav 0.1.0",
            "outcome": "success",
            "steps": 40,
            "machine": "a machine",
            "timestamp": "2025-01-01T00:00:00+00:00",
            **(fixed or {}),
        }
        cell, origin, result = (
            {name: facts[name] for name in kind.__dataclass_fields__ if name in facts}
            for kind in (Cell, Origin, Result)
        )
        results = []
        for number in range(len(next(iter(values.values())))):
            metrics = {
                name: float(values.get(name, {number: math.nan})[number])
                for name in METRICS
                if name not in older
            }
            results.append(
                Result(
                    seed=first + number,
                    robot=robot,
                    metrics=metrics,
                    origin=Origin(**origin),
                    **result,
                )
            )
        ResultsStore(self.folder).append(Cell(**cell), results)

    def measured(self, plan=None):
        """By default of what the paper's study needs."""
        return Measurements.load(self.folder, STUDY.cells() if plan is None else plan)


@pytest.fixture
def episodes(tmp_path):
    return Episodes(tmp_path)


@pytest.fixture(scope="session")
def many(tmp_path_factory):
    """A folder with ten episodes in every cell of the paper's study, by a formula."""
    store = Episodes(tmp_path_factory.mktemp("many"))
    for number, cell in enumerate(STUDY.cells()):
        seeds = range(10)
        success = [float((seed * 7 + number) % 10 < 8) for seed in seeds]
        store.add(
            cell.agent,
            cell.scenario,
            success=success,
            spl=[0.9 * value for value in success],
            smoothness=[0.1 + 0.01 * ((seed + number) % 5) for seed in seeds],
            inference_s=[0.01 + 0.001 * seed for seed in seeds],
            cutoff=[float((seed + number) % 4) for seed in seeds],
            min_dist=[0.5 + 0.05 * ((seed * 3 + number) % 7) for seed in seeds],
            ttc_below_1s=[0.02 * ((seed + number) % 3) for seed in seeds],
        )
    return store


class Whole:
    """A results folder with whole episodes, run here; ``episodes`` has them by what they are."""

    def __init__(self, folder):
        self.folder = folder
        self.episodes = {}

    def run(self, scenario, agent, seed, *, label=None, name=None, weights="", **changes):
        """Run and store an episode; ``label`` and ``name`` replace agent and scenario in it."""
        from crowdbench.evaluation.metrics import metrics
        from crowdbench.evaluation.results import scenario_label
        from crowdbench.evaluation.rollout import run_episode

        world = load_scenario(scenario)
        agent_name, scenario_name = label or agent, name or scenario_label(world)
        cell = Cell(
            scenario_name, world.digest, agent_name, "{}", WORLD_VERSION, weights, "by hand"
        )
        store = ResultsStore(self.folder)
        origin = Origin(machine="a machine")
        for run in run_episode(world, agent, seed, label=agent_name):
            episode = dataclasses.replace(run, **changes)
            store.append(cell, [Result.of(episode, metrics(episode), origin)], world)
            self.episodes[scenario_name, agent_name, seed, episode.robot] = episode
        return episode


@pytest.fixture(scope="session")
def make_whole():
    return Whole


@pytest.fixture
def whole(tmp_path):
    return Whole(tmp_path / "results")
