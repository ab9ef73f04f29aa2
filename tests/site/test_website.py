"""The folder that is written: what is in it, what it says, and what it refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest
from full_disk import room_for

from crowdbench.evaluation.database import ResultsError
from crowdbench.evaluation.joined import local_rows
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.recordings import find_recordings
from crowdbench.evaluation.results import load_results
from crowdbench.evaluation.statistics import wilson_interval
from crowdbench.scenario import load_scenario
from crowdbench.site.leaderboard import family
from crowdbench.site.website import (
    SiteFigure,
    SiteTable,
    replay_link,
    write_replay_page,
    write_report_page,
)

SHORT = load_scenario("multimodal_fast", time_limit=1.0)


def index(output):
    text = (output / "data" / "index.js").read_text(encoding="ascii")
    assert text.startswith("crowdbench.index = ") and text.endswith(";\n")
    return json.loads(text[len("crowdbench.index = ") : -2])


def test_the_leaderboard_says_what_the_rows_say(episodes, tmp_path):
    episodes.add("orca", success=[1, 0, 1, 1], spl=[0.9, 0, 0.8, float("nan")])
    episodes.add("straight_line", "corridor_dense", success=[0, 0], spl=[0, 0])
    site = write_report_page(local_rows(episodes.folder), tmp_path / "site")
    assert (site.cells, site.episodes, site.replays) == (2, 6, 0)
    document = index(tmp_path / "site")
    names = [metric["name"] for metric in document["metrics"]]
    assert names == list(METRICS)
    assert [metric["name"] for metric in document["metrics"] if metric["main"]] == [
        *("success", "spl", "smoothness", "inference_s", "cutoff", "min_dist", "ttc_below_1s")
    ]
    assert [scenario["label"] for scenario in document["scenarios"]] == [
        "unimodal_slow",
        "corridor_dense",
    ], "in the scenarios' own order"
    cell = document["cells"][0]
    assert (cell["agent"], cell["episodes"]) == ("orca", 4)
    success = cell["estimates"][names.index("success")]
    np.testing.assert_allclose(success, wilson_interval([1, 0, 1, 1]))
    mean, low, high, n = cell["estimates"][names.index("spl")]
    assert mean == pytest.approx(1.7 / 3) and n == 3
    assert low < mean < high
    assert cell["estimates"][names.index("jerk")] == [None, None, None, 0]


def test_the_leaderboard_tells_what_is_not_computed_from_what_is_not_defined(episodes, tmp_path):
    episodes.add("orca", success=[1, 0], older=["jerk", "spl"])
    episodes.add("orca", first=2, spl=[0.9, 0.8], older=["jerk"])
    write_report_page(local_rows(episodes.folder), tmp_path / "site")
    (cell,) = index(tmp_path / "site")["cells"]
    assert cell["not_computed"] == ["jerk"]
    estimates = dict(zip(METRICS, cell["estimates"], strict=True))
    assert estimates["jerk"] == estimates["robot_at_fault"] == [None, None, None, 0]
    assert estimates["spl"][3] == 2


def test_a_cell_without_a_seed_in_between_is_incomplete(episodes, tmp_path):
    episodes.add("orca", success=[1, 1])
    episodes.add("orca", success=[1], first=5)
    episodes.add("straight_line", success=[1, 0])
    write_report_page(local_rows(episodes.folder), tmp_path / "site")
    cells = {cell["agent"]: cell for cell in index(tmp_path / "site")["cells"]}
    assert {name: cell["missing"] for name, cell in cells.items()} == {
        "orca": 3,
        "straight_line": 0,
    }


def test_a_cell_without_seeds_that_were_planned_is_incomplete(episodes, tmp_path):
    episodes.add("orca", success=[1, 1], first=1)
    episodes.add("neupan", success=[1, 1, 1])
    episodes.add("straight_line", success=[1, 0])
    planned = {("unimodal_slow", "orca"): 5, ("unimodal_slow", "neupan"): 2}
    write_report_page(local_rows(episodes.folder), tmp_path / "site", planned=planned)
    cells = {cell["agent"]: cell for cell in index(tmp_path / "site")["cells"]}
    missing = {name: cell["missing"] for name, cell in cells.items()}
    assert missing == {"orca": 3, "neupan": 0, "straight_line": 0}


def test_robots_of_one_episode_are_one_observation(episodes, tmp_path):
    episodes.add("orca", success=[1, 1], robot="robot_0")
    episodes.add("orca", success=[0, 1], robot="robot_1")
    write_report_page(local_rows(episodes.folder), tmp_path / "site")
    (cell,) = index(tmp_path / "site")["cells"]
    assert cell["episodes"] == 2
    mean, *_, n = cell["estimates"][list(METRICS).index("success")]
    assert (mean, n) == (0.75, 2)


def test_tables_and_figures_are_those_that_are_given(episodes, tmp_path):
    episodes.add("orca", success=[1])
    files = [tmp_path / "curve.png", tmp_path / "curve.pdf"]
    for path in files:
        path.write_bytes(path.suffix.encode())
    table = SiteTable("Table 1: Speed", "| Method | Success |\n| --- | ---: |\n| <b>A</b> | 1 |\n")
    figure = SiteFigure("Figure 1", "What it shows.", *files)
    write_report_page(local_rows(episodes.folder), tmp_path / "site", [table], [figure])
    document = index(tmp_path / "site")
    (shown,) = document["tables"]
    assert shown["title"] == "Table 1: Speed"
    assert "<table>" in shown["html"] and "style=" not in shown["html"]
    assert "<b>" not in shown["html"]
    (shown,) = document["figures"]
    assert (shown["title"], shown["caption"]) == ("Figure 1", "What it shows.")
    for ending in ("png", "pdf"):
        assert (tmp_path / "site" / shown[ending]).read_bytes() == f".{ending}".encode()


def test_a_scenario_that_has_changed_since_is_kept_apart(episodes, tmp_path):
    episodes.add("orca", success=[1])
    episodes.add("sac", success=[1], fixed={"scenario_digest": "0123456789ab"})
    write_report_page(local_rows(episodes.folder), tmp_path / "site")
    found = {scenario["label"]: scenario for scenario in index(tmp_path / "site")["scenarios"]}
    assert set(found) == {"unimodal_slow", "unimodal_slow@0123456789ab"}
    assert found["unimodal_slow@0123456789ab"]["family"] == "unknown"


@pytest.mark.parametrize(
    ("name", "changes", "expected"),
    [
        ("multimodal_fast", {}, "open, reactive"),
        ("multimodal_fast_nonreactive", {}, "open, nonreactive"),
        ("multimodal_fast", {"pedestrians.reactive": 0.5}, "open, mixed"),
        ("corridor_dense", {}, "corridor"),
        (
            "corridor_dense",
            {"arena.kind": "map", "robots.start": [-5, 0], "robots.goal": [5, 0]},
            "map",
        ),
    ],
)
def test_families(name, changes, expected):
    assert family(load_scenario(name, **changes)) == expected


def test_the_same_results_give_the_same_bytes(whole, tmp_path):
    whole.run(SHORT, "straight_line", 900000)
    contents = []
    for name in ("a", "b"):
        write_report_page(local_rows(whole.folder), tmp_path / name)
        files = sorted(path for path in (tmp_path / name).rglob("*") if path.is_file())
        contents.append({str(p.relative_to(tmp_path / name)): p.read_bytes() for p in files})
    assert contents[0] == contents[1]


def test_an_older_page_is_replaced_and_nothing_else(whole, tmp_path):
    whole.run(SHORT, "straight_line", 900000)
    output = tmp_path / "site"
    write_report_page(local_rows(whole.folder), output)
    stale = output / "data" / "stale.js"
    stale.write_text("")
    write_report_page(local_rows(whole.folder), output)
    assert not stale.exists()
    other = tmp_path / "thesis"
    (other / "data").mkdir(parents=True)
    (other / "data" / "chapter").write_text("years of work")
    (other / ".part").mkdir()
    with pytest.raises(ResultsError, match="thesis: holds other files than a report page"):
        write_report_page(local_rows(whole.folder), other)
    assert (other / "data" / "chapter").read_text() == "years of work"
    assert (other / ".part").is_dir()
    in_the_way = tmp_path / "file"
    in_the_way.write_text("")
    with pytest.raises(ResultsError, match="file: the page cannot be written"):
        write_report_page(local_rows(whole.folder), in_the_way)


def test_a_full_disk_leaves_the_page_that_was_there(whole, tmp_path):
    whole.run(SHORT, "straight_line", 900000)
    rows, output = local_rows(whole.folder), tmp_path / "site"
    told = r"site: the page cannot be written \(File too large\)"
    with room_for(3000), pytest.raises(ResultsError, match=told):
        write_report_page(rows, output)
    assert list(output.iterdir()) == []
    write_report_page(rows, output)
    before = {path: path.read_bytes() for path in output.rglob("*") if path.is_file()}
    long = [SiteTable("Long", "word " * 10_000)]  # in what is written last
    for room in (3000, 20_000):
        with room_for(room), pytest.raises(ResultsError, match=told):
            write_report_page(rows, output, long)
        assert {path: path.read_bytes() for path in output.rglob("*") if path.is_file()} == before


def test_only_replays_of_the_rows_are_offered(whole, tmp_path):
    """Whole episodes of weights that have been replaced since are no replays of these rows."""
    for weights in ("old", "new"):
        whole.run(SHORT, "straight_line", 900000, weights=weights)
    (tmp_path / "keep").mkdir()
    write_report_page(local_rows(whole.folder), tmp_path / "site")
    (cell,) = index(tmp_path / "site")["cells"]
    assert cell["weights"] == "new"
    assert [replay["seed"] for replay in cell["replays"]] == [900000]
    rows = load_results(whole.folder)
    assert list(rows["weights_sha256"]) == ["new"]


def test_a_page_of_replays_begins_with_the_first(whole, tmp_path):
    whole.run(SHORT, "straight_line", 900001)
    write_replay_page(find_recordings(local_rows(whole.folder)), tmp_path / "site")
    document = index(tmp_path / "site")
    (cell,) = document["cells"]
    assert document["start"] == replay_link(cell["scenario"], "straight_line", 900001)
    assert document["metrics"] == []
    lidar = {"beams": 180, "degrees": 360.0, "range": 6.0, "mount": [0.0, 0.0, 0.0]}
    assert document["scenarios"][0]["lidar"] == lidar
