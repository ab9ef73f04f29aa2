"""A world into which somebody cannot fit, whatever the seed, is refused before anything runs."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench.scenario import ScenarioError, load_scenario
from crowdbench.simulation.layout import place

SLOW = load_scenario("unimodal_slow")
LARGE = {"robots.length": 1.6, "robots.width": 1.2}  # 2 m across


@pytest.mark.parametrize(
    ("name", "changes", "field", "inside", "outside"),
    [
        ("corridor_sparse", {**LARGE, "obstacles.count": 0}, "arena.width", 2.01, 1.99),
        ("unimodal_slow", {**LARGE, "arena.length": 12}, "arena.width", 2.01, 1.99),
        ("corridor_sparse", {}, "robots.travel", 11.49, 11.51),
        ("corridor_sparse", LARGE, "robots.travel", 9.99, 10.01),
        ("unimodal_slow", {}, "robots.travel", 9.49 * math.sqrt(2), 9.51 * math.sqrt(2)),
        ("unimodal_slow", {"arena.length": 20}, "arena.width", 0.51, 0.49),
        ("corridor_dense", {"obstacles.radius": [0.7, 0.7]}, "arena.width", 2.5, 2.29),
        ("unimodal_slow", {"pedestrians.radius": 2, "robots.travel": 1}, "arena.width", 4.1, 3.9),
    ],
)
def test_the_bound_is_named_with_the_field(name, changes, field, inside, outside):
    load_scenario(name, **{**changes, field: inside})
    with pytest.raises(ScenarioError) as caught:
        load_scenario(name, **{**changes, field: outside})
    message = str(caught.value)
    assert f"{field}: {outside:g} m" in message
    assert "allowed: " in message
    assert "\n" not in message


@pytest.mark.parametrize(
    "changes",
    [
        {"arena.width": 0.71, "robots.length": 0.5, "robots.width": 0.5},
        {"arena.length": 10.5, "arena.width": 0.51},
    ],
)
def test_what_is_just_allowed_is_placed(changes):
    scenario = load_scenario("corridor_sparse", **changes, **{"obstacles.count": 0})
    for seed in range(20):
        place(scenario, seed)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"lidar.mount": [0.21, 0, 0]}, "lidar.mount: x = 0.21 m lies outside the footprint "),
        ({"lidar.mount": [0, -0.16, 0]}, "(robots.width 0.3 m); allowed: -0.15 to 0.15"),
        ({"lidar.mount": [0, 0]}, "lidar.mount: expected three numbers, x and y [m] and heading "),
        ({"lidar.mount": [0, 0, 4]}, "lidar.mount: 4 is out of range; allowed: >= -3.15 and "),
        ({"robots.latency": -1}, "robots.latency: -1 is out of range; allowed: >= 0 and <= 50"),
        ({"robots.latency": 0.5}, "robots.latency: expected a whole number >= 0 and <= 50"),
        (
            {"robots.latency": 20, "time_limit": 4},
            "robots.latency: 20 control periods, and time_limit is over after 20; allowed: <= 19",
        ),
        ({"robots.odometry": 0.1}, "robots.odometry: expected a section of `key: value` lines"),
        (
            {"robots.odometry.translation": -0.1},
            "robots.odometry.translation: -0.1 is out of range; allowed: >= 0 and <= 1",
        ),
        (
            {"robots.odometry.turn": 0.1},
            "unknown key 'robots.odometry.turn'; known: rotation, rotation_by_translation, ",
        ),
    ],
)
def test_a_robot_that_cannot_be_is_refused_with_what_can(changes, told):
    with pytest.raises(ScenarioError) as caught:
        load_scenario("unimodal_slow", **changes)
    assert told in str(caught.value) and "\n" not in str(caught.value)


def test_a_lidar_may_be_at_the_edge_of_the_robot():
    load_scenario("unimodal_slow", **{"lidar.mount": [0.2, -0.15, -3.0]})


def test_the_stated_bound_is_itself_allowed():
    with pytest.raises(ScenarioError, match=r"allowed: <= 9\.5, or arena.length >= 12\.5$"):
        load_scenario("unimodal_slow", **{"arena.kind": "corridor", "robots.travel": 12})
    load_scenario("unimodal_slow", **{"arena.kind": "corridor", "robots.travel": 9.5})
    load_scenario(
        "unimodal_slow",
        **{"arena.kind": "corridor", "robots.travel": 12, "arena.length": 12.5},
    )


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(["open", "corridor"]), st.floats(0.3, 3), st.floats(0.3, 2), st.floats(15, 60)
)
def test_any_stated_bound_is_itself_allowed(kind, length, width, travel):
    changes = {"arena.kind": kind, "pedestrians.count": 0, "obstacles.count": 0}
    changes |= {"robots.length": length, "robots.width": width, "robots.travel": travel}
    with pytest.raises(ScenarioError) as caught:
        SLOW.override(changes)
    most, least = map(float, re.findall(r"= ([0-9.]+)", str(caught.value)))
    place(SLOW.override({**changes, "robots.travel": most}), 0)
    fitting = {**changes, "arena.length": least}
    place(SLOW.override(fitting), 0)
    with pytest.raises(ScenarioError) as caught:
        SLOW.override({**fitting, "arena.width": 0.1})
    (least,) = map(float, re.findall(r"= ([0-9.]+)", str(caught.value)))
    place(SLOW.override({**fitting, "arena.width": least, "arena.length": 90}), 0)
