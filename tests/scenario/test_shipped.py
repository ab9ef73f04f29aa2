"""The scenarios that come with crowdbench: the twelve of the tables, and the hard tier."""

from importlib import resources

import numpy as np
import pytest

import crowdbench

OPEN = [f"{goals}_{speed}" for goals in ("unimodal", "multimodal") for speed in ("slow", "fast")]
CORRIDORS = {
    "corridor_sparse": (2, 0),
    "corridor_moderate": (3, 2),
    "corridor_dense": (3, 4),
    "corridor_very_dense": (4, 6),
}

HARD = [
    f"hard_{name}"
    for name in ("open_dense", "mixed_attention", "plaza_groups", "two_streams", "crossing_streams")
    + ("against_stream", "corridor_groups", "station")
]
SITUATIONS = [
    f"situation_{name}"
    for name in ("frontal", "overtaken", "overtaking", "blind_corner", "doorway", "t_junction")
    + ("leaving_room", "queue")
]


def world(name):
    """Everything that a scenario says about its world, flat."""
    document = crowdbench.load_scenario(name).model_dump(exclude={"name", "description"})
    flat = {}
    for key, value in document.items():
        flat |= (
            {f"{key}.{k}": v for k, v in value.items()} if isinstance(value, dict) else {key: value}
        )
    return flat


def differences(first, second):
    a, b = world(first), world(second)
    return {key for key in a if a[key] != b[key]}


def test_the_twelve_are_listed_in_the_order_of_the_tables():
    expected = [*OPEN, *(f"{name}_nonreactive" for name in OPEN), *CORRIDORS]
    assert crowdbench.scenario_names("paper") == expected


@pytest.mark.parametrize("name", OPEN)
def test_twins_differ_in_whether_people_see_the_robot_and_in_nothing_else(name):
    assert differences(name, f"{name}_nonreactive") == {"pedestrians.reactive"}


@pytest.mark.parametrize("ending", ["", "_nonreactive"])
def test_slow_and_fast_differ_in_speed_and_uni_and_multimodal_in_goals_only(ending):
    for goals in ("unimodal", "multimodal"):
        pair = f"{goals}_slow{ending}", f"{goals}_fast{ending}"
        assert differences(*pair) == {"pedestrians.speed"}
    for speed in ("slow", "fast"):
        pair = f"unimodal_{speed}{ending}", f"multimodal_{speed}{ending}"
        assert differences(*pair) == {"pedestrians.goals"}


def test_corridors_differ_in_their_counts_only():
    for name, counts in CORRIDORS.items():
        scenario = crowdbench.load_scenario(name)
        assert (scenario.obstacles.count, scenario.pedestrians.count) == counts
        differing = differences("corridor_sparse", name)
        assert differing <= {"obstacles.count", "pedestrians.count"}


@pytest.mark.parametrize("name", OPEN)
def test_people_in_the_open_are_enough_and_walk_like_people(name):
    people = crowdbench.load_scenario(name).pedestrians
    assert people.count >= 6
    low, high = people.speed
    assert (low >= 0.3 and high <= 0.6) if "slow" in name else (low >= 0.7 and high <= 1.1)


@pytest.mark.parametrize("name", crowdbench.scenario_names())
def test_every_scenario_has_a_description_and_room(name):
    scenario = crowdbench.load_scenario(name)
    assert 20 < len(scenario.description) < 100
    env = crowdbench.parallel_env(scenario)
    for seed in range(900_000, 900_010):
        env.reset(seed=seed)
    state = env.state()
    gap = np.linalg.norm(state["pedestrian_position"] - state["robot_pose"][0, :2], axis=1)
    clear = gap - state["pedestrian_radius"] >= scenario.pedestrians.spawn_clearance
    assert clear[state["pedestrian_speed"] > 0].all()


@pytest.mark.parametrize("name", [*HARD, *SITUATIONS])
def test_the_robot_of_the_hard_tier_is_one_that_can_be_bought(name):
    scenario = crowdbench.load_scenario(name)
    assert scenario.robots.acceleration == (1.0, 3.0)
    assert (scenario.robots.latency, scenario.lidar.noise, scenario.lidar.dropout) == (
        1,
        0.02,
        0.01,
    )
    assert scenario.pedestrians.leg_from == "goal"


@pytest.mark.parametrize("name", [*HARD, *SITUATIONS])
def test_a_hard_scenario_is_a_page_of_twenty_five_lines_at_most(name):
    text = (resources.files("crowdbench_scenarios") / f"{name}.yaml").read_text()
    assert len(text.splitlines()) <= 25


def test_tiers_are_listed_by_how_hard_they_are():
    assert crowdbench.scenario_tiers() == ["paper", "hard", "situation"]
    assert crowdbench.scenario_names("hard") == HARD
    assert crowdbench.scenario_names("situation") == SITUATIONS
    assert crowdbench.scenario_names() == [*crowdbench.scenario_names("paper"), *HARD, *SITUATIONS]


@pytest.mark.parametrize("name", ["open", "corridor", "hard", "situation"])
def test_what_scenarios_extend_is_not_listed(name):
    assert name not in crowdbench.scenario_names()
