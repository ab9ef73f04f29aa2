"""The study of the hard tier: everything that it names is there, and every scenario is in it."""

import numpy as np
import pandas as pd
import pytest
from crowdbench_studies.hard import STUDY, costs, leads, spread

from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.rows import NOT_COMPUTED, empty_frame
from crowdbench.scenario import load_scenario, scenario_names
from crowdbench.study.library import check_study
from crowdbench.study.measurements import Measurements


def measured(
    values: dict[str, dict[str, list[float]]], scenarios: list[str] | None = None
) -> Measurements:
    """What is stored of some agents, the same values in each of some scenarios, seeds from 0 on."""
    rows = [
        dict.fromkeys(METRICS, np.nan)
        | {
            NOT_COMPUTED: "",
            "scenario": name,
            "scenario_digest": load_scenario(name).digest,
            "agent": agent,
        }
        | {"robot": "robot_0", "seed": seed}
        | {metric: value[seed] for metric, value in given.items()}
        for name in scenarios or (*scenario_names("hard"), *scenario_names("situation"))
        for agent, given in values.items()
        for seed in range(len(given["success"]))
    ]
    return Measurements(pd.DataFrame(rows), STUDY.cells())


def test_it_can_be_run():
    check_study(STUDY)


def test_it_covers_both_tiers():
    scenarios = {cell.scenario for cell in STUDY.cells()}
    assert scenarios == {*scenario_names("hard"), *scenario_names("situation")}


def test_the_figure_has_a_point_for_each_agent_at_its_means():
    """Hollow is who was told what nobody knows; who has not run everywhere in full is not there."""
    values = {
        "orca": {"success": [1, 0] * 50, "delay": [0.2, 0.4] * 50},
        "informed": {"success": [1, 1] * 50, "delay": [0.1, 0.3] * 50},
        "neupan": {"success": [1] * 99, "delay": [0.1] * 99},
    }
    for given in values.values():
        given["delay_by_chance"] = np.linspace(-0.1, 0.2, len(given["success"]))
    figure = costs(measured(values))
    lines = {bars.get_label(): bars.lines[0] for bars in figure.axes[0].containers}
    points = {label: np.ravel(line.get_data()).tolist() for label, line in lines.items()}
    assert points == {
        "ORCA": pytest.approx([0.3, 0.5]),
        "Everything known": pytest.approx([0.2, 1.0]),
    }
    assert lines["Everything known"].get_markerfacecolor() == "white"
    assert lines["ORCA"].get_markerfacecolor() != "white"
    chance = figure.axes[0].patches[0]
    low, high = chance.get_x(), chance.get_x() + chance.get_width()
    # 1,600 values with a standard deviation of 0.3 / sqrt(12)
    assert (low, high) == pytest.approx((0.05 - 0.0042, 0.05 + 0.0042), abs=0.0008)
    assert costs(Measurements(empty_frame(), STUDY.cells())) is None


def test_the_best_two_are_told_apart_by_what_is_paired():
    """Nine seeds that one agent alone survives have p = 2/2^9; three have p = 2/2^3."""
    ones = np.ones(100)
    cases = {9: True, 3: False}
    for lost, apart in cases.items():
        fewer = np.where(np.arange(100) < lost, 0.0, 1.0)
        stored = measured(
            {
                "orca": {"success": fewer, "spl": fewer},
                "neupan": {"success": ones, "spl": ones},
                "sac": {"success": 0 * ones, "spl": 0 * ones},
                "tdmpc": {"success": ones[:99], "spl": ones[:99]},
                "informed": {"success": ones, "spl": ones},
            },
            ["hard_station"],
        )
        (lead,) = leads(stored, "success").values()
        assert (lead.best.agent, lead.second.agent) == ("neupan", "orca")
        assert lead.difference.mean == pytest.approx(lost / 100)
        assert lead.difference.p == pytest.approx(2 / 2**lost, abs=0.015)
        assert lead.apart is apart


def test_a_small_lead_is_none_however_sure():
    ones = np.ones(100)
    stored = measured(
        {
            "orca": {"success": ones, "spl": 0.86 * ones},
            "neupan": {"success": ones, "spl": 0.9 * ones},
        },
        ["situation_queue"],
    )
    (lead,) = leads(stored, "spl").values()
    assert lead.difference.p < 0.01
    assert not lead.apart


def test_the_spread_counts_scenarios_and_joins_who_differs():
    """SPL alone tells them apart, in each of three scenarios; who ran alone leads nobody."""
    ones = np.ones(100)
    scenarios = ["hard_station", "situation_queue", "situation_doorway"]
    values = {
        "orca": {"success": ones, "spl": 0.8 * ones},
        "neupan": {"success": ones, "spl": 0.9 * ones},
    }
    figure = spread(measured(values, scenarios))
    told = "The best two differ by more than 0.05 (p < 0.05) in success or SPL in 3 of 3 scenarios"
    assert figure.get_suptitle() == told
    success, spl = figure.axes
    joined = [line.get_xdata() for line in spl.lines if line.get_marker() == "None"]
    assert np.allclose(joined, [[0.9, 0.8]] * 3)
    assert all(line.get_marker() != "None" for line in success.lines)
    legend = [label.get_text() for label in figure.legends[0].get_texts()]
    assert legend == ["NeuPAN", "ORCA"]
    labels = [label.get_text() for label in success.get_yticklabels()]
    rows = [line.get_ydata()[0] for line in spl.lines if line.get_marker() == "None"]
    assert {labels[round(row)] for row in rows} == {"Station", "Queue", "Doorway"}
    neupan, orca = (line.get_ydata() for line in success.lines)
    assert np.abs(neupan - orca).min() > 0.05  # equal as they are, each can be seen
    assert np.abs(np.concatenate([neupan, orca]) % 1 - 0.5).min() > 0.2  # in its own row

    alone = {"orca": values["orca"]}
    assert spread(measured(alone, scenarios)) is None
    assert spread(Measurements(empty_frame(), STUDY.cells())) is None
