"""Motion against closed forms, contacts against shapely, people against their own seed."""

import numpy as np
import pytest
from bodies import footprint, turn
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Point

from crowdbench import Scenario
from crowdbench.simulation import streams
from crowdbench.simulation.lanes import LEGS_AHEAD
from crowdbench.simulation.pedestrians import ARRIVAL, DIVERT, KEEP, RETURN
from crowdbench.simulation.world import World

ALONE = Scenario(name="alone", pedestrians={"count": 0})
CROWD = Scenario(name="crowd", pedestrians={"count": 8, "goals": "multimodal"})


@given(v=st.floats(0, 1), w=st.floats(-1.5, 1.5), steps=st.integers(1, 10))
@settings(deadline=None, max_examples=30)
def test_a_robot_follows_the_exact_arc(v, w, steps):
    world = World(ALONE, 0)
    x, y, heading = world.pose[0].copy()
    for _ in range(steps):
        world.step(np.array([[v, w]]))
    duration, end = steps * 0.2, heading + w * steps * 0.2
    if abs(w) > 1e-6:
        expected = (
            x + v / w * (np.sin(end) - np.sin(heading)),
            y - v / w * (np.cos(end) - np.cos(heading)),
        )
    else:
        expected = x + v * duration * np.cos(heading), y + v * duration * np.sin(heading)
    np.testing.assert_allclose(world.pose[0], [*expected, end], atol=1e-6)


def test_acceleration_limits_bound_the_change_of_velocity():
    world = World(ALONE.override({"robots.acceleration": [0.5, 1.0]}), 0)
    seen = []
    for _ in range(4):
        world.step(np.array([[1.0, -1.5]]))
        seen.append(world.velocity[0].copy())
    np.testing.assert_allclose(seen, [[0.1, -0.2], [0.2, -0.4], [0.3, -0.6], [0.4, -0.8]])


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_contact_is_reported_when_and_only_when_shapes_meet(seed):
    """Against shapely at every physics step: substeps are made the control steps."""
    scenario = CROWD.override(
        {"pedestrians.reactive": 0.0, "control_period": 0.05, "substeps": 1,
         "pedestrians.speed": [0.7, 1.1], "pedestrians.spawn_clearance": 0.0}
    )  # fmt: skip
    world = World(scenario, seed)
    command = np.array([[1.0, np.random.default_rng(seed).uniform(-0.5, 0.5)]])
    for _ in range(200):
        world.step(command)
        people = [Point(p).buffer(0.25, quad_segs=200) for p in world.pedestrians.position]
        gaps = np.array([footprint(world.pose[0]).distance(person) for person in people])
        if world.contacts:
            contact = world.contacts[0]
            assert contact.kind == "pedestrian"
            assert gaps[contact.index] < 1e-3
            return
        overlap = max(footprint(world.pose[0]).intersection(person).area for person in people)
        assert overlap < 1e-4


def test_a_contact_names_what_was_hit_and_who_drove_into_whom():
    scenario = Scenario(
        name="corridor", arena={"kind": "corridor", "length": 10, "width": 4},
        pedestrians={"count": 0},
    )  # fmt: skip
    world = World(scenario, 3)
    turn(world, 0, np.pi / 2)
    for _ in range(40):
        world.step(np.array([[0.5, 0.0]]))
    contact = world.contacts[0]
    assert (contact.kind, contact.index) == ("wall", 1)
    assert contact.robot_speed == pytest.approx(0.5)
    assert contact.other_speed == 0.0


def test_a_standing_robot_is_walked_into():
    scenario = Scenario(
        name="s", pedestrians={"count": 8, "reactive": 0.0, "speed": [1.0, 1.0]},
        time_limit=400,
    )  # fmt: skip
    world = World(scenario, 5)
    while not world.contacts:
        world.step(np.zeros((1, 2)))
    contact = world.contacts[0]
    assert contact.kind == "pedestrian"
    assert contact.robot_speed == 0.0
    assert 0.0 < contact.other_speed <= 1.0


def drive(scenario, seed, speed, steps=150):
    world, legs = World(scenario, seed), []
    for _ in range(steps):
        world.step(np.array([[speed, 0.3]]))
        people = world.pedestrians
        legs.append(np.hstack([people.goal, people.start, people.intent[:, None]]))
    return world, np.array(legs)


def test_a_pedestrians_draws_do_not_depend_on_the_robot():
    """Each pedestrian's stream and first goals are the same, whoever drives how."""
    still, moving = World(CROWD, 11), World(CROWD, 11)
    np.testing.assert_array_equal(still.pedestrians.goal, moving.pedestrians.goal)
    unseen = CROWD.override({"pedestrians.reactive": 0.0, "pedestrians.model": "straight"})
    _, first = drive(unseen, 11, 0.0, steps=60)
    _, second = drive(unseen, 11, 0.4, steps=60)
    touched = World(unseen, 11)
    np.testing.assert_array_equal(first[0], second[0])
    # A leg begun at the same place at the same time draws the same goal.
    same_start = (first[..., 2:4] == second[..., 2:4]).all(axis=-1)
    assert same_start.mean() > 0.8
    np.testing.assert_array_equal(first[same_start], second[same_start])
    assert len(touched.pedestrians.goal) == 8


@pytest.mark.parametrize("goals", ["unimodal", "multimodal"])
def test_legs_from_the_last_goal_lead_to_the_same_goals_whatever_is_in_the_way(goals):
    """Places that legs end in: the goal, or the one after a change of mind."""
    scenario = CROWD.override(
        {"pedestrians.goals": goals, "pedestrians.leg": 4.0, "pedestrians.speed": [1.8, 2.0]}
    )

    def differing(leg_from):
        chosen = scenario.override({"pedestrians.leg_from": leg_from})
        ends = [[], []]
        for found, speed in zip(ends, (0.0, 0.4), strict=True):
            world = World(chosen, 11)
            found += [[] for _ in world.pedestrians.speed]
            for _ in range(300):
                for p, end in enumerate(world.pedestrians.next_goal.tolist()):
                    if end not in found[p][-1:]:
                        found[p].append(end)
                world.step(np.array([[speed, 0.3]]))
        assert sum(map(len, ends[0])) > 50
        pairs = [zip(*both, strict=False) for both in zip(*ends, strict=True)]
        return sum(one != other for pair in pairs for one, other in pair)

    assert differing("position") > 0
    assert differing("goal") == 0


def test_adding_a_pedestrian_leaves_the_others_draws_alone():
    fewer = World(CROWD, 4).pedestrians.speed
    more = World(CROWD.override({"pedestrians.count": 9}), 4).pedestrians.speed
    np.testing.assert_array_equal(fewer, more[:8])


def test_every_leg_takes_its_goal_from_the_next_draws_of_its_pedestrian():
    """Also beyond those that are drawn ahead: against the stream itself."""
    scenario = Scenario(
        name="alone", arena={"length": 6, "width": 6}, robots={"travel": 4, "speed": [0, 0]},
        pedestrians={"count": 1, "speed": [2, 2], "leg": 1, "model": "straight"},
    )  # fmt: skip
    world, stream = World(scenario, 5), streams.pedestrian(5, 0)
    stream.random()  # its speed
    legs, goal = 0, np.zeros(2)
    for _ in range(200):
        if (world.pedestrians.goal[0] != goal).any():
            legs, goal = legs + 1, world.pedestrians.goal[0].copy()
            places = (2 * stream.random(67)[:32].reshape(16, 2) - 1) * 2.75
            assert (places == goal).all(axis=1).any()
        world.step(np.zeros((1, 2)))
    assert legs > 3 * LEGS_AHEAD


def test_unimodal_legs_are_kept_until_arrival():
    world = World(CROWD.override({"pedestrians.goals": "unimodal"}), 2)
    for _ in range(150):
        goals = world.pedestrians.goal.copy()
        positions = world.pedestrians.position.copy()
        world.step(np.zeros((1, 2)))
        changed = (world.pedestrians.goal != goals).any(axis=1)
        distance = np.linalg.norm(goals - positions, axis=1)
        assert (distance[changed] < ARRIVAL).all()
        assert np.isinf(world.pedestrians.switch_time).all()


def test_multimodal_legs_are_interrupted_at_their_time_for_the_announced_goal():
    scenario = CROWD.override({"pedestrians.switch_probability": 1.0, "robots.travel": 13.4})
    world, kinds = World(scenario, 7), []
    for _ in range(150):
        people = world.pedestrians
        due = world.time >= people.switch_time
        announced, starts, intents = (
            people.next_goal.copy(),
            people.start.copy(),
            people.intent.copy(),
        )
        world.step(np.zeros((1, 2)))
        for p in np.flatnonzero(due):
            np.testing.assert_array_equal(people.goal[p], announced[p])
            if intents[p] == RETURN:
                np.testing.assert_array_equal(people.goal[p], starts[p])
            assert people.intent[p] == KEEP
            kinds.append(int(intents[p]))
    assert {RETURN, DIVERT} == set(kinds)
    assert 0.25 < np.mean(np.array(kinds) == RETURN) < 0.75


def test_people_who_stop_on_arrival_stand_still():
    scenario = CROWD.override({"pedestrians.on_arrival": "stop", "pedestrians.goals": "unimodal"})
    world = World(scenario, 1)
    for _ in range(300):
        world.step(np.zeros((1, 2)))
    assert np.linalg.norm(world.pedestrians.velocity, axis=1).max() < 0.05


@pytest.mark.parametrize("model", ["orca", "social_force"])
def test_people_do_not_walk_through_each_other(model):
    world = World(CROWD.override({"pedestrians.model": model}), 9)
    for _ in range(200):
        world.step(np.zeros((1, 2)))
        gaps = np.linalg.norm(
            world.pedestrians.position[:, None] - world.pedestrians.position, axis=2
        )
        assert gaps[np.triu_indices(8, 1)].min() > 0.5 - 0.08


def test_a_robot_that_has_left_is_neither_seen_nor_touched():
    scenario = Scenario(name="two", robots={"count": 2}, pedestrians={"count": 2})
    world = World(scenario, 0)
    world.remove(0)
    world.remove(0)  # changes nothing any more
    before = world.pose[0].copy()
    for _ in range(20):
        world.step(np.array([[1.0, 0.0], [0.0, 0.0]]))
    np.testing.assert_array_equal(world.pose[0], before)
    assert 0 not in world.contacts
