"""People who follow ways: streams from region to region, and walks among walls."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from map_scenarios import hall
from shapely import LineString, MultiLineString, Polygon, box, unary_union

from crowdbench import parallel_env, vector_env
from crowdbench.extensions import WALKING_MODELS
from crowdbench.scenario import ScenarioError
from crowdbench.simulation.observations import state as observe_all
from crowdbench.simulation.walking import Orca
from crowdbench.simulation.world import World

STREAMS = [
    {"start": "west", "goal": "east", "share": 0.4},
    {"start": "east", "goal": "west", "share": 0.4},
]
REGIONS = {"west": [-9, -5, -7, 5], "east": [7, -5, 9, 5]}
STAND = np.zeros((1, 2))


def two_streams(**changes):
    """Two opposite streams of eight each through the gap, and four people who walk anywhere."""
    given = {"pedestrians__streams": STREAMS, "pedestrians__count": 20}
    return hall(**{**given, "pedestrians__goals": "unimodal", **changes})


def walked(scenario, seed=3, steps=150, command=STAND):
    """States of people (steps + 1, P, ...) by name, the robot gone unless it is driven."""
    world = World(scenario, seed)
    if command is STAND:
        world.remove(0)
    names = "position", "goal", "next_goal", "start", "speed", "intent"
    found = {name: [getattr(world.pedestrians, name).copy()] for name in names}
    for _ in range(steps):
        world.step(command)
        for name in names:
            found[name].append(getattr(world.pedestrians, name).copy())
    return {name: np.array(values) for name, values in found.items()}


def within(points, region):
    x, y = points[..., 0], points[..., 1]
    return (x >= region[0]) & (x <= region[2]) & (y >= region[1]) & (y <= region[3])


def entered(states, period=0.2):
    """(N, P) who is somewhere else than could be walked to."""
    step = np.linalg.norm(np.diff(states["position"], axis=0), axis=2)
    return step > 1.5 * period * states["speed"][1:] + 0.1


def test_a_stream_keeps_its_direction_and_enters_where_it_starts():
    states = walked(two_streams())
    jumps = entered(states)
    assert jumps.sum() > 10 and not jumps[:, 16:].any()
    for people, start, goal in ((slice(0, 8), "west", "east"), (slice(8, 16), "east", "west")):
        assert within(states["goal"][:, people], REGIONS[goal]).all()
        assert within(states["start"][:, people], REGIONS[start]).all()
        left, came = states["position"][:-1, people], states["position"][1:, people]
        assert within(
            left[jumps[:, people]], np.array(REGIONS[goal]) + [-0.3, -0.3, 0.3, 0.3]
        ).all()
        assert within(
            came[jumps[:, people]], np.array(REGIONS[start]) + [-0.3, -0.3, 0.3, 0.3]
        ).all()
        # Through the gap at x = 0 all go the same way.
        moves = np.where(jumps[:, people], 0.0, np.diff(states["position"][:, people, 0], axis=0))
        near = np.abs(left[..., 0]) < 3
        assert (np.sign(moves[near]) == (1 if goal == "east" else -1)).mean() > 0.9


def test_who_enters_touches_nobody():
    scenario = two_streams(pedestrians__count=40)
    states = walked(scenario, seed=5)
    jumps = entered(states)
    assert jumps.sum() > 10
    for step, p in np.argwhere(jumps).tolist():
        # Others have moved a period towards the place since.
        gaps = np.linalg.norm(
            states["position"][step + 1] - states["position"][step + 1, p], axis=1
        )
        assert np.delete(gaps, p).min() > 0.5 - 1e-3


def test_nobody_enters_beside_a_robot():
    """A robot in the only place where people may enter: they wait in their goal region."""
    scenario = two_streams(
        arena__regions={**REGIONS, "door": [-8.2, -0.2, -7.8, 0.2]},
        robots__start=[-8, 0],
        robots__speed=[0, 0],
        pedestrians__streams=[{"start": "door", "goal": "east"}],
        pedestrians__count=6,
        pedestrians__spawn_clearance=0.5,
    )
    world = World(scenario, 1)
    goals = []
    for _ in range(200):
        world.step(STAND)
        goals.append(world.pedestrians.position[:, 0].copy())
    assert (goals[-1] > 6.5).all()
    np.testing.assert_allclose(world.pedestrians.velocity, 0.0, atol=0.05)
    world.remove(0)
    for _ in range(30):
        world.step(STAND)
    assert (world.pedestrians.position[:, 0] < 0).any()


def test_people_in_streams_begin_all_along_their_way():
    """Shares of the way are uniform: of a straight one, the middle half has half of them."""
    scenario = hall(
        arena__walls=[], arena__polygons=[], pedestrians__count=12,
        arena__regions={"west": [-9, -1, -8.8, 1], "east": [8.8, -1, 9, 1]},
        pedestrians__streams=[{"start": "west", "goal": "east"}],
        robots__start=[-8, 5], robots__goal=[8, 5],
    )  # fmt: skip
    x = np.concatenate([World(scenario, seed).pedestrians.position[:, 0] for seed in range(40)])
    assert np.mean(np.abs(x) < 4.45) == pytest.approx(0.5, abs=0.07)
    assert (np.diff(np.histogram(x, 4, (-8.9, 8.9))[0]) < 50).all()


def test_regions_on_the_way_are_passed_whatever_is_shorter():
    """Two doors side by side in a wall across; everybody takes the upper one."""
    doors = [[0, -6, 0, -4], [0, -2, 0, 2], [0, 4, 0, 6]]
    scenario = two_streams(
        arena__walls=doors, arena__polygons=[],
        arena__regions={**REGIONS, "upper": [-0.5, 2, 0.5, 4]},
        pedestrians__streams=[{"start": "west", "goal": "east", "via": ["upper"]}],
        pedestrians__count=16,
    )  # fmt: skip
    states = walked(scenario)
    before, after = states["position"][:-1], states["position"][1:]
    crossing = ((before[..., 0] < 0) & (after[..., 0] >= 0)) & ~entered(states)
    assert crossing.sum() > 15
    share = -before[..., 0] / np.where(crossing, after[..., 0] - before[..., 0], 1)
    height = (before[..., 1] + share * (after[..., 1] - before[..., 1]))[crossing]
    assert ((height > 2) & (height < 4)).all()
    free = scenario.override({"pedestrians.streams": [{"start": "west", "goal": "east"}]})
    assert (walked(free, steps=60)["position"][:, :, 1] < -1).any(axis=0).sum() > 4


def test_the_state_has_what_people_in_streams_draw_their_places_from():
    """Of the region what is 0.25 m or more from the wall and the pillar, in squares of 5 cm."""
    pillar = [[-8.3, -0.3], [-7.7, -0.3], [-7.7, 0.3], [-8.3, 0.3]]
    scenario = two_streams(arena__polygons=[pillar], arena__walls=[[-10, -2, -8, -2]])
    state = observe_all(World(scenario, 3))
    places = state["stream_places"]
    np.testing.assert_allclose(places[..., 2].sum(axis=2), 1.0)
    np.testing.assert_array_equal(places[0, ::-1], places[1])
    start = places[0, 0][places[0, 0, :, 2] > 0]
    assert within(start, REGIONS["west"]).all()
    assert shapely.distance(Polygon(pillar), shapely.points(start[:, :2])).min() > 0.25
    room = box(-9, -5, -7, 5)
    room -= unary_union([Polygon(pillar), LineString([[-10, -2], [-8, -2]])]).buffer(0.25)
    room = room.buffer(-0.05)
    middle = start[:, 2] @ start[:, :2]
    np.testing.assert_allclose(middle, [room.centroid.x, room.centroid.y], atol=0.02)
    drawn = [World(scenario, seed).pedestrians.goal[8:16] for seed in range(40)]
    np.testing.assert_allclose(np.concatenate(drawn).mean(axis=0), middle, atol=0.4)


def test_the_state_says_which_regions_lie_behind_and_who_waits_to_enter():
    scenario = two_streams(
        arena__regions={**REGIONS, "gap": [-0.5, -1, 0.5, 1]},
        pedestrians__streams=[{"start": "west", "goal": "east", "via": ["gap"]}],
        pedestrians__count=12,
    )
    world = World(scenario, 3)
    waited = 0
    for _ in range(150):
        before, x = world.stage, world.pedestrians.position[:, 0].copy()
        world.step(STAND)
        waits = world.stage < 0
        stands = np.linalg.norm(world.pedestrians.velocity[waits], axis=1)
        assert (stands[before[waits] < 0] < 0.3).all()
        waited += waits.sum()
        assert (world.pedestrians.position[waits, 0] > 6).all()
        # Whoever passes through the gap has it behind from there on.
        passes = (before == 0) & (world.stage == 1)
        assert (np.abs(x[passes]) < 1.0).all()
        assert (world.stage[(x > 1) & ~waits & (world.pedestrians.position[:, 0] > 1)] == 1).all()
    assert waited > 0
    assert (World(two_streams(), 3).stage == [0] * 16 + [-1] * 4).all()


def random_map(seed):
    """A border and eight walls anywhere, with two streams and people who walk anywhere."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform([-6, -5], [6, 5], (8, 2))
    angle, half = rng.uniform(0, math.pi, 8), rng.uniform(0.5, 2.5, 8)
    along = half[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    inner = np.column_stack([middle - along, middle + along]).clip([-6, -5.9] * 2, [6, 5.9] * 2)
    border = [[-10, -6, 10, -6], [10, -6, 10, 6], [10, 6, -10, 6], [-10, 6, -10, -6]]
    return two_streams(
        arena__walls=[*border, *inner.round(3).tolist()], arena__polygons=[],
        pedestrians__speed=[0.8, 1.8], pedestrians__goals="multimodal",
        pedestrians__model=["orca", "social_force", "straight"][seed % 3],
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(20))
def test_nobody_passes_through_a_wall(seed):
    scenario = random_map(seed)
    states = walked(scenario, seed, steps=120)
    walls = MultiLineString([[wall[:2], wall[2:]] for wall in scenario.arena.walls])
    stays = ~entered(states)
    for p in range(states["position"].shape[1]):
        pieces = np.split(states["position"][:, p], np.flatnonzero(~stays[:, p]) + 1)
        assert not any(LineString(piece).crosses(walls) for piece in pieces if len(piece) > 1)
    # And they get on: most have walked more than a third of what they could have.
    far = np.where(stays, np.linalg.norm(np.diff(states["position"], axis=0), axis=2), 0).sum(
        axis=0
    )
    assert np.median(far / (24 * states["speed"][0])) > 0.33


@pytest.mark.parametrize("goals", ["unimodal", "multimodal"])
def test_what_is_drawn_does_not_depend_on_the_robot(goals):
    scenario = two_streams(pedestrians__goals=goals, pedestrians__speed=[1.5, 2.0])
    one = walked(scenario, command=np.array([[0.8, 0.2]]))
    other = walked(scenario, command=np.array([[0.3, -0.2]]))
    assert (one["position"][-1] != other["position"][-1]).all()
    legs = 0
    for p in range(20):
        first, second = (
            list(dict.fromkeys(map(tuple, states["next_goal"][:, p].tolist())))
            for states in (one, other)
        )
        shared = min(len(first), len(second))
        legs += shared
        assert first[:shared] == second[:shared]
    assert legs > 40


def test_multimodal_people_return_to_the_start_or_divert_to_another_streams_goal():
    scenario = two_streams(
        pedestrians__goals="multimodal", pedestrians__switch_probability=1.0,
        pedestrians__speed=[1.5, 2.0],
    )  # fmt: skip
    states = walked(scenario)
    for intent, region in ((1, "west"), (2, "west")):  # the other stream goes west as well
        chosen = states["intent"][:, :8] == intent
        assert chosen.any() and within(states["next_goal"][:, :8][chosen], REGIONS[region]).all()
    returned = (states["intent"][:, :8] == 1) & (states["next_goal"] == states["start"])[:, :8].all(
        2
    )
    assert (returned == (states["intent"][:, :8] == 1)).all()
    # Nobody who returned is moved: who is in the start region sets out from there.
    assert not within(states["position"][:-1, :8], REGIONS["west"])[entered(states)[:, :8]].any()


def test_without_a_stream_a_leg_that_is_interrupted_ends_there_and_another_begins():
    states = walked(hall(pedestrians__count=8, pedestrians__switch_probability=1.0), steps=60)
    new_goal = (np.diff(states["goal"], axis=0) != 0).any(axis=2)
    switches = new_goal & (states["intent"][:-1] != 0) & (states["intent"][1:] == 0)
    assert switches.sum() > 3
    np.testing.assert_array_equal(states["start"][1:][switches], states["position"][:-1][switches])


def test_lanes_are_the_single_environment_to_the_last_bit():
    scenarios = [two_streams(pedestrians__goals="multimodal"), hall(), random_map(1)]
    plain = hall(arena__kind="open", arena__walls=[], arena__polygons=[])
    scenarios.append(plain)
    lanes = vector_env(scenarios, 4, autoreset_mode="Disabled")
    lanes.reset(seed=[7, 8, 9, 10], options={"scenario": np.arange(4)})
    singles = [parallel_env(scenario) for scenario in scenarios]
    for k, single in enumerate(singles):
        single.reset(seed=7 + k)
    for _ in range(40):
        action = np.array([0.1, 0.3])
        lanes.step(np.tile(action, (4, 1)))
        for k, single in enumerate(singles):
            if single.agents:
                single.step({"robot_0": action})
                for key, value in single.state().items():
                    np.testing.assert_array_equal(value, lanes.state(k)[key], err_msg=key)
    assert any(single.agents for single in singles)


def test_a_model_from_elsewhere_walks_like_a_built_in_one(monkeypatch):
    monkeypatch.setitem(WALKING_MODELS._known, "mine", type("Mine", (Orca,), {}))
    one, other = (
        walked(two_streams(pedestrians__model=model), steps=60) for model in ("orca", "mine")
    )
    np.testing.assert_array_equal(one["position"], other["position"])


def test_a_way_in_the_state_leads_from_the_person_to_its_goal():
    world = World(two_streams(), 3)
    walls = MultiLineString([[wall[:2], wall[2:]] for wall in world.layout.walls.tolist()])
    for _ in range(20):
        world.step(STAND)
        for place, way, goal in zip(
            world.pedestrians.position, world.ways, world.pedestrians.goal, strict=True
        ):
            waits = (way == way[0]).all() and np.linalg.norm(way[0] - place) < 0.3
            assert waits or (way[-1] == goal).all()
            assert not LineString([place, *way]).crosses(walls)
    assert world.stream.tolist() == [0] * 8 + [1] * 8 + [-1] * 4


def test_who_queues_or_stands_does_so_among_people_who_follow_ways():
    queue = {"head": [-3, 4.5], "direction": 0, "count": 3, "spacing": 0.8, "service": [2, 3]}
    scenario = two_streams(
        pedestrians__queues=[queue], pedestrians__standing=0.05, pedestrians__count=24
    )
    world = World(scenario, 3)
    world.remove(0)
    assert world.stream.tolist() == [-1] * 4 + [0] * 10 + [1] * 9 + [-1]
    start, served = world.pedestrians.position.copy(), set()
    stands = np.flatnonzero((world.pedestrians.goal == start).all(axis=1) & (np.arange(24) > 3))
    for _ in range(100):
        world.step(STAND)
        state = observe_all(world)
        in_line = state["pedestrian_place"] >= 0
        assert in_line.sum() == 3 and not in_line[4:].any()
        served |= set(np.flatnonzero(~in_line[:4]).tolist())
    assert served == {0, 1, 2, 3} and stands.tolist() == [23]
    assert np.linalg.norm(world.pedestrians.position - start, axis=1)[stands].max() < 0.5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"arena__walls": [[1, -6, 1, 6]], "robots__goal": [-5, 0]},
            "pedestrians.streams.0.goal: no way leads to 'east' from 'west'; allowed: passages "
            "0.65 m wide",
        ),
        (
            {"arena__walls": [[1, -6, 1, -0.25], [1, 0.25, 1, 6]], "robots__goal": [-5, 0]},
            "pedestrians.streams.0.goal: no way leads to 'east' from 'west'; allowed: passages "
            "0.65 m wide",
        ),
        (
            {"arena__regions": {**REGIONS, "slit": [-8, 0, -7.96, 4]},
             "pedestrians__streams": [{"start": "west", "goal": "slit"}]},
            "pedestrians.streams.0.goal: the region 'slit' has no room for a person; allowed: with "
            "a place in it, 0.15 m wide, at least 0.25 m from",
        ),
        (
            {"arena__regions": {**REGIONS, "behind": [9.8, -5, 9.9, 5]},
             "pedestrians__streams": [{"start": "west", "goal": "east", "via": ["behind"]}]},
            "pedestrians.streams.0.via: the region 'behind' has no room for a person; allowed: wi",
        ),
    ],
)  # fmt: skip
def test_a_stream_without_a_way_is_refused(changes, message):
    with pytest.raises(ScenarioError) as caught:
        parallel_env(two_streams(**changes))
    assert message in str(caught.value)


def with_a_room(door):
    """A queue beside a wall of a room of 2 x 2 m, with a door of some width [m]."""
    room = [[2, -5, 4, -5], [4, -5, 4, -3], [2, -3, 2, -5], [2, -3, 4 - door, -3]]
    queue = {"head": [2.25, -4.75], "direction": -90, "count": 2, "service": [1, 1]}
    return hall(
        arena__walls=room,
        arena__polygons=[],
        pedestrians__count=3,
        pedestrians__speed=[1.2, 1.2],
        pedestrians__queues=[queue],
    )


@pytest.mark.parametrize("door", [0.0, 0.4])
def test_a_queue_that_nobody_can_walk_to_is_refused(door):
    told = (
        r"pedestrians\.queues: no way leads to place 1 of queue 1, \(2\.25, -4\.75\), from where "
        r"people walk; allowed: passages 0\.65 m wide or more"
    )
    with pytest.raises(ScenarioError, match=told):
        parallel_env(with_a_room(door))


def test_a_queue_beside_a_wall_behind_a_door_is_left_and_joined():
    world = World(with_a_room(door=0.6), 900_000)
    world.remove(0)
    left, joined = set(), set()
    for _ in range(200):
        before = world.pedestrians.place >= 0
        world.step(STAND)
        now = world.pedestrians.place >= 0
        outside = world.pedestrians.position[:, 1] > -3
        left |= set(np.flatnonzero(~now & outside).tolist())
        joined |= set(np.flatnonzero(now & ~before).tolist())
    assert left == joined == {0, 1, 2}
