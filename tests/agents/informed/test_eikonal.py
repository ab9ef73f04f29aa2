"""Lengths of shortest paths on maps."""

from __future__ import annotations

import numpy as np
import pytest
from crowdbench_agents.informed.agent import Informed
from crowdbench_agents.informed.distance_field import DistanceField, look_up
from map_scenarios import hall
from shapely import LineString, Point

import crowdbench
from crowdbench.simulation.ways import Ways

NO_DISCS = np.empty((0, 3))


def length(field, goal, place):
    return look_up(*place, *goal, field.origin, field.values)


def test_around_the_end_of_a_wall_the_way_has_the_length_of_tangents_and_arc():
    """Both ends 2 m from the wall, which ends 1 m above them; the arc has the clearance."""
    walls, clearance = np.array([[0.0, -5.0, 0.0, 1.0]]), 0.2
    goal, place = np.array([2.0, 0.0]), np.array([-2.0, 0.0])
    field = DistanceField(goal, place, NO_DISCS, walls, clearance)
    corner = LineString([goal, (0, 1)]).length
    tangent = np.sqrt(corner**2 - clearance**2)
    # Between the tangent points.
    turn = 2 * (np.arctan2(1, 2) + np.arcsin(clearance / corner))
    assert length(field, goal, place) == pytest.approx(2 * tangent + clearance * turn, rel=0.04)
    assert field.winds


def test_on_random_maps_lengths_are_those_of_the_ways_that_people_walk():
    rng, compared = np.random.default_rng(5), 0
    for _ in range(4):
        walls, discs = rng.uniform(-5, 5, (3, 4)), np.array([[*rng.uniform(-4, 4, 2), 0.5]])
        ways = Ways(walls, discs, 0.25)
        free = [p for p in rng.uniform(-5, 5, (30, 2)) if ways.is_free(p)]
        goal, *places = free
        field = DistanceField(goal, places[0], discs, walls, 0.25)
        for place in places:
            exact = ways.length(place, goal)
            if np.isfinite(exact) and exact > 0.5:
                assert 0.97 * exact - 0.1 <= length(field, goal, place) <= 1.06 * exact + 0.15
                compared += 1
    assert compared > 60


def test_what_is_walled_in_has_no_way_and_a_narrow_door_is_one():
    box = np.array([[-1, -1, 1, -1], [1, -1, 1, 1], [1, 1, -1, 1], [-1, 1, -1, -1.0]])
    start, goal = np.array([0.0, 0.0]), np.array([3.0, 0.0])
    closed = DistanceField(goal, start, NO_DISCS, box, 0.25)
    assert length(closed, goal, start) > 1000
    door = np.vstack([box[[0, 2, 3]], [[1, -1, 1, -0.2], [1, 0.2, 1, 1]]])
    opened = DistanceField(goal, start, NO_DISCS, door, 0.25)
    assert length(opened, goal, start) == pytest.approx(3.0, abs=0.05)


def test_corridors_have_no_way_around_their_walls():
    corridor = np.array([[-6, 2, 6, 2], [-6, -2, 6, -2.0]])
    inside = [np.array([-4.0, 0.0]), np.array([4.0, 0.0])]
    assert not DistanceField(*inside, NO_DISCS, corridor, 0.25).winds
    assert DistanceField(*inside, NO_DISCS, corridor[:1], 0.25).winds
    assert DistanceField(*inside, NO_DISCS, np.vstack([corridor, [[0, -2, 0, 0]]]), 0.25).winds


def test_on_a_map_it_finds_the_door_and_arrives():
    scenario = hall(pedestrians__count=4, pedestrians__reactive=0)
    env = crowdbench.parallel_env(scenario)
    for seed in (900_000, 900_001):
        observations, infos = env.reset(seed=seed)
        agent = Informed()
        agent.reset(env.robot_spec(), seed)
        places = []
        while env.agents:
            state = env.state()
            places.append(state["robot_pose"][0, :2])
            seen = crowdbench.Observation(**observations["robot_0"], state=state)
            observations, *_, infos = env.step({"robot_0": agent.act(seen)})
        assert infos["robot_0"]["outcome"] == "success"
        way = Ways(state["walls"], NO_DISCS, 0.2).length(places[0], state["robot_goal"][0])
        assert LineString(places).length < 1.15 * way
        assert Point(0, 0).distance(LineString(places)) < 1.0
