from __future__ import annotations

import csv
import itertools
import json
import math
import re
import shutil
from dataclasses import replace

import pytest
from crowdbench_studies.paper import STUDY
from crowdbench_studies.paper.plan import TABLES

from crowdbench.cli import main
from crowdbench.evaluation.database import ResultsError
from crowdbench.study import output
from crowdbench.study.claims import check_claims, check_orders
from crowdbench.study.measurements import Measurements
from crowdbench.study.model import Claim
from crowdbench.study.output import write_study
from crowdbench.study.page import duration, write_page
from crowdbench.study.sessions import Account, Session, load_sessions
from crowdbench.study.tables import fill, fill_all
from crowdbench.study.verdicts import differences_csv, orders_csv, weights_csv

cells = STUDY.cells
SESSION = Session(
    "paper", "2025-01-01T00:00:00+00:00", 7260.0, 900, 2, "a machine", {"python": "3.11.7"}
)


def page(measured, sessions=(), figures=None):
    tables = fill_all(STUDY, measured)
    findings = check_claims(measured, STUDY.claims)
    orders = check_orders(tables, measured)
    return write_page(STUDY, tables, findings, orders, measured, figures or {}, sessions)


def section(text, heading):
    """What stands under a heading."""
    rest = text[text.index(f"# {heading}\n") :]
    return re.split(r"\n#+ ", rest, maxsplit=1)[0]


def csv_rows(text):
    return list(csv.DictReader(text.splitlines()))


def files(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


# Claims


def claim(**changes):
    values = {
        "text": "A above B", "table": "I", "better": "orca", "worse": "straight_line",
        "scenarios": ("unimodal_slow",), "metric": "spl",
    }  # fmt: skip
    return Claim(**{**values, **changes})


@pytest.fixture
def twelve(episodes):
    """On each of twelve seeds ORCA's value is 0.3 above the straight line's."""
    episodes.add("orca", spl=[0.8 + 0.01 * k for k in range(12)], cutoff=[2.0] * 12)
    episodes.add("straight_line", spl=[0.5 + 0.01 * k for k in range(12)], cutoff=[3.0] * 12)
    return episodes.measured()


def test_a_claim_holds_or_fails_by_the_sign_of_a_significant_difference(twelve):
    (finding,) = check_claims(twelve, [claim()])
    assert finding.verdict == "holds"
    assert finding.p == 2 / 2**12
    assert finding.difference[:3] == pytest.approx((0.3, 0.3, 0.3))
    (finding,) = check_claims(twelve, [claim(better="straight_line", worse="orca")])
    assert finding.verdict == "fails"


def test_less_is_better_in_a_claim_about_what_should_be_low(twelve):
    assert check_claims(twelve, [claim(metric="cutoff")])[0].verdict == "holds"


def test_halving_and_not_losing_are_stricter_or_looser_than_a_difference(twelve):
    halved = claim(metric="cutoff", factor=0.5)  # 2 against half of 3
    assert check_claims(twelve, [halved])[0].verdict == "fails"
    assert check_claims(twelve, [claim(metric="cutoff", factor=0.7)])[0].verdict == "holds"
    loses = claim(better="straight_line", worse="orca", margin=-0.31)  # 0.5 against 0.8 - 0.31
    assert check_claims(twelve, [loses])[0].verdict == "holds"


def test_claims_are_corrected_within_their_table(twelve):
    findings = check_claims(twelve, [claim(), claim(metric="cutoff"), claim(table="II")])
    assert [finding.p for finding in findings] == [2 * 2 / 2**12] * 2 + [2 / 2**12]


def test_a_claim_without_episodes_is_not_yet_run(twelve):
    (finding,) = check_claims(twelve, [claim(worse="sac")])
    assert finding.verdict == "not yet run"


def test_few_episodes_leave_a_claim_undecided(episodes):
    episodes.add("orca", spl=[0.9, 0.8, 0.9])
    episodes.add("straight_line", spl=[0.1, 0.2, 0.1])
    assert check_claims(episodes.measured(), [claim()])[0].verdict == "undecided"


def test_where_its_metric_is_undefined_a_claim_is_undecided_and_the_page_says_why(episodes):
    nothing = [float("nan")] * 3
    episodes.add("orca", spl=[0.9, 0.8, 0.9], min_dist=nothing)
    episodes.add("straight_line", spl=[0.1, 0.2, 0.1], min_dist=nothing)
    measured = episodes.measured()
    claims = (claim(text="A keeps away", metric="min_dist"), claim(worse="sac"))
    findings = check_claims(measured, claims)
    assert [finding.verdict for finding in findings] == ["undecided", "not yet run"]
    text = write_page(replace(STUDY, claims=claims), [], findings, [], measured, {}, [])
    line = next(line for line in text.splitlines() if line.startswith("| I |"))
    assert line == "| I |  |  | A keeps away (MinDist \\[m\\]: undefined) | A above B |"
    assert "Undefined: in no episode that both ran has the metric a value for both." in text


def test_orders_follow_the_paper_and_equal_values_are_none(many):
    measured = many.measured()
    table = TABLES[3]  # IV: 3 methods x 3 metrics, all values different
    orders = check_orders([fill(table, measured)], measured)
    assert len(orders) == 9
    for order in orders:
        more = order.better.reference > order.worse.reference
        assert more == (order.better.quantity.metric != "smoothness")
    # Table V, Smooth and SPL and success: 0.57 twice among SPL's four values.
    assert len(check_orders([fill(TABLES[4], measured)], measured)) == 3 * 6 - 1


def test_orders_are_tested_in_the_paper_s_direction(episodes):
    """The paper has SAC's success below NeuPAN's in the first column; here it is above."""
    episodes.add("neupan", success=[0.0] * 40)
    episodes.add("sac", success=[1.0] * 40)
    measured = episodes.measured()
    tested = [o for o in check_orders([fill(TABLES[0], measured)], measured) if o.difference.n]
    assert [(o.better.method.agent, o.worse.method.agent) for o in tested] == [("neupan", "sac")]
    assert tested[0].verdict == "fails"
    rows = [row for row in csv_rows(orders_csv(tested)) if row["verdict"] == "fails"]
    assert [(row["better"], row["worse"]) for row in rows] == [("NeuPAN", "SAC")]
    assert "holds 0" not in page(measured) and "fails 1" in page(measured)


def test_times_are_not_judged(episodes):
    """The paper's are those of another machine: no order, no difference, but the number."""
    episodes.add("neupan", inference_s=[0.001 * k for k in range(1, 41)])
    episodes.add("sac", inference_s=[0.1 + 0.001 * k for k in range(40)])
    measured = episodes.measured()
    tables = fill_all(STUDY, measured)
    orders = check_orders(tables, measured)
    assert orders and {o.better.quantity.metric for o in orders} == {
        "success", "spl", "smoothness", "cutoff", "min_dist", "ttc_below_1s",
    }  # fmt: skip
    assert csv_rows(differences_csv(tables)) == []
    assert re.search(r"\| NeuPAN \| .*\| 2[01]† \[1\d, 2\d\] \(390\) \|", page(measured))


# The page


def test_the_page_says_that_the_paper_s_scenarios_are_unpublished(many):
    assert "not published" in section(page(many.measured()), "How to read this")


def test_the_page_counts_what_is_missing(episodes):
    text = page(episodes.measured())
    planned = sum(cell.episodes for cell in cells())
    assert f"0 of {planned:,} planned episodes are stored" in text
    total = sum(len(t.blocks) * len(t.methods) * len(t.quantities) for t in TABLES)
    assert f"{total} of {total} table cells are not yet run" in text
    assert "Figure 4 (not yet run)" in section(text, "Figures")


def test_cells_apart_from_the_paper_are_listed_and_others_are_not(episodes):
    # Ours: 0.97 exactly; the paper: 1.00 for NeuPAN and 0.97 for SAC.
    episodes.add("neupan", success=[1.0] * 291 + [0.0] * 9, spl=[0.84] * 300)
    episodes.add("sac", success=[1.0] * 291 + [0.0] * 9)
    measured = episodes.measured()
    differences = section(page(measured), "Where we differ from the paper")
    assert "of 3 measured cells, the interval of 1 excludes" in differences
    assert "0 are better here, 1 worse" in differences
    rows = csv_rows(differences_csv(fill_all(STUDY, measured)))
    assert [row["here"] for row in rows] == ["worse", "not told apart", "not told apart"]
    assert [rows[0][name] for name in ("method", "metric")] == ["NeuPAN", "success"]
    assert rows[0]["reference"] == "1"
    assert float(rows[0]["value"]) == 0.97
    assert (rows[0]["low"][:4], rows[0]["high"][:5]) == ("0.94", "0.984")


def test_machine_versions_weights_and_errors_are_named(episodes):
    fixed = {
        "weights_sha256": "a" * 64,
        "machine": "A <b>CPU</b> | 2 cores",
        "outcome": "agent_error",
    }
    episodes.add("sac", success=[0.0] * 3, inference_s=[0.5] * 3, fixed=fixed)
    measured = episodes.measured()
    text = section(page(measured, [SESSION, SESSION]), "How this was measured")
    assert r"A &lt;b&gt;CPU&lt;/b&gt; \| 2 cores" in text
    assert "[weights.csv](tables/weights.csv)" in text
    assert weights_csv(measured.episodes).splitlines()[1:] == [f"sac,{'a' * 64},3"]
    assert "(they count as failures): 3 (sac)" in text
    # 3 x 40 steps x 0.5 s
    assert "Time inside the agents, over the episodes that have a time: 60 s" in text
    run = "1,800 episodes (1,797 of them no longer stored)"
    assert f"Total run time: 4 h 02 min for {run} in 2 sessions" in text
    assert "python 3.11.7" in text


def test_episodes_without_a_time_count_neither_in_the_time_nor_as_timed(episodes):
    waited = {"diagnostics": {"crowdbench.processor_share": 0.5}}
    episodes.add("orca", success=[1, 1], inference_s=[0.5, 0.25])
    episodes.add("orca", first=2, success=[1], inference_s=[math.nan], fixed=waited)
    text = section(page(episodes.measured()), "How this was measured")
    # 40 steps each: 20 s and 10 s.
    assert "- Time inside the agents, over the episodes that have a time: 30 s.\n" in text
    assert "- Without a time: 1 episodes" in text
    assert "- Total run time: not recorded here; `--run` keeps that of the episodes it runs" in text


def test_two_sets_of_weights_of_one_agent_are_pointed_out(episodes):
    episodes.add("sac", "unimodal_slow", success=[1.0], fixed={"weights_sha256": "a" * 64})
    episodes.add("sac", "unimodal_fast", success=[1.0], fixed={"weights_sha256": "b" * 64})
    assert "More than one set of weights in use: sac." in page(episodes.measured())


def test_tables_in_the_page_have_as_many_cells_as_their_heads(many):
    lines = page(many.measured(), [SESSION]).splitlines()
    bars = [len(re.findall(r"(?<!\\)\|", line)) if line.startswith("|") else 0 for line in lines]
    for before, here in itertools.pairwise(bars):
        assert not (before and here) or before == here


def test_durations_are_told_as_people_do():
    assert [duration(s) for s in (0.4, 89, 600, 5340, 5400, 7500)] == [
        "0 s", "89 s", "10 min", "89 min", "1 h 30 min", "2 h 05 min",
    ]  # fmt: skip


# The report as a whole


@pytest.fixture
def without_figures(monkeypatch):
    """Drawing takes most of the time; test_figures.py draws."""
    monkeypatch.setattr(output, "save_figures", lambda *arguments: {})


def test_the_same_episodes_give_the_same_bytes(many, tmp_path, without_figures):
    for name in ("one", "two"):
        write_study(STUDY, many.folder, tmp_path / name)
    one, two = files(tmp_path / "one"), files(tmp_path / "two")
    assert one == two
    tables = {
        f"tables/table_{table.number}.{end}" for table in TABLES for end in ("csv", "md", "tex")
    }
    assert tables | {"README.md"} <= set(one)


def test_every_file_that_the_page_names_is_there(many, tmp_path):
    write_study(STUDY, many.folder, tmp_path)
    text = (tmp_path / "README.md").read_text()
    named = {
        *re.findall(r"\]\(((?:tables|figures)/[^)]+)\)", text),
        *re.findall(r'src="([^"]+)"', text),
    }
    assert len(named) > 12
    assert {f"tables/{name}.csv" for name in ("claims", "orders", "differences")} <= named
    assert [name for name in sorted(named) if not (tmp_path / name).is_file()] == []


def test_the_command_writes_the_report_and_prints_the_tables(
    many, tmp_path, capsys, without_figures
):
    folder = tmp_path / "results"
    shutil.copytree(many.folder, folder)
    assert main(["tables", "--results", str(folder)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for table in TABLES:
        assert f"Table {table.number}: {table.title}" in printed
    assert (folder / "README.md").is_file()


def test_a_folder_that_cannot_be_written_is_named(many, tmp_path):
    (tmp_path / "tables").write_text("in the way")
    with pytest.raises(ResultsError, match="cannot be written"):
        write_study(STUDY, many.folder, tmp_path)


# Sessions


def test_a_session_is_kept_as_it_goes_on(tmp_path):
    now = [100.0]
    account = Account(tmp_path, "mine", clock=lambda: now[0])
    account.write()
    assert load_sessions(tmp_path, "mine") == [], "nothing was run"
    account.count("a machine", 2)
    assert load_sessions(tmp_path, "mine") == [], "not after every episode"
    now[0] += 31
    account.count("a machine", 2)
    (kept,) = load_sessions(tmp_path, "mine")
    assert (kept.seconds, kept.episodes, kept.jobs, kept.machine) == (31.0, 2, 2, "a machine")
    assert load_sessions(tmp_path, "yours") == []
    (path,) = (tmp_path / "sessions").iterdir()
    path.with_name(f".{path.name}").write_text("half of one that is being writ")
    assert load_sessions(tmp_path, "mine") == [kept]
    assert "numpy" in kept.versions and "torch" in kept.versions
    now[0] += 5
    account.count("another machine", 3)
    account.count("a machine", 1)
    account.write()
    (kept,) = load_sessions(tmp_path, "mine")
    assert (kept.seconds, kept.episodes, kept.jobs) == (36.0, 4, 3)
    assert kept.machine == "a machine; another machine"


@pytest.mark.parametrize("text", ["{", json.dumps({"started": "now", "colour": "red"})])
def test_a_file_that_is_no_session_is_named(tmp_path, text):
    (tmp_path / "sessions").mkdir()
    (tmp_path / "sessions" / "x.json").write_text(text)
    with pytest.raises(ResultsError, match=r"x\.json"):
        load_sessions(tmp_path, "mine")


def test_an_empty_folder_has_a_page_too(tmp_path, without_figures):
    write_study(STUDY, tmp_path, tmp_path)
    assert Measurements.load(tmp_path, cells()).episodes.empty
    assert "0 of" in (tmp_path / "README.md").read_text()
