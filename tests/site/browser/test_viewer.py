"""The replay viewer in a real browser, against the episodes' logs."""

from __future__ import annotations

import shutil
import time
import urllib.parse

import numpy as np
import pytest

from crowdbench.agent import Agent
from crowdbench.evaluation.events import find_events
from crowdbench.evaluation.joined import local_rows
from crowdbench.robot import lidar_angles
from crowdbench.scenario import load_scenario
from crowdbench.simulation.lidar import beam_table, cast_rays, footprint_segments
from crowdbench.site.website import replay_link, write_report_page

CORRIDOR = "corridor_dense"
SEEDS = range(900000, 900003)
HOSTILE = [
    "<img src=x onerror=window.hacked=1>",
    "</script><script>window.hacked=1</script>",
    '" onmouseover="window.hacked=1" x="',
    "{{constructor.constructor('window.hacked=1')()}}",
    "__proto__",
    "a\u2028b & c?t=1#d",
]


def watch(page, site, scenario, agent, seed, robot="robot_0", wait=1, **more):
    """Open an episode, or ``wait`` of them, and wait until all are drawn."""
    link = replay_link(scenario, agent, seed, robot)
    page.goto(site + link + "".join(f"&{key}={value}" for key, value in more.items()))
    drawn(page, wait)


def until(page, expression, argument=None):
    """Wait for something to be true. Playwright's own waiting needs ``eval``, which is forbidden
    to the page, as it should be."""
    deadline = time.monotonic() + 30
    while not page.evaluate(expression, argument):
        assert time.monotonic() < deadline, expression
        page.wait_for_timeout(20)


def drawn(page, number=1):
    until(page, "number => window.crowdbench.viewer?.scenes.length === number", number)


def positions(page):
    return page.evaluate("crowdbench.viewer.positions()")


def assert_is_the_log(shown, episode, state):
    """What was drawn is the state of the log, to the last bit of a float32."""
    assert (shown["agent"], shown["seed"], shown["state"]) == (episode.agent, episode.seed, state)
    for name, array in (("robot", episode.robot_pose), ("people", episode.pedestrian_position)):
        np.testing.assert_array_equal(np.array(shown[name]), array[state].astype(np.float32))


def scrub(page, seconds):
    page.locator("#scrub").evaluate(
        """(slider, value) => {
            slider.value = value;
            slider.dispatchEvent(new Event("input"));
            slider.dispatchEvent(new Event("change"));
        }""",
        seconds,
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_a_deep_link_opens_this_moment_of_this_episode(page, site, stored, seed):
    episode = stored.episodes[stored.labels["open"], "straight_line", seed, "robot_0"]
    state = episode.steps // 2
    watch(
        page, site, stored.labels["open"], "straight_line", seed, t=state * episode.control_period
    )
    assert_is_the_log(positions(page)[0], episode, state)


def test_every_state_is_drawn_where_the_log_has_it(page, site, stored):
    episode = stored.episodes[CORRIDOR, "orca", 900001, "robot_0"]
    watch(page, site, CORRIDOR, "orca", 900001)
    for state in range(episode.steps + 1):
        scrub(page, state * episode.control_period)
        assert_is_the_log(positions(page)[0], episode, state)


def test_between_states_places_are_on_the_line_between(page, site, stored):
    episode = stored.episodes[CORRIDOR, "orca", 900001, "robot_0"]
    watch(page, site, CORRIDOR, "orca", 900001, t=2.25 * episode.control_period)
    for name, array in (
        ("robot", episode.robot_pose[:, :2]),
        ("people", episode.pedestrian_position),
    ):
        shown = np.array(positions(page)[0][name])[..., :2]
        np.testing.assert_allclose(shown, 0.75 * array[2] + 0.25 * array[3], atol=1e-6)


def test_who_enters_anew_does_not_slide_there(page, site, stored):
    watch(page, site, CORRIDOR, "straight_line", 900000)
    episode = {
        "period": 0.2, "steps": 2, "people": 2, "otherCount": 0, "others": [], "pose": [0] * 9,
        "motion": [0] * 4, "radii": [0.25] * 2, "intents": ["keep"],
        "position": [0, 0, 0, 1, 0.2, 0, -6, 1, 0.4, 0, -5.8, 1], "velocity": [1, 0] * 6,
        "legs": [[[0, 0, 9]]] * 2, "goals": [[[0, 9, 9]]] * 2, "sees": [[[0, 1]]] * 2,
    }  # fmt: skip
    between = page.evaluate(
        "episode => [0.1, 0.3].map(t => crowdbench.frame(episode, t).people.map(p => p.position))",
        episode,
    )
    np.testing.assert_allclose(between, [[[0.1, 0], [0, 1]], [[0.3, 0], [-5.9, 1]]], atol=1e-12)


def test_what_is_on_the_canvas_is_where_the_log_has_it(page, site, stored):
    """Colours under the places of the log: the robot's white arrow, blue people, a green goal."""
    episode = stored.episodes[CORRIDOR, "straight_line", 900000, "robot_0"]
    watch(page, site, CORRIDOR, "straight_line", 900000, t=0.4)
    for layer in ("lidar", "trails", "goals"):
        page.locator(f"#show-{layer}").uncheck()
    at = """([x, y]) => {
        const scene = crowdbench.viewer.scenes[0];
        const [column, row] = scene.project(x, y);
        return [...scene.context.getImageData(column, row, 1, 1).data].slice(0, 3);
    }"""
    for x, y in episode.pedestrian_position[2]:
        left = [x - 0.1, y - 0.2]  # off the dot that says where a person is going
        right = [x + 0.1, y + 0.2]
        assert [0, 114, 178] in (page.evaluate(at, left), page.evaluate(at, right))
    assert page.evaluate(at, episode.robot_pose[2, :2].tolist()) == [255, 255, 255]
    assert page.evaluate(at, episode.goal.tolist()) == [0, 158, 115]
    for x, y, _ in episode.obstacles:
        assert page.evaluate(at, [x, y]) == [135, 135, 135]


def test_steps_and_keys_go_from_state_to_state(page, site, stored):
    episode = stored.episodes[CORRIDOR, "orca", 900001, "robot_0"]
    watch(page, site, CORRIDOR, "orca", 900001, t=1.0)
    page.get_by_role("button", name="A step on").click()
    assert_is_the_log(positions(page)[0], episode, 6)
    page.get_by_role("button", name="A step back").click()
    page.get_by_role("button", name="A step back").click()
    assert_is_the_log(positions(page)[0], episode, 4)
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("ArrowRight")
    assert_is_the_log(positions(page)[0], episode, 5)
    page.get_by_role("button", name="To the beginning").click()
    assert_is_the_log(positions(page)[0], episode, 0)
    page.get_by_role("button", name="A step back").click()
    assert_is_the_log(positions(page)[0], episode, 0)


def test_it_plays_to_the_end_and_pauses(page, site, stored):
    episode = stored.episodes[CORRIDOR, "orca", 900001, "robot_0"]
    watch(page, site, CORRIDOR, "orca", 900001)
    page.select_option("#speed", "8")
    page.locator("#play").click()
    until(page, "crowdbench.viewer.positions()[0].time > 0.5")
    page.locator("#play").click()
    paused = positions(page)[0]["time"]
    page.wait_for_timeout(150)
    assert positions(page)[0]["time"] == paused
    page.locator("#play").click()
    until(page, "crowdbench.viewer.playing === null")
    assert_is_the_log(positions(page)[0], episode, episode.steps)


def test_two_agents_run_side_by_side_on_one_seed(page, site, stored):
    watch(page, site, CORRIDOR, "orca", 900002, t=1.0)
    page.select_option("#choose-with", "straight_line")
    drawn(page, 2)
    episodes = [
        stored.episodes[CORRIDOR, name, 900002, "robot_0"] for name in ("orca", "straight_line")
    ]
    shorter = min(episode.steps for episode in episodes)
    longest = max(episode.steps for episode in episodes)
    for state in (0, shorter // 2, longest):
        scrub(page, state * 0.2)
        for shown, episode in zip(positions(page), episodes, strict=True):
            assert_is_the_log(shown, episode, min(state, episode.steps))
    page.goto("about:blank")
    watch(page, site, CORRIDOR, "orca", 900002, wait=2, **{"with": "straight_line", "t": 1})
    for shown, episode in zip(positions(page), episodes, strict=True):
        assert_is_the_log(shown, episode, 5)


def test_the_address_follows_and_leads_back(page, site, stored):
    watch(page, site, CORRIDOR, "orca", 900000)
    scrub(page, 1.4)
    address = page.url
    assert page.locator("#link").evaluate("link => link.href") == address
    page.goto("about:blank")
    page.goto(address)
    drawn(page)
    assert_is_the_log(positions(page)[0], stored.episodes[CORRIDOR, "orca", 900000, "robot_0"], 7)
    page.select_option("#choose-seed", "900002")
    until(page, "crowdbench.viewer?.positions()[0]?.seed === 900002")
    query = urllib.parse.parse_qs(page.url.partition("?")[2])
    assert query["seed"] == ["900002"] and query["agent"] == ["orca"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"scenario": "nowhere"}, "No replays of scenario nowhere"),
        ({"agent": "<b>nobody</b>"}, "No replays of agent <b>nobody</b>"),
        ({"seed": 7}, "with seed 7"),
    ],
)
def test_a_link_to_what_is_not_there_says_so(page, site, change, told):
    place = {"scenario": CORRIDOR, "agent": "orca", "seed": 900000} | change
    page.goto(f"{site}#/replay?{urllib.parse.urlencode(place)}")
    assert told in page.locator("[role=alert]").inner_text()


def test_only_the_file_of_the_episode_is_loaded_and_only_once(page, site):
    page.goto(site)
    assert not [url for url in page.requests if "/replays/" in url]
    watch(page, site, CORRIDOR, "orca", 900000)
    watch(page, site, CORRIDOR, "orca", 900001)
    (loaded,) = [url for url in page.requests if "/replays/" in url]
    assert loaded.endswith("/corridor_dense/orca.0.js")


def test_marks_are_at_the_events_and_lead_there(page, site, stored):
    episode = next(
        episode
        for episode in stored.episodes.values()
        if {"ttc", "collision"} <= {event.kind for event in find_events(episode)}
        and episode.robot == "robot_0"
        and episode.scenario == CORRIDOR
    )
    events = find_events(episode)
    watch(page, site, CORRIDOR, episode.agent, episode.seed)
    marks = page.locator(".mark")
    width = page.locator(".track").evaluate("track => track.getBoundingClientRect().width")
    left = page.locator(".track").evaluate("track => track.getBoundingClientRect().left")
    assert marks.count() == len(events)
    for number, event in enumerate(events):
        mark = marks.nth(number)
        assert f"mark-{event.kind}" in mark.get_attribute("class")
        box = mark.bounding_box() or {}
        if event.kind not in ("ttc", "switch"):
            centre = box["x"] + box["width"] / 2
            assert (centre - left) / width == pytest.approx(event.first / episode.steps, abs=0.01)
        if event.kind == "ttc":
            assert (box["x"] - left) / width == pytest.approx(event.first / episode.steps, abs=0.01)
        if event.kind != "switch":
            mark.evaluate("mark => mark.click()")
            assert positions(page)[0]["state"] == event.first
    assert page.locator(".events li").count() == len(events)


def picture(page):
    return page.evaluate("crowdbench.viewer.scenes[0].canvas.toDataURL()")


def test_layers_are_drawn_only_while_they_are_switched_on(page, site, stored):
    seed = next(
        seed
        for seed in SEEDS
        for event in find_events(
            stored.episodes[stored.labels["open"], "straight_line", seed, "robot_0"]
        )
        if event.kind == "switch"
    )
    watch(page, site, stored.labels["open"], "straight_line", seed, t=1.0)
    assert page.locator(".mark-switch").first.is_hidden()
    for layer in ("lidar", "trails", "goals", "intents"):
        before = picture(page)
        box = page.locator(f"#show-{layer}")
        box.set_checked(not box.is_checked())
        assert picture(page) != before, layer
    assert page.locator(".mark-switch").first.is_visible()
    for layer in ("lidar", "trails", "goals", "intents"):
        box = page.locator(f"#show-{layer}")
        box.set_checked(not box.is_checked())


@pytest.mark.parametrize(
    ("name", "robot", "mount"),
    [
        ("open", "robot_0", [0.0, 0.0, 0.0]),
        ("two_robots", "robot_0", [0.0, 0.0, 0.0]),
        ("two_robots", "robot_1", [0.2, -0.1, 0.5]),
    ],
)
def test_the_lidar_is_the_simulations(page, site, stored, name, robot, mount):
    """Against the simulation's ray caster, in the same state of the log."""
    world, place = stored.worlds[name], stored.labels[name]
    episode = stored.episodes[place, "straight_line", 900000, robot]
    watch(page, site, place, "straight_line", 900000, robot)
    page.evaluate("(mount) => { crowdbench.viewer.scenes[0].lidar.mount = mount; }", mount)
    for state in (3, 0, episode.steps):
        scrub(page, state * episode.control_period)
        shown = page.evaluate("crowdbench.viewer.scenes[0].scan")
        x, y, heading = episode.robot_pose[state]
        turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        ahead, left = turn @ mount[:2]
        others = [
            footprint_segments(pose, *episode.footprint)
            for pose in episode.other_robots[state]
            if np.isfinite(pose).all()
        ]
        expected = np.empty(world.lidar.beams, dtype=np.float32)
        cast_rays(
            np.array([x + ahead, y + left, heading + mount[2]]),
            beam_table(lidar_angles(world)),
            np.column_stack([episode.pedestrian_position[state], episode.pedestrian_radius]),
            episode.obstacles,
            np.vstack([episode.walls, *others]),
            world.lidar.range,
            expected,
        )
        # A beam that grazes a disc may miss it after rounding to float32.
        apart = np.abs(np.array(shown) - expected)
        assert np.count_nonzero(apart > 1e-3) <= 1


class Fails(Agent):
    """Goes one step, says something and gives up."""

    def __init__(self, message):
        self.message = message

    def reset(self, robot, seed):
        self.gone = False

    def act(self, observation):
        if self.gone:
            raise RuntimeError(self.message)
        self.gone = True
        return 0.5, 0.0


def test_names_and_messages_from_outside_stay_text(whole, tmp_path, page):
    short = load_scenario("multimodal_fast", time_limit=0.4)
    for number, text in enumerate(HOSTILE):
        whole.run(short, [Fails(f"{text}{number}")], 900000, label=text)
        whole.run(short, "straight_line", 900000, name=text)
    site = write_report_page(local_rows(whole.folder), tmp_path / "site").page.as_uri()
    page.goto(site)
    shown = page.locator("tbody th").all_text_contents()
    headings = page.locator("h2").all_text_contents()
    assert set(HOSTILE) <= set(shown)
    assert {f"{text}@{short.digest} open, reactive" for text in HOSTILE} <= set(headings)
    for text in HOSTILE:
        page.goto(f"{site}#/agent?{urllib.parse.urlencode({'name': text})}")
        until(page, "text => document.querySelector('h1').textContent === text", text)
        page.locator("details", has_text="Errors").locator("summary").first.click()
        page.goto(site + replay_link(f"multimodal_fast@{short.digest}", text, 900000))
        until(page, "text => crowdbench.viewer?.positions()[0]?.agent === text", text)
        unknown = f"{text}@{short.digest}"
        page.goto(site + replay_link(unknown, "straight_line", 900000))
        drawn(page)
        assert page.locator("#choose-scenario").input_value() == unknown
    assert page.evaluate("window.hacked === undefined && ({}).hacked === undefined")
    assert page.locator("main img, main script, [onmouseover]").count() == 0


def test_a_missing_file_is_reported(browser, stored, tmp_path):
    """Somebody copied the page without its data; the browser's own complaint is expected here."""
    output = tmp_path / "site"
    write_report_page(local_rows(stored.folder), output)
    shutil.rmtree(output / "data" / "replays")
    tab = browser.new_page()
    tab.goto((output / "index.html").as_uri() + replay_link(CORRIDOR, "orca", 900000))
    tab.wait_for_selector("[role=alert]")
    assert "is missing beside this page" in tab.locator("[role=alert]").inner_text()
    tab.close()
