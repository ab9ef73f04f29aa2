"""A real browser: headless Chromium through Playwright, and a page opened from the disk."""

from __future__ import annotations

import shutil
import tempfile

import pytest
from matplotlib.figure import Figure

from crowdbench.evaluation.joined import local_rows
from crowdbench.evaluation.results import scenario_label
from crowdbench.scenario import load_scenario
from crowdbench.site.website import SiteFigure, SiteTable, write_report_page

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
OPEN = load_scenario("multimodal_fast", time_limit=8.0)
CORRIDOR = load_scenario("corridor_dense")
TWO_ROBOTS = CORRIDOR.override({"robots.count": 2, "lidar.field_of_view": 200, "time_limit": 4.0})


@pytest.fixture(scope="session")
def stored(browser, make_whole, tmp_path_factory):
    """Whole episodes of three agents in three worlds: open, a corridor, one with two robots.

    ``worlds`` has their scenarios and ``labels`` how they are stored.
    """
    whole = make_whole(tmp_path_factory.mktemp("stored") / "results")
    for seed in (900000, 900001, 900002):
        for agent in ("orca", "straight_line"):
            whole.run(OPEN, agent, seed)
            whole.run(CORRIDOR, agent, seed)
        whole.run(CORRIDOR, "dynamic_window", seed)
    whole.run(TWO_ROBOTS, "straight_line", 900000)
    whole.worlds = {"open": OPEN, "corridor": CORRIDOR, "two_robots": TWO_ROBOTS}
    whole.labels = {name: scenario_label(world) for name, world in whole.worlds.items()}
    return whole


@pytest.fixture(scope="session")
def site(stored, tmp_path_factory):
    """The page of these, with a table and a figure."""
    folder = tmp_path_factory.mktemp("page")
    for ending in ("png", "pdf"):
        Figure(figsize=(2, 1)).savefig(folder / f"curve.{ending}")
    table = SiteTable("Table 1", "| Method | Success |\n| --- | ---: |\n| A | 0.9 [0.8, 1.0] |\n")
    figure = SiteFigure("Figure 1", "A curve.", folder / "curve.png", folder / "curve.pdf")
    rows = local_rows(stored.folder)
    written = write_report_page(rows, folder / "site", [table], [figure])
    return written.page.as_uri()


@pytest.fixture(scope="session")
def browser():
    """Chromium, or a reason why there is none."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="Playwright is not installed (pip install playwright)"
    )
    if CHROMIUM is None:
        pytest.skip("there is no Chromium (on Debian: apt-get install chromium)")
    with playwright.sync_playwright() as started, tempfile.TemporaryDirectory() as profile:
        browser = started.chromium.launch_persistent_context(
            profile,
            executable_path=CHROMIUM,
            headless=True,
            args=FLAGS,
            viewport={"width": 1200, "height": 900},
        )
        yield browser
        browser.close()


@pytest.fixture
def page(browser):
    """A tab that complains about every error, and about everything asked of a network."""
    tab = browser.new_page()
    problems = []
    tab.on("console", lambda message: message.type == "error" and problems.append(message.text))
    tab.on("pageerror", lambda error: problems.append(str(error)))
    tab.on("requestfailed", lambda request: problems.append(f"failed: {request.url}"))
    tab.requests = []
    tab.on("request", lambda request: tab.requests.append(request.url))
    yield tab
    tab.close()
    assert problems == []
    assert [url for url in tab.requests if not url.startswith(("file:", "data:"))] == []
