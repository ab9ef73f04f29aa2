"""The scenarios that come with crowdbench: the twelve of the tables, and how they differ."""

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
    assert crowdbench.scenario_names() == expected


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
    for seed in range(900_000, 900_030):
        env.reset(seed=seed)
    state = env.state()
    gap = np.linalg.norm(state["pedestrian_position"] - state["robot_pose"][0, :2], axis=1)
    assert (gap - scenario.pedestrians.radius >= scenario.pedestrians.spawn_clearance).all()


@pytest.mark.parametrize("name", ["open", "corridor"])
def test_what_scenarios_extend_is_not_listed(name):
    assert name not in crowdbench.scenario_names()
