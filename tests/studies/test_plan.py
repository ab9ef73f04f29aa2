from __future__ import annotations

from collections import Counter

import pytest
from crowdbench_studies.paper import STUDY
from crowdbench_studies.paper.claims import CLAIMS
from crowdbench_studies.paper.plan import CORRIDORS, TABLES
from crowdbench_studies.paper.reference import PaperKey, load_paper, paper_key

from crowdbench.agent import AgentSpec, agent_names, agent_options, find_agent
from crowdbench.evaluation.metrics import METRICS
from crowdbench.scenario import scenario_names

cells = STUDY.cells


def addressed():
    """The paper's number of every cell that has one."""
    for table in TABLES:
        for block in table.blocks:
            for method in table.methods:
                for quantity in table.quantities:
                    key = paper_key(table, block, method, quantity)
                    if key is not None:
                        yield key


def test_every_number_of_the_paper_belongs_to_exactly_one_cell():
    paper = load_paper()
    assert len(paper) == 218
    assert Counter(addressed()) == Counter(dict.fromkeys(paper, 1))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        # read off the paper's pages
        (PaperKey("I", "multimodal_fast", "reactive", "neupan", "success"), 0.75),
        (PaperKey("I", "unimodal_slow", "reactive", "sac", "inference_s"), 0.013),
        (PaperKey("II", "multimodal_slow", "nonreactive", "tdmpc", "spl"), 0.86),
        (
            PaperKey(
                "III", "corridor_very_dense", "unspecified", "latent_planner H=10 E=1", "smoothness"
            ),
            0.13,
        ),
        (
            PaperKey(
                "VII",
                "open",
                "unspecified",
                "H=6 E=6 without social reward",
                "ttc_below_1s_percent",
            ),
            10.1,
        ),
    ],
)
def test_the_paper_s_numbers_are_the_paper_s(key, value):
    assert load_paper()[key] == value


def test_scenarios_and_metrics_exist():
    names = set(scenario_names("paper"))
    assert {cell.scenario for cell in cells()} == names
    metrics = {quantity.metric for table in TABLES for quantity in table.quantities}
    assert metrics <= set(METRICS)


def test_agents_are_named_as_their_episodes_are():
    for agent in {cell.agent for cell in cells()}:
        assert str(AgentSpec.parse(agent)) == agent


def test_agents_are_installed_and_have_the_options_that_the_plan_gives_them():
    for agent in {cell.agent for cell in cells()}:
        spec = AgentSpec.parse(agent)
        assert spec.name in agent_names()
        if spec.options:
            assert set(spec.options) <= set(agent_options(find_agent(spec.name))), agent


def plans_at_every_step(agent):
    spec = AgentSpec.parse(agent)
    planner = spec.name in ("latent_planner", "tdmpc")
    options = {"execute": 1, "use_mppi": True, **spec.options}
    return planner and options["use_mppi"] and options["execute"] == 1


def test_planners_that_plan_at_every_step_run_100_episodes_and_all_others_500():
    for cell in cells():
        assert cell.episodes == (100 if plans_at_every_step(cell.agent) else 500), cell
    for table in TABLES:
        for method in table.methods:
            assert method.episodes == (100 if plans_at_every_step(method.agent) else 500)


def test_every_cell_is_run_once():
    keys = [(cell.scenario, cell.agent) for cell in cells()]
    assert len(keys) == len(set(keys))


def test_floor_ceiling_and_orca_stand_in_every_table():
    for table in TABLES:
        agents = {method.agent: method.bound for method in table.methods}
        assert agents["straight_line"] and agents["informed"]
        assert not agents["orca"] and not agents["dynamic_window"]


def test_what_figures_and_claims_need_is_run():
    run = {(cell.scenario, cell.agent) for cell in cells()}
    compared = {method.agent for method in TABLES[0].methods}
    assert {(scenario, agent) for scenario in CORRIDORS for agent in compared} <= run
    for claim in CLAIMS:
        for agent in (claim.better, claim.worse):
            assert {(scenario, agent) for scenario in claim.scenarios} <= run, claim.text


def test_the_paper_s_own_numbers_agree_with_its_claims():
    """A claim points the way the paper's numbers point, so no claim is turned around."""
    paper, cases = load_paper(), 0
    for claim in CLAIMS:
        table = next(table for table in TABLES if table.number == claim.table)
        quantity = next(q for q in table.quantities if q.metric == claim.metric)
        means = []
        for agent in (claim.better, claim.worse):
            method = next(method for method in table.methods if method.agent == agent)
            keys = [
                paper_key(table, block, method, quantity)
                for block in table.blocks
                if set(block.scenarios) <= set(claim.scenarios)
            ]
            means.append(sum(paper[key] for key in keys) / len(keys))
        bound = claim.factor * means[1] + claim.margin
        more = METRICS[claim.metric].better == "higher"
        assert means[0] > bound if more else means[0] < bound, claim.text
        cases += 1
    assert cases == len(CLAIMS)
