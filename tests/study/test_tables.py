from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from crowdbench_studies.paper import STUDY
from crowdbench_studies.paper.plan import INFERENCE, SMOOTH, SPL, SUCCESS, TABLES, TTC
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from crowdbench.study.formats import (
    csv_text,
    escape_latex,
    escape_markdown,
    latex,
    markdown,
    notes,
    terminal,
)
from crowdbench.study.measurements import Measurements
from crowdbench.study.model import Block, Cell, Method, Table
from crowdbench.study.tables import fill

cells = STUDY.cells

SLOW = Block(("unimodal_slow",), "Slow & sure")
METHODS = (
    Method("neupan", "First", 100),
    Method("sac", "Second", 100),
    Method("orca", "Third", 100),
    Method("informed", "Ceiling", 100, bound=True),
)
REFERENCE = {"success": 1.0, "spl": 0.84, "smoothness": 0.1, "inference_s": 0.39}
"""Of the first method."""


def table(*quantities, methods=METHODS, blocks=(SLOW,), note=""):
    first = methods[0].label
    reference = {
        (block.heading, first, metric): value
        for block in blocks
        for metric, value in REFERENCE.items()
    }
    return Table("I", "A title", blocks, quantities or (SUCCESS,), methods, note, reference)


def filled(episodes, wanted):
    plan = [
        Cell(scenario, method.agent, method.episodes)
        for method in wanted.methods
        for scenario in dict.fromkeys(name for block in wanted.blocks for name in block.scenarios)
    ]
    return fill(wanted, episodes.measured(plan))


def entry(result, label):
    return next(entry for entry in result.entries if entry.method.label == label)


def ones(count, of):
    return [1.0] * count + [0.0] * (of - count)


def shown(result):
    console = Console(width=100, file=io.StringIO(), color_system=None)
    console.print(terminal(result))
    return console.file.getvalue()


# Values


def test_success_has_wilson_s_interval(episodes):
    episodes.add("neupan", success=ones(90, 100))
    cell = entry(filled(episodes, table()), "First")
    # z = 1.959964, n = 100, p = 0.9: (p + z²/2n ± z √(p(1-p)/n + z²/4n²)) / (1 + z²/n)
    assert cell.estimate.mean == 0.9
    assert (cell.estimate.low, cell.estimate.high) == pytest.approx((0.825634, 0.944771), abs=1e-6)
    assert (cell.episodes, cell.planned, cell.state) == (100, 100, "measured")
    assert cell.reference == 1.0


def test_a_mean_leaves_undefined_episodes_out(episodes):
    episodes.add("neupan", spl=[0.5, 0.7, math.nan, 0.9], success=[1.0] * 4)
    cell = entry(filled(episodes, table(SPL)), "First")
    assert cell.estimate.mean == pytest.approx(0.7)
    assert (cell.estimate.n, cell.episodes) == (3, 4)
    assert 0.5 <= cell.estimate.low < 0.7 < cell.estimate.high <= 0.9


def test_pooled_scenarios_count_by_episode(episodes):
    both = Block(("unimodal_slow", "unimodal_fast"))
    episodes.add("neupan", "unimodal_slow", success=ones(50, 50))
    episodes.add("neupan", "unimodal_fast", success=ones(20, 50))
    cell = entry(filled(episodes, table(blocks=(both,))), "First")
    assert cell.estimate.mean == 0.7
    assert (cell.episodes, cell.planned) == (100, 200)


def test_only_planned_seeds_of_the_first_robot_in_the_present_scenario_count(episodes):
    episodes.add("neupan", success=ones(4, 4))
    episodes.add("neupan", success=ones(0, 7), first=100)
    episodes.add("neupan", success=ones(0, 4), robot="robot_1")
    episodes.add("sac", success=ones(4, 4), fixed={"scenario_digest": "0123456789ab"})
    result = filled(episodes, table())
    assert entry(result, "First").estimate[:1] == (1.0,)
    assert entry(result, "First").episodes == 4
    assert entry(result, "Second").state == "missing"


def test_the_interval_excludes_the_paper_s_value_only_past_its_rounding(episodes):
    episodes.add("neupan", smoothness=[0.104, 0.106] * 50, success=[1.0] * 100)
    cell = entry(filled(episodes, table(SMOOTH)), "First")
    assert cell.reference == 0.1
    assert cell.estimate.low > 0.1
    assert not cell.excludes_reference, "0.1 may stand for anything up to 0.105"
    assert replace(cell, reference=0.09).excludes_reference
    assert not replace(cell, reference=None).excludes_reference


def test_numbers_are_printed_in_the_unit_of_their_heading(episodes):
    episodes.add("neupan", inference_s=[0.012, 0.014], ttc_below_1s=[0.04, 0.05])
    line = markdown(filled(episodes, table(INFERENCE))).splitlines()[3]
    assert line.startswith("| First | 13† [")
    assert line.endswith("] (390) |")
    reference = {("", "First", "ttc_below_1s"): 0.043}
    social = Table("VII", "t", (Block(("unimodal_slow",)),), (TTC,), METHODS[:1], "", reference)
    assert "| First | 4.5† [" in markdown(filled(episodes, social))
    assert "] (4.3) |" in markdown(filled(episodes, social))


# What is missing


def test_a_cell_without_episodes_shows_a_dash_and_says_why(episodes):
    result = filled(episodes, table())
    assert result.states() == {"missing"}
    assert "| First | — (1.00) |" in markdown(result)
    assert "—: not yet run." in notes(result)
    for text in (markdown(result), latex(result), shown(result)):
        assert "not yet run" in " ".join(text.split())
    printed = shown(result).splitlines()
    (place,) = (number for number, line in enumerate(printed) if line.startswith("First"))
    assert printed[place + 1].startswith("Second")  # no empty line for an interval
    for row in csv.DictReader(io.StringIO(csv_text(result))):
        assert (row["value"], row["low"], row["high"], row["bold"]) == ("", "", "", "")
        assert row["episodes"] == "0"


def test_a_method_with_missing_episodes_is_neither_bold_nor_the_best(episodes):
    episodes.add("neupan", success=ones(99, 99))
    episodes.add("sac", success=ones(80, 100))
    episodes.add("orca", success=ones(20, 100))
    result = filled(episodes, table())
    bold = {name: entry(result, name).bold for name in ("First", "Second", "Third")}
    assert bold == {"First": False, "Second": True, "Third": False}
    assert entry(result, "Third").p < 0.05


def test_a_cell_with_some_episodes_is_marked(episodes):
    episodes.add("neupan", success=ones(9, 10))
    result = filled(episodes, table())
    assert entry(result, "First").state == "partial"
    assert "| First | 0.90† [" in markdown(result)
    assert any(note.startswith("†: only some") for note in notes(result))


def test_a_metric_that_no_episode_defines_is_called_undefined(episodes):
    episodes.add("neupan", spl=[math.nan] * 100)
    result = filled(episodes, table(SPL))
    assert entry(result, "First").state == "undefined"
    assert "| First | undefined (0.84) |" in markdown(result)


def test_a_metric_that_episodes_are_older_than_is_not_computed(episodes):
    episodes.add("neupan", success=ones(3, 3), older=["spl"])
    episodes.add("sac", success=ones(3, 3), spl=[0.9] * 3)
    result = filled(episodes, table(SPL))
    assert entry(result, "First").state == "not computed"
    assert "| First | not computed (0.84) |" in markdown(result)
    assert "not computed: the episodes are older than this metric" in " ".join(notes(result))
    assert "| First | 0" not in markdown(result)


def test_a_metric_that_some_episodes_are_older_than_is_marked(episodes):
    episodes.add("neupan", spl=[0.9] * 60)
    episodes.add("neupan", first=60, success=ones(40, 40), older=["spl"])
    (cell, *_) = filled(episodes, table(SPL)).entries
    assert (cell.state, cell.estimate.n, cell.episodes) == ("partial", 60, 100)


def test_an_empty_folder_gives_every_table(tmp_path):
    measured = Measurements.load(tmp_path, cells())
    for wanted in TABLES:
        result = fill(wanted, measured)
        assert result.states() == {"missing"}
        assert not any(cell.bold for cell in result.entries)


# Bold


def bold(result):
    return {cell.method.label for cell in result.entries if cell.bold}


def test_the_best_is_bold_where_all_others_differ(episodes):
    episodes.add("neupan", success=ones(95, 100))
    episodes.add("sac", success=ones(60, 100))
    episodes.add("orca", success=ones(50, 100))
    episodes.add("informed", success=ones(100, 100))
    result = filled(episodes, table())
    assert bold(result) == {"First"}
    assert "**0.95**" in markdown(result)
    assert r"\textbf{0.95}" in latex(result)
    assert math.isnan(entry(result, "First").p), "the best is not compared with itself"
    assert entry(result, "Second").p < 0.05


def test_more_digits_do_not_make_bold(episodes):
    episodes.add("neupan", success=ones(52, 100))
    episodes.add("sac", success=ones(50, 100))
    assert bold(filled(episodes, table())) == set()


def test_those_that_cannot_be_told_from_the_best_are_bold_with_it(episodes):
    episodes.add("neupan", success=ones(95, 100))
    episodes.add("sac", success=ones(94, 100))
    episodes.add("orca", success=ones(50, 100))
    result = filled(episodes, table())
    assert bold(result) == {"First", "Second"}


def test_bounds_take_no_part(episodes):
    episodes.add("neupan", success=ones(60, 100))
    episodes.add("informed", success=ones(100, 100))
    result = filled(episodes, table())
    assert bold(result) == set()
    assert math.isnan(entry(result, "Ceiling").p)


def test_less_is_better_where_the_metric_says_so(episodes):
    episodes.add("neupan", smoothness=[0.3 + 0.001 * k for k in range(100)])
    episodes.add("sac", smoothness=[0.1 + 0.001 * k for k in range(100)])
    assert bold(filled(episodes, table(SMOOTH))) == {"Second"}


def test_p_values_by_hand(episodes):
    # Twelve seeds, First ahead on all of them: 2 of 2^12 swaps are as extreme; Third ahead of
    # nobody: the same. Two comparisons, so Holm doubles the smaller and keeps at least that.
    episodes.add("neupan", spl=[0.9 + 0.001 * k for k in range(12)])
    episodes.add("sac", spl=[0.5 + 0.002 * k for k in range(12)])
    episodes.add("orca", spl=[0.4 + 0.002 * k for k in range(12)])
    result = filled(episodes, table(SPL))
    assert entry(result, "Second").p == entry(result, "Third").p == 2 * 2 / 4096


def test_only_seeds_that_both_ran_are_compared(episodes):
    """Ahead over its own 100 episodes, behind on the 50 that both ran: nothing to tell."""
    episodes.add("neupan", success=ones(0, 50) + ones(50, 50))
    episodes.add("sac", success=ones(20, 50))
    result = filled(episodes, table())
    assert entry(result, "First").estimate.mean > entry(result, "Second").estimate.mean
    assert entry(result, "Second").p == 1.0
    assert bold(result) == set()


def test_methods_without_a_seed_in_common_are_not_told_apart(episodes):
    episodes.add("neupan", success=ones(50, 50))
    episodes.add("sac", success=ones(0, 50), first=50)
    result = filled(episodes, table())
    assert math.isnan(entry(result, "Second").p)
    assert bold(result) == set()


# Formats


HOSTILE = r"a|b & 50% $x_1$ #{~^\}<script>*`[bold]"
HOSTILE_TABLE = table(
    methods=(Method("neupan", HOSTILE, 100), *METHODS[1:]),
    blocks=(replace(SLOW, heading=HOSTILE),),
    note=HOSTILE,
)


def balanced(text):
    """Braces and environments close in order; no special character stands alone."""
    bare = re.sub(r"\\[\\{}&%$#_]", "", text.replace(r"\\", ""))
    depth = 0
    for character in bare:
        depth += (character == "{") - (character == "}")
        assert depth >= 0
    assert depth == 0
    opened = []
    for kind, name in re.findall(r"\\(begin|end)\{(\w+)\}", text):
        if kind == "begin":
            opened.append(name)
        else:
            assert opened.pop() == name
    assert not opened
    assert "%" not in bare and "#" not in bare and "_" not in re.sub(r"\\label\{.*?\}", "", bare)
    assert "^" not in bare and "~" not in bare


@pytest.mark.parametrize("wanted", [*TABLES, HOSTILE_TABLE], ids=lambda t: t.title[:20])
def test_latex_is_well_formed(many, episodes, wanted):
    result = filled(episodes, wanted) if wanted is HOSTILE_TABLE else fill(wanted, many.measured())
    text = latex(result)
    balanced(text)
    body = text[text.index(r"\toprule") : text.index(r"\bottomrule")]
    rows = [line for line in body.splitlines() if line.endswith(r"\\")]
    spanning = [line for line in rows if line.startswith(r"\multicolumn")]
    plain = [line for line in rows if line not in spanning]
    columns = len(wanted.quantities) + 1
    for line in plain:
        assert len(re.findall(r"(?<!\\)&", line)) == columns - 1, line
    methods = len(wanted.methods) * len(wanted.blocks)
    assert len(plain) == 1 + 2 * methods, "a heading, then two lines per method"
    for line in spanning:
        assert line.startswith(rf"\multicolumn{{{columns}}}{{l}}")


def test_hostile_names_stay_in_their_markdown_cell(episodes):
    result = filled(episodes, HOSTILE_TABLE)
    text = markdown(result)
    lines = [line for line in text.splitlines() if line.startswith("|")]
    for line in lines:
        assert len(re.findall(r"(?<!\\)\|", line)) == 3, line
    assert "<script>" not in text


def test_hostile_names_are_printed_as_they_are(episodes):
    printed = "".join(shown(filled(episodes, HOSTILE_TABLE)).split())
    assert "".join(HOSTILE.split()) in printed


def test_csv_gives_back_what_went_in(episodes):
    episodes.add("neupan", success=ones(90, 100))
    rows = list(csv.DictReader(io.StringIO(csv_text(filled(episodes, HOSTILE_TABLE)))))
    assert rows[0]["method"] == rows[0]["block"] == HOSTILE
    assert float(rows[0]["value"]) == 0.9
    assert float(rows[0]["low"]) == pytest.approx(0.825634, abs=1e-6)
    assert (rows[0]["agent"], rows[0]["reference"], rows[0]["planned"]) == ("neupan", "1", "100")
    assert rows[1]["value"] == ""


@given(st.text(max_size=40))
def test_any_text_is_safe_in_latex_and_markdown(text):
    balanced(escape_latex(text))
    assert not re.search(r"(?<!\\)&", escape_latex(text))
    line = escape_markdown(text)
    assert len(line.splitlines()) <= 1
    assert "<" not in line and not re.search(
        r"(?<!\\)(\\\\)*[|`]", line.replace(r"\|", "").replace(r"\`", "")
    )


def test_no_number_is_left_out_of_the_formats(many):
    """Every cell's value stands in Markdown, LaTeX, CSV and on the terminal."""
    for wanted in TABLES:
        result = fill(wanted, many.measured())
        cells_there = len(result.entries)
        assert len(csv_text(result).splitlines()) == cells_there + 1
        brackets = [
            len(re.findall(r"\[[\d.]+, [\d.]+\]", text))
            for text in (markdown(result), shown(result))
        ]
        with_interval = sum(not np.isnan(cell.estimate.low) for cell in result.entries)
        assert brackets == [with_interval, with_interval]
        assert latex(result).count(r"{\tiny {[}") == with_interval


def test_every_planned_cell_is_in_a_table_or_figure(many):
    """The whole plan is loaded, and a table reads nothing outside it."""
    measured = many.measured()
    assert len(measured.episodes) == 10 * len(cells())
    for wanted in TABLES:
        assert {cell.state for cell in fill(wanted, measured).entries} == {"partial"}
