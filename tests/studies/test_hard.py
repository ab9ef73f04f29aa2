"""The study of the hard tier: everything that it names is there, and every scenario is in it."""

import numpy as np
import pandas as pd
import pytest
from crowdbench_studies.hard import STUDY, costs

from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.rows import NOT_COMPUTED, empty_frame
from crowdbench.scenario import load_scenario, scenario_names
from crowdbench.study.library import check_study
from crowdbench.study.measurements import Measurements


def test_it_can_be_run():
    check_study(STUDY)


def test_it_covers_both_tiers():
    scenarios = {cell.scenario for cell in STUDY.cells()}
    assert scenarios == {*scenario_names("hard"), *scenario_names("situation")}


def test_the_figure_has_a_point_for_each_agent_at_its_means():
    """Two agents with two episodes in each scenario; hollow is who was told what nobody knows."""
    values = {"orca": ([1, 0], [0.2, 0.4]), "informed": ([1, 1], [0.1, 0.3])}
    rows = [
        dict.fromkeys(METRICS, np.nan)
        | {
            NOT_COMPUTED: "",
            "scenario": name,
            "scenario_digest": load_scenario(name).digest,
            "agent": agent,
        }
        | {"robot": "robot_0", "seed": seed, "success": success[seed], "delay": delay[seed]}
        for name in (*scenario_names("hard"), *scenario_names("situation"))
        for agent, (success, delay) in values.items()
        for seed in range(2)
    ]
    figure = costs(Measurements(pd.DataFrame(rows), STUDY.cells()))
    lines = {bars.get_label(): bars.lines[0] for bars in figure.axes[0].containers}
    points = {label: np.ravel(line.get_data()).tolist() for label, line in lines.items()}
    assert points == {
        "ORCA": pytest.approx([0.3, 0.5]),
        "Everything known": pytest.approx([0.2, 1.0]),
    }
    assert lines["Everything known"].get_markerfacecolor() == "white"
    assert lines["ORCA"].get_markerfacecolor() != "white"
    assert costs(Measurements(empty_frame(), STUDY.cells())) is None
