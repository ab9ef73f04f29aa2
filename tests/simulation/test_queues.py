"""Queues: lines stay lines, first come is first served, and everything in them has room."""

import numpy as np
import pytest
from alike import assert_lanes_alike

from crowdbench import Scenario, ScenarioError
from crowdbench.simulation.layout import place
from crowdbench.simulation.world import World

HALL = Scenario(
    name="hall",
    time_limit=60,
    pedestrians={
        "count": 12, "speed": [0.8, 1.2], "standing": 0.1,
        "queues": [
            {"head": [3, 3], "direction": 90, "count": 4, "service": [2, 3]},
            {"head": [-1, -2], "count": 3, "spacing": 1.0},
        ],
    },
)  # fmt: skip
FIRST, SECOND = [0, 1, 2, 3, 7], [4, 5, 6, 8]


def places(head, back, count, spacing):
    return np.array(head) + spacing * np.arange(count)[:, None] * np.array(back)


def test_people_begin_in_their_places_facing_the_head_and_one_more_is_away():
    world = World(HALL, 0)
    people = world.pedestrians
    np.testing.assert_allclose(people.position[:4], places([3, 3], [0, -1], 4, 0.8))
    np.testing.assert_allclose(people.position[4:7], places([-1, -2], [-1, 0], 3, 1.0))
    np.testing.assert_array_equal(people.queue, [0] * 4 + [1] * 3 + [0, 1] + [-1] * 3)
    np.testing.assert_array_equal(people.place, [0, 1, 2, 3, 0, 1, 2] + [-1] * 5)
    headings = world.worlds.state.people["heading"][0]
    np.testing.assert_allclose(headings[:7], [np.pi / 2] * 4 + [0] * 3)
    assert (people.velocity[:7] == 0).all() and (people.velocity[7:9] != 0).any()


@pytest.mark.parametrize("model", ["orca", "social_force"])
def test_a_line_moves_up_as_the_first_is_served_and_keeps_its_length(model):
    world = World(HALL.override({"pedestrians.model": model}), 3)
    served, waits = [], []
    for _ in range(300):
        before = world.pedestrians.place.copy()
        first = int(np.flatnonzero((before == 0) & (world.pedestrians.queue == 0))[0])
        due = world.pedestrians.served_time[first]
        time = world.time
        world.step(np.zeros((1, 2)))
        after = world.pedestrians.place
        for members in (FIRST, SECOND):
            assert sorted(after[members]) == list(range(-1, len(members) - 1))
        if after[first] < 0:  # everybody else one forward, who was away the last
            assert time >= due
            others = [p for p in FIRST if p != first]
            expected = np.where(before[others] < 0, 3, before[others] - 1)
            np.testing.assert_array_equal(after[others], expected)
            served.append(first)
        elif np.isfinite(world.pedestrians.served_time[first]) and not np.isfinite(due):
            waits.append(world.pedestrians.served_time[first] - time)
            assert np.linalg.norm(world.pedestrians.position[first] - [3, 3]) < 0.5
    assert len(served) > 6
    assert served[:5] == FIRST  # who was away came last
    assert min(waits) >= 2 and max(waits) <= 3
    assert np.ptp(waits) > 0.2


def test_how_long_somebody_is_served_is_the_same_whatever_the_robot_does():
    still, driving = World(HALL, 5), World(HALL, 5)
    times = []
    for world, speed in ((still, 0.0), (driving, 0.5)):
        begun = {}
        for _ in range(250):
            before = world.pedestrians.served_time.copy()
            time = world.time
            world.step(np.array([[speed, 0.3]]))
            if world.contacts and world.active[0]:
                world.remove(0)
            new = np.isfinite(world.pedestrians.served_time) & ~np.isfinite(before)
            for p in np.flatnonzero(new).tolist():
                lasts = float(world.pedestrians.served_time[p]) - time
                begun.setdefault(p, []).append(round(lasts, 6))
        times.append(begun)
    shared = [p for p in times[0] if p in times[1]]
    assert len(shared) > 5
    for p in shared:
        assert all(a == b for a, b in zip(times[0][p], times[1][p], strict=False))


def test_robots_begin_and_end_and_obstacles_lie_away_from_lines_and_nobody_stands_on_a_goal():
    scenario = HALL.override({"obstacles.count": 3, "robots.count": 2, "pedestrians.standing": 0.2})
    lines = np.vstack([places([3, 3], [0, -1], 4, 0.8), places([-1, -2], [-1, 0], 3, 1.0)])
    for seed in range(40):
        layout = place(scenario, seed)
        np.testing.assert_array_equal(layout.pedestrian_position[:7], lines)
        ends = np.vstack([layout.robot_pose[:, :2], layout.robot_goal])
        assert np.linalg.norm(ends[:, None] - lines, axis=2).min() > 0.25 + 0.25 + 1.0
        gaps = np.linalg.norm(layout.obstacles[:, None, :2] - lines, axis=2)
        assert (gaps - layout.obstacles[:, 2:]).min() > 0.9
        standing = layout.pedestrian_position[layout.traits.standing]
        assert np.linalg.norm(layout.robot_goal[:, None] - standing, axis=2).min() > 0.25 + 0.25


def test_lanes_have_the_queues_of_the_single_environment_to_the_last_bit():
    """Beside lanes with none, and with others."""
    shorter = HALL.override({"pedestrians.queues": [{"head": [2, 2], "count": 2}]})
    plain = HALL.override({"pedestrians.queues": [], "pedestrians.count": 3})
    assert_lanes_alike([plain, HALL, shorter], 60)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"head": [4.9, 0]}, r"place 1 of queue 1, \(4\.90, 0\.00\), lies outside .* to 4\.75"),
        ({"head": [3, -3], "direction": 90}, r"place 4 of .* \(3\.00, -5\.40\), lies outside"),
        ({"head": [-1, -2], "count": 1}, r"place 1 of queue 2.* is taken by another queue"),
        ({"spacing": 0.3}, r"queues: spacing 0\.3 m of queue 1 is too little .* allowed: >= 0\.5"),
        ({"count": 11}, r"queues: take 16 people, .* allowed: 12 \(pedestrians\.count\)"),
        ({"count": 0}, r"queues\.0\.count: 0 is out of range"),
        ({"head": [1, 2, 3]}, r"queues\.0\.head: expected two numbers, x and y"),
        ({"facing": 3}, r"unknown key 'pedestrians\.queues\.0\.facing'"),
        ({"service": [4, 1]}, r"queues\.0\.service: the lower bound 4.* exceeds the upper 1"),
    ],
)  # fmt: skip
def test_a_queue_that_cannot_be_is_refused_with_the_place(changes, told):
    first, second = HALL.model_dump()["pedestrians"]["queues"]
    with pytest.raises(ScenarioError, match=told):
        HALL.override({"pedestrians.queues": [first | changes, second]})


def test_who_queues_or_stands_is_not_more_than_there_are():
    with pytest.raises(
        ScenarioError, match=r"pedestrians\.standing: 6 of .* and streams leave 3; .* <= 0\.25$"
    ):
        HALL.override({"pedestrians.standing": 0.5})


@pytest.mark.parametrize(
    ("shape", "told"),
    [
        ({"walls": [[-2.2, -3, -2.2, -1]]}, r"place 2 of queue 2.* is 0\.20 m from a wall"),
        ({"polygons": [[[2, 2], [4, 2], [4, 4], [2, 4]]]}, r"place 1 of queue 1.* is 0\.00 m"),
    ],
)
def test_a_queue_through_a_wall_is_refused(shape, told):
    arena = {"kind": "map", "regions": {"a": [-5, -5, -3, 5], "b": [3, -5, 5, 1]}, **shape}
    with pytest.raises(ScenarioError, match=told):
        HALL.override({"arena": arena, "robots": {"start": "a", "goal": "b"}})


def test_who_has_been_served_walks_on_and_on_also_where_others_stop_on_arrival():
    hall = HALL.override({"pedestrians.on_arrival": "stop"})
    world, people = World(hall, 0), range(hall.pedestrians.count)
    goals = [[] for _ in people]  # since each has last left a queue
    most = 0
    while world.time < 40.0:
        before = world.pedestrians.place
        world.step(np.zeros((1, 2)))
        now = world.pedestrians
        for p in people:
            if before[p] >= 0:
                goals[p] = []
            elif now.place[p] < 0 and tuple(now.goal[p]) not in goals[p]:
                goals[p].append(tuple(now.goal[p]))
        most = max(most, *(len(goals[p]) for p in people if now.queue[p] >= 0))
        assert max(len(goals[p]) for p in people if now.queue[p] < 0) == 1
    assert most > 1
