"""The results in the tree: tables that follow from the episodes, episodes that can be run again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from crowdbench_studies.paper import STUDY

from crowdbench.agent import Agent, AgentSpec
from crowdbench.evaluation.metrics import METRICS, metrics
from crowdbench.evaluation.record import load_record
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


def test_the_tables_are_those_that_the_episodes_give(stored, tmp_path):
    write_study(STUDY, RESULTS, tmp_path, stored)
    made = [*sorted((tmp_path / "tables").iterdir()), tmp_path / "README.md"]
    assert len(made) > 1
    for path in made:
        committed = RESULTS / path.relative_to(tmp_path)
        assert committed.is_file(), f"{committed} is missing; run python paper_tables.py"
        assert committed.read_text(encoding="utf-8") == path.read_text(encoding="utf-8"), (
            f"{committed} is not what the episodes give; run python paper_tables.py"
        )


def sample(rows):
    """Ten stored episodes: of every agent name one, then others, all drawn with a fixed seed."""
    rng = np.random.default_rng(0)
    rows = rows.sample(frac=1, random_state=rng)
    names = rows["agent"].str.partition(":")[0]
    each = rows[~names.duplicated()]
    others = rows[~rows["agent"].isin(each["agent"])].drop_duplicates("agent")
    return [*each.itertuples(), *others.itertuples()][:SAMPLE]


class Repeats(Agent):
    """Drives as somebody drove before, knowing nothing."""

    def __init__(self, actions):
        self.actions = actions

    def reset(self, robot, seed):
        self.step = 0

    def act(self, observation):
        self.step += 1
        return self.actions[self.step - 1]


def test_episodes_run_again_give_the_same_rows(stored):
    """What agents decide anew may differ in the last digits on another kind of processor."""
    for row in sample(Measurements(stored, STUDY.cells()).episodes):
        spec, scenario = AgentSpec.parse(row.agent), load_scenario(row.scenario)
        episode = f"{row.agent} in {row.scenario}, seed {row.seed}"
        assert (spec.make().weights_sha256 or "") == row.weights_sha256, (
            f"{episode}: run with other weights; run python paper_tables.py --run"
        )
        (again,) = run_episode(scenario, spec, row.seed)
        assert again.outcome == row.outcome, f"{episode}, on {row.machine}"
        assert again.steps == row.steps, f"{episode}, on {row.machine}"
        values = metrics(again)
        for name in set(DETERMINISTIC) - set(row.not_computed.split()):
            np.testing.assert_allclose(
                values[name],
                getattr(row, name),
                rtol=TOLERANCE,
                err_msg=f"{episode}: {name}, on {row.machine}",
            )
        (driven,) = run_episode(scenario, [Repeats(again.actions)], row.seed)
        simulated = metrics(driven)
        for name in DETERMINISTIC:
            np.testing.assert_array_equal(simulated[name], values[name], err_msg=name)


def test_the_tolerance_is_the_one_that_the_documentation_states():
    text = (RESULTS.parent / "docs" / "metrics.md").read_text(encoding="utf-8")
    assert f"within a relative {TOLERANCE:g}" in text
