"""Groups: who walks together, in which formation, and that nobody is left behind."""

import numpy as np
import pytest
from alike import assert_lanes_alike
from bodies import put
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench import Scenario, ScenarioError
from crowdbench.simulation.groups import ABREAST
from crowdbench.simulation.layout import place
from crowdbench.simulation.traits import draw_traits
from crowdbench.simulation.world import World

PLAZA = Scenario(
    name="plaza",
    arena={"length": 16, "width": 16},
    pedestrians={
        "count": 12, "speed": [0.8, 1.3], "leg": 9, "spawn_clearance": 3,
        "groups": {"share": 0.6, "size": [2, 4]},
    },
)  # fmt: skip
ONE = {"count": 4, "groups": {"share": 1.0, "size": [4, 4]}}
STILL = np.zeros((1, 2))


def in_formation(world, members):
    """Positions (M, 2) along and across the way to the common goal, around their mean."""
    position = world.pedestrians.position[members]
    ahead = world.pedestrians.goal[members[0]] - position.mean(axis=0)
    ahead = ahead / np.linalg.norm(ahead)
    off = position - position.mean(axis=0)
    return np.column_stack([off @ ahead, off @ [-ahead[1], ahead[0]]])


@given(
    count=st.integers(0, 30), share=st.floats(0, 1), low=st.integers(2, 6), more=st.integers(0, 4),
    seed=st.integers(0, 999),
)  # fmt: skip
@settings(deadline=None, max_examples=80)
def test_groups_have_the_sizes_allowed_and_as_many_of_the_share_as_they_can_hold(
    count, share, low, more, seed
):
    high = min(6, low + more)
    people = PLAZA.override(
        {"pedestrians": {"count": count, "groups": {"share": share, "size": [low, high]}}}
    ).pedestrians
    group = draw_traits(people, seed).group
    sizes = np.unique_counts(group[group >= 0]).counts.tolist()
    assert all(low <= size <= high for size in sizes)
    wanted = round(share * count)
    sums = {0}
    for _ in range(wanted):
        sums |= {total + size for total in sums for size in range(low, high + 1)}
    assert sum(sizes) == max(total for total in sums if total <= wanted)
    assert (np.diff(np.flatnonzero(group >= 0)) == 1).all()


def test_nobody_walks_in_groups_where_the_share_has_fewer_people_than_the_smallest():
    groups = {"share": 1.0, "size": [4, 4]}
    for count, grouped in ((2, 0), (3, 0), (4, 4), (7, 4)):
        people = PLAZA.override({"pedestrians": {"count": count, "groups": groups}}).pedestrians
        assert np.count_nonzero(draw_traits(people, 0).group >= 0) == grouped


def test_all_sizes_occur():
    groups = [draw_traits(PLAZA.pedestrians, seed).group for seed in range(60)]
    sizes = [np.unique_counts(group[group >= 0]).counts for group in groups]
    assert set(np.concatenate(sizes).tolist()) == {2, 3, 4}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"arena": {"kind": "corridor", "length": 14, "width": 4}, "obstacles.count": 2},
        {
            "arena": {
                "kind": "map", "walls": [[0, -8, 0, -0.6], [0, 0.6, 0, 8]],
                "regions": {"a": [-8, -8, -5, 8], "b": [5, -8, 8, 8]},
            },
            "robots": {"start": "a", "goal": "b"},
        },
    ],
)  # fmt: skip
def test_groups_begin_together_without_overlap_and_on_one_side_of_a_wall(changes):
    scenario = PLAZA.override({"pedestrians.spawn_clearance": 1.0} | changes)
    for seed in range(40):
        layout = place(scenario, seed)
        gaps = np.linalg.norm(
            layout.pedestrian_position[:, None] - layout.pedestrian_position, axis=2
        )
        assert gaps[np.triu_indices(12, 1)].min() > 0.5
        for g in range(layout.traits.group.max() + 1):
            members = np.flatnonzero(layout.traits.group == g)
            assert gaps[members[0], members].max() <= 0.6 + 0.35 * len(members)
            if scenario.arena.kind == "map":
                assert np.unique(np.sign(layout.pedestrian_position[members, 0])).size == 1
        half = np.array([scenario.arena.length, scenario.arena.width]) / 2 - 0.25
        assert (np.abs(layout.pedestrian_position) <= half).all()


@pytest.mark.parametrize("model", ["orca", "social_force", "straight"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_group_walks_abreast_in_the_open(model, seed):
    world = World(PLAZA.override({"pedestrians": ONE | {"model": model}}), seed)
    for _ in range(45):
        world.step(STILL)
    along, across = in_formation(world, np.arange(4)).T
    # Social forces keep people of a group off each other, too.
    looser, wider = (0.8, 0.35) if model == "social_force" else (0.3, 0.05)
    assert np.ptp(along) < looser
    assert (np.abs(np.diff(np.sort(across)) - ABREAST) < wider).all()
    speed = np.linalg.norm(world.pedestrians.velocity, axis=1)
    np.testing.assert_allclose(speed, world.pedestrians.speed.min(), atol=0.3 * looser)


@pytest.mark.parametrize(
    ("width", "abreast", "model"),
    [
        (1.2, 1, "orca"),
        (2.1, 2, "orca"),
        (2.7, 3, "orca"),
        (4, 4, "orca"),
        (1.2, 1, "social_force"),
    ],
)
def test_a_group_is_as_wide_as_the_corridor_leaves_room_for(width, abreast, model):
    arena = {"kind": "corridor", "length": 40, "width": width}
    people = ONE | {"model": model, "leg": 20, "spawn_clearance": 0, "responsibility": 0}
    scenario = PLAZA.override({"arena": arena, "pedestrians": people, "robots.travel": 39})
    world = World(scenario, 4)
    world.remove(0)
    for _ in range(60):
        world.step(STILL)
    along = in_formation(world, np.arange(4))[:, 0]
    rows = 1 + np.count_nonzero(np.diff(np.sort(along)) > 0.45)
    assert rows == -(-4 // abreast)
    assert np.linalg.norm(world.pedestrians.velocity, axis=1).min() > 0.4


def test_those_ahead_wait_until_everybody_is_there():
    world = World(PLAZA.override({"pedestrians": ONE}), 2)
    for _ in range(15):
        world.step(STILL)
    ahead = world.pedestrians.velocity[0] / np.linalg.norm(world.pedestrians.velocity[0])
    behind = world.pedestrians.position[3] - 3.5 * ahead
    put(world, 4, behind)  # robots come first
    speeds, spread = [], []
    for _ in range(40):
        world.step(STILL)
        speeds.append(np.linalg.norm(world.pedestrians.velocity, axis=1))
        spread.append(np.ptp(in_formation(world, np.arange(4))[:, 0]))
    assert spread[0] > 3
    assert np.max(speeds[2][:3]) < 0.2 and speeds[2][3] > 0.7
    assert spread[-1] < 0.4
    assert np.min(speeds[-1]) > 0.7


def test_a_group_has_one_goal_and_one_intent_and_goes_on_when_it_arrives():
    scenario = PLAZA.override({"pedestrians": {"goals": "multimodal", "switch_probability": 0.7}})
    world = World(scenario, 3)
    group, goals = world.pedestrians.group, set()
    for _ in range(250):
        world.step(STILL)
        for g in range(group.max() + 1):
            members = np.flatnonzero(group == g)
            for name in ("goal", "next_goal", "intent", "switch_time"):
                values = getattr(world.pedestrians, name)[members]
                assert (values == values[0]).all(), name
            goals.add((g, *world.pedestrians.goal[members[0]].tolist()))
    assert len(goals) > 3 * (group.max() + 1)


def test_a_group_stops_together():
    stops = {"stops": {"share": 1.0, "duration": [3, 4]}}
    world = World(PLAZA.override({"pedestrians": ONE | stops}), 6)
    stood = 0
    for _ in range(120):
        world.step(STILL)
        people = world.pedestrians
        if people.stop_time[0] + 1.5 <= world.time < people.stop_end[0]:
            assert np.linalg.norm(people.velocity, axis=1).max() < 0.1
            stood += 1
    assert stood > 5


def test_lanes_have_the_groups_of_the_single_environment_to_the_last_bit():
    alone = PLAZA.override({"pedestrians.groups.share": 0.0, "pedestrians.count": 3})
    corridor = PLAZA.override(
        {"arena": {"kind": "corridor", "width": 4}, "pedestrians": {"attention.away_share": 0.5}}
    )
    assert_lanes_alike([alone, PLAZA, corridor], 40)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"groups": {"share": 1.5}}, r"groups\.share: 1\.5 is out of range"),
        ({"groups": {"size": [4, 2]}}, r"groups\.size: the lower bound 4 exceeds the upper 2"),
        ({"groups": {"size": [1, 3]}}, r"groups\.size: 1 is out of range; allowed: >= 2 and <= 6"),
        ({"groups": {"size": 3}}, r"groups\.size: expected two numbers, lowest then highest"),
        ({"groups": {"share": 0.8}, "standing": 0.5}, r"groups\.share: 10 of .* <= 0\.5$"),
    ],
)  # fmt: skip
def test_groups_that_cannot_be_are_refused_with_the_field(changes, told):
    with pytest.raises(ScenarioError, match=rf"pedestrians\.{told}"):
        PLAZA.override({"pedestrians": changes})


def test_a_group_in_a_stream_enters_anew_together_and_passes_a_door():
    scenario = PLAZA.override(
        {
            "arena": {
                "kind": "map", "width": 8, "walls": [[0, -4, 0, -0.8], [0, 0.8, 0, 4]],
                "regions": {"west": [-8, -3, -6, 3], "east": [6, -3, 8, 3]},
            },
            "robots": {"start": [-4, 3], "goal": [4, 3]},
            "pedestrians": {
                "count": 8, "leg": 4, "spawn_clearance": 0.5, "groups.share": 0.75,
                "streams": [{"start": "west", "goal": "east", "share": 1.0}],
            },
        }
    )  # fmt: skip
    world = World(scenario, 1)
    world.remove(0)
    members = [np.flatnonzero(world.pedestrians.group == g) for g in range(2)]
    together, passed = [], np.zeros(8)
    for _ in range(350):
        before = world.pedestrians.position.copy()
        world.step(STILL)
        position = world.pedestrians.position
        passed += (before[:, 0] < 0) & (position[:, 0] >= 0)
        jumped = np.linalg.norm(position - before, axis=1) > 1.0
        assert (position[jumped, 0] < -4).all()  # west, where the stream begins
        together += [np.ptp(position[m], axis=0).max() < 3.5 for m in members]
    assert np.mean(together) > 0.85
    assert passed.min() >= 2
    for m in members:
        assert np.ptp(passed[m]) <= 1
