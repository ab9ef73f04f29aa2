"""The results in the tree: tables that follow from the episodes, episodes that can be run again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from crowdbench_studies.hard import STUDY as HARD
from crowdbench_studies.paper import STUDY

from crowdbench.agent import Agent, AgentSpec
from crowdbench.evaluation.joined import cells_of
from crowdbench.evaluation.metrics import METRICS, metrics
from crowdbench.evaluation.record import load_commands, load_record
from crowdbench.evaluation.rollout import run_episode
from crowdbench.scenario import load_scenario
from crowdbench.study.measurements import Measurements
from crowdbench.study.output import write_study

RESULTS = Path(__file__).parents[2] / "results"
SAMPLE = 10
TOLERANCE = 1e-5
"""Relative; docs/metrics.md says why."""
DETERMINISTIC = [name for name in METRICS if name != "inference_s"]
"""Compared with a stored row so far as that was measured with them."""


@pytest.fixture(scope="module")
def stored():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("crowdbench.evaluation.record.record_folder", lambda: RESULTS / "record")
        yield load_record()


@pytest.mark.parametrize(
    ("study", "folder", "command"),
    [
        (STUDY, RESULTS, "python paper_tables.py"),
        (HARD, RESULTS / "studies" / "hard", "crowdbench tables hard"),
    ],
    ids=["paper", "hard"],
)
def test_the_tables_are_those_that_the_episodes_give(study, folder, command, stored, tmp_path):
    write_study(study, RESULTS, tmp_path, stored)
    made = [*sorted((tmp_path / "tables").iterdir()), tmp_path / "README.md"]
    assert len(made) > 1
    for path in made:
        committed = folder / path.relative_to(tmp_path)
        assert committed.is_file(), f"{committed} is missing; run {command}"
        assert committed.read_text(encoding="utf-8") == path.read_text(encoding="utf-8"), (
            f"{committed} is not what the episodes give; run {command}"
        )


def sample(rows):
    """Ten stored episodes: of every agent name one, then others, all drawn with a fixed seed.

    Somebody was near in all of them, as to drive straight on says little about an agent.
    """
    rng = np.random.default_rng(0)
    rows = rows[rows["min_clearance"] < 0.3].sample(frac=1, random_state=rng)
    names = rows["agent"].str.partition(":")[0]
    each = rows[~names.duplicated()]
    others = rows[~rows["agent"].isin(each["agent"])].drop_duplicates("agent")
    return [*each.itertuples(), *others.itertuples()][:SAMPLE]


class Repeats(Agent):
    """Drives as somebody drove before, whom it asks at every step what he would do now."""

    def __init__(self, actions, asked=None):
        self.actions, self.asked, self.answers = actions, asked, []
        self.privileged = asked is not None and asked.privileged

    def reset(self, robot, seed):
        self.step = 0
        if self.asked is not None:
            self.asked.reset(robot, seed)

    def act(self, observation):
        if self.asked is not None:
            self.answers.append(self.asked.act(observation))
        self.step += 1
        return self.actions[self.step - 1]


def require_stored(values, row):
    """The metrics of an episode are those of its row."""
    for name in set(DETERMINISTIC) - set(row.not_computed.split()):
        np.testing.assert_allclose(
            values[name],
            getattr(row, name),
            rtol=TOLERANCE,
            err_msg=f"{row.agent} in {row.scenario}, seed {row.seed}: {name}, on {row.machine}",
        )


def test_agents_decide_today_as_they_did(stored):
    """Step by step on the way that they took: further apart from there than rounding is no fault.

    A crowd makes much of little: left to themselves, agents that multiply matrices come to other
    rows on another kind of processor. Planners without stored commands can only be asked whether
    they still arrive.
    """
    turned_out_otherwise = 0
    for row in sample(Measurements(stored, STUDY.cells()).episodes):
        spec, scenario = AgentSpec.parse(row.agent), load_scenario(row.scenario)
        episode = f"{row.agent} in {row.scenario}, seed {row.seed}"
        agent = spec.make()
        assert (agent.weights_sha256 or "") == row.weights_sha256, (
            f"{episode}: run with other weights; run python paper_tables.py --run"
        )
        rows = stored[(stored["agent"] == row.agent) & (stored["scenario"] == row.scenario)]
        (cell,) = cells_of(rows).values()
        told = load_commands(cell, RESULTS / "record").of(row.seed)
        if told:
            driver = Repeats(told[row.robot], agent)
            (again,) = run_episode(scenario, [driver], row.seed)
            np.testing.assert_allclose(
                driver.answers, told[row.robot], rtol=0, atol=TOLERANCE, err_msg=episode
            )
            assert (again.outcome, again.steps) == (row.outcome, row.steps), episode
            require_stored(metrics(again), row)
        else:
            (again,) = run_episode(scenario, [agent], row.seed)
            assert again.error is None, f"{episode}: {again.error}"
            turned_out_otherwise += again.outcome != row.outcome
            (driven,) = run_episode(scenario, [Repeats(again.actions)], row.seed)
            simulated, values = metrics(driven), metrics(again)
            for name in DETERMINISTIC:
                np.testing.assert_array_equal(simulated[name], values[name], err_msg=name)
    assert turned_out_otherwise <= 1


def test_the_tolerance_is_the_one_that_the_documentation_states():
    text = (RESULTS.parent / "docs" / "metrics.md").read_text(encoding="utf-8")
    assert f"within a relative {TOLERANCE:g}" in text
