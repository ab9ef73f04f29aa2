"""The study of the hard tier: everything that it names is there, and every scenario is in it."""

from crowdbench_studies.hard import STUDY

from crowdbench.scenario import scenario_names
from crowdbench.study.library import check_study


def test_it_can_be_run():
    check_study(STUDY)


def test_it_covers_both_tiers():
    scenarios = {cell.scenario for cell in STUDY.cells()}
    assert scenarios == {*scenario_names("hard"), *scenario_names("situation")}
