from __future__ import annotations

import importlib.metadata

import pytest

from crowdbench import AgentSpec, load_scenario
from crowdbench.agent import ENTRY_POINT_GROUP, find_agent
from crowdbench.evaluation.results import load_results
from crowdbench.evaluation.runner import Task, run

TINY = load_scenario("multimodal_fast", time_limit=1, pedestrians={"count": 1})
PACKAGE = """
from crowdbench_agents.straight_line import StraightLine

class Unversioned(StraightLine):
    pass

class Versioned(StraightLine):
    version = "7"
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Put a distribution of a name, version and agents where it is found before any other."""

    def do(name, version, agents):
        folder = tmp_path / version / f"{name.replace('-', '_')}-{version}.dist-info"
        folder.mkdir(parents=True)
        (folder / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
        )
        lines = [f"[{ENTRY_POINT_GROUP}]", *(f"{key} = {value}" for key, value in agents.items())]
        (folder / "entry_points.txt").write_text("\n".join(lines))
        (folder.parent / "their_agents.py").write_text(PACKAGE)
        monkeypatch.syspath_prepend(folder.parent)

    return do


def codes(folder, agents, seeds=1):
    """By which code the agents' episodes are stored."""
    tasks = [Task(TINY, AgentSpec.parse(agent), range(seeds)) for agent in agents]
    return [cell.code for cell in run(tasks, folder, jobs=1)]


def test_a_release_of_crowdbench_leaves_every_stored_episode_as_good_as_before(tmp_path, install):
    builtin = {p.name: p.value for p in importlib.metadata.entry_points(group=ENTRY_POINT_GROUP)}
    codes(tmp_path, ["straight_line"])
    before = load_results(tmp_path)
    install("crowdbench-nav", "9.9.9", builtin)
    assert importlib.metadata.version("crowdbench-nav") == "9.9.9"
    codes(tmp_path, ["straight_line"], seeds=2)
    after = load_results(tmp_path)
    assert list(after["seed"]) == [0, 1], "all of them are one measurement"
    assert list(after["version"]) == [before["version"][0], "9.9.9"], "seed 0 was not run again"


def test_every_agent_of_crowdbench_states_a_version_of_its_own():
    points = importlib.metadata.entry_points(group=ENTRY_POINT_GROUP)
    own = [point.name for point in points if point.dist and point.dist.name == "crowdbench-nav"]
    assert "latent_planner" in own
    assert all(vars(find_agent(name))["version"] for name in own)


def test_a_packages_agent_is_known_by_the_packages_version_unless_it_states_one(tmp_path, install):
    agents = {"theirs": "their_agents:Unversioned", "stated": "their_agents:Versioned"}
    install("their-agents", "1.0", agents)
    assert codes(tmp_path, agents) == ["their-agents 1.0", "their-agents 7"]
    install("their-agents", "1.1", agents)
    assert codes(tmp_path, agents) == ["their-agents 1.1", "their-agents 7"]
