"""Everything but the replays, in a real browser."""

from __future__ import annotations

import numpy as np
import pytest

from crowdbench.evaluation.joined import local_rows
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.results import load_results
from crowdbench.site.website import write_report_page

VIEWS = ["", "#/", "#/tables", "#/agents", "#/agent?name=orca", "#/replay"]


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_view_loads_without_a_complaint(page, site, view, scheme):
    page.emulate_media(color_scheme=scheme)
    page.goto(site + view)
    assert page.locator("h1").count() == 1
    if view == "#/tables":
        image = page.locator("figure img").first
        image.scroll_into_view_if_needed()
        size = "document.querySelector('figure img').naturalWidth"
        page.wait_for_timeout(500)
        assert page.evaluate(size) > 0


@pytest.mark.parametrize("view", ["#/", "#/tables", "#/agent?name=orca", "#/replay"])
def test_nothing_is_wider_than_a_phone(page, site, view):
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto(site + view)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def board(page):
    return page.locator('.board[data-scenario="corridor_dense"]')


def agents_of(page):
    return board(page).locator("tbody th").all_inner_texts()


@pytest.mark.parametrize(
    ("metric", "better"), [("spl", "higher"), ("smoothness", "lower"), ("cutoff", "lower")]
)
def test_a_heading_sorts_best_first_and_again_the_other_way(page, site, stored, metric, better):
    rows = load_results(stored.folder, scenario="corridor_dense")
    means = rows.groupby("agent")[metric].mean().sort_values(ascending=better == "lower")
    page.goto(site)
    for expected in (means, means[::-1]):
        board(page).locator(f'[data-sort="{metric}"] button').click()
        shown = agents_of(page)
        assert sorted(shown) == sorted(expected.index)
        np.testing.assert_array_equal(means[shown], expected)
    heading = board(page).locator(f'[data-sort="{metric}"]')
    assert heading.get_attribute("aria-sort") == "descending"
    assert page.evaluate("document.activeElement.closest('th').dataset.sort") == metric


def test_the_numbers_are_the_rows(page, site, stored):
    rows = load_results(stored.folder, scenario="corridor_dense", agent="orca")
    page.goto(site)
    line = board(page).locator("tbody tr", has_text="orca")
    texts = line.locator("td.number").all_inner_texts()
    assert float(texts[0].split()[0]) == pytest.approx(rows["success"].mean(), abs=5e-3)
    assert float(texts[1].split()[0]) == pytest.approx(rows["spl"].mean(), abs=5e-3)
    assert float(texts[3].split()[0]) == pytest.approx(1000 * rows["inference_s"].mean(), rel=0.05)
    assert texts[-1] == "3"


def test_filters_leave_what_is_asked_for(page, site):
    page.goto(site)
    assert page.locator(".board").count() == 3
    page.select_option("#family", "open, reactive")
    assert page.locator(".board").count() == 1
    page.select_option("#family", "corridor")
    assert page.locator(".board").count() == 2
    assert sorted(agents_of(page)) == ["dynamic_window", "orca", "straight_line"]
    page.locator("#agents summary").click()
    page.get_by_label("straight_line").uncheck()
    assert sorted(agents_of(page)) == ["dynamic_window", "orca"]
    assert page.locator(".board").count() == 1, "nothing is left of the other corridor"
    page.get_by_label("All metrics").check()
    assert board(page).locator('[data-sort="jerk"]').count() == 1


def test_what_is_not_computed_is_told_from_what_is_not_defined(page, episodes, tmp_path):
    episodes.add("orca", success=[1.0, 1.0], older=["jerk"])
    written = write_report_page(local_rows(episodes.folder), tmp_path / "site")
    page.goto(written.page.as_uri())
    page.get_by_label("All metrics").check()
    shown = dict(zip(["", *METRICS], page.locator("tbody tr > *").all_inner_texts(), strict=False))
    assert (shown["jerk"], shown["robot_at_fault"]) == ("not computed", "–")
