"""Published and local rows side by side."""

from dataclasses import replace

import pytest
from stored_episodes import Episodes

from crowdbench.evaluation.joined import cells_of, published_and_local
from crowdbench.evaluation.record import write_cell
from crowdbench.evaluation.results import load_results

SCENARIO = "unimodal_slow"


@pytest.fixture
def publish(record, tmp_path):
    """Publish episodes of an agent: a value of SPL for each seed."""

    def publish(agent, spl, **fixed):
        made = Episodes(tmp_path / f"made-{agent}")
        made.add(agent, SCENARIO, spl=spl, fixed={"machine": "theirs", **fixed})
        rows = load_results(made.folder)
        write_cell(record, cells_of(rows)[SCENARIO, agent], rows, {})

    return publish


@pytest.fixture
def local(tmp_path):
    return Episodes(tmp_path / "local")


def seen(rows):
    named = rows.assign(source=rows["source"].map(lambda text: text.rpartition("/")[2]))
    return [tuple(row) for row in named[["agent", "seed", "spl", "source"]].itertuples(index=False)]


def test_published_rows_come_first_and_local_ones_fill_the_gaps(publish, local):
    publish("orca", [0.1, 0.2])
    local.add("orca", SCENARIO, first=1, spl=[0.6, 0.7])
    rows = published_and_local(local.folder)
    assert seen(rows) == [
        ("orca", 0, 0.1, "published"),
        ("orca", 1, 0.2, "published"),
        ("orca", 2, 0.7, "local"),
    ]
    rows = published_and_local(local.folder, first="local")
    assert seen(rows) == [
        ("orca", 0, 0.1, "published"),
        ("orca", 1, 0.6, "local"),
        ("orca", 2, 0.7, "local"),
    ]


def test_agents_that_are_only_in_one_of_them_are_all_there(publish, local):
    publish("orca", [0.1])
    local.add("mine.py:Mine", SCENARIO, spl=[0.9])
    rows = published_and_local(local.folder)
    assert seen(rows) == [("mine.py:Mine", 0, 0.9, "local"), ("orca", 0, 0.1, "published")]
    assert seen(published_and_local(local.folder, agent="orca")) == [("orca", 0, 0.1, "published")]


@pytest.mark.parametrize("changed", [{"weights_sha256": "ff"}, {"code": "a file"}])
def test_what_is_another_measurement_is_not_mixed_in(publish, local, changed):
    publish("orca", [0.1])
    local.add("orca", SCENARIO, first=1, spl=[0.6, 0.7], fixed=changed)
    assert seen(published_and_local(local.folder)) == [("orca", 0, 0.1, "published")]
    rows = published_and_local(local.folder, first="local")
    assert seen(rows) == [("orca", 1, 0.6, "local"), ("orca", 2, 0.7, "local")]


@pytest.mark.parametrize("first", ["published", "local"])
def test_local_rows_of_an_older_scenario_do_not_hide_published_ones(publish, local, first):
    publish("orca", [0.1])
    local.add("orca", SCENARIO, spl=[0.6], fixed={"scenario_digest": "0123456789ab"})
    rows = published_and_local(local.folder, first=first)
    assert seen(rows) == [("orca", 0, 0.1, "published")]


def test_without_a_record_or_without_local_rows_the_other_is_all_there_is(publish, local, tmp_path):
    assert published_and_local(tmp_path / "none").empty
    local.add("orca", SCENARIO, spl=[0.6])
    assert seen(published_and_local(local.folder)) == [("orca", 0, 0.6, "local")]
    publish("orca", [0.1])
    assert seen(published_and_local(tmp_path / "none")) == [("orca", 0, 0.1, "published")]


def test_a_cell_is_what_its_rows_have_in_common(publish, local):
    publish("orca", [0.1, 0.2], weights_sha256="ff")
    cell = cells_of(published_and_local(local.folder))[SCENARIO, "orca"]
    assert (cell.agent, cell.scenario, cell.weights_sha256) == ("orca", SCENARIO, "ff")
    assert cell.identity != replace(cell, weights_sha256="").identity
