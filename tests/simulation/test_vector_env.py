"""The vector environment: lanes against the single environment, Gymnasium's rules, bad input."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from hypothesis import given, settings
from hypothesis import strategies as st
from map_scenarios import ROOMS

import crowdbench
from crowdbench import CrowdNavEnv, Scenario, ScenarioError, load_scenario, vector_env

OPEN = Scenario(
    name="open", time_limit=3, pedestrians={"count": 5, "goals": "multimodal", "speed": [0.7, 1.1]}
)
CORRIDOR = Scenario(
    name="tight", arena={"kind": "corridor", "length": 12, "width": 4}, time_limit=4,
    obstacles={"count": 2}, lidar={"noise": 0.02, "dropout": 0.1},
    pedestrians={"count": 3, "reactive": 0.5, "model": "social_force"},
)  # fmt: skip
NOBODY = Scenario(name="nobody", time_limit=2, pedestrians={"count": 0})
STRAIGHT = OPEN.override({"pedestrians.model": "straight", "substeps": 2})
MAP = OPEN.override(ROOMS)
ALL = [OPEN, CORRIDOR, NOBODY, STRAIGHT, MAP]


def same(first, second):
    """Whether nested dictionaries of arrays and numbers are equal."""
    if isinstance(first, dict):
        assert first.keys() == second.keys()
        for key in first:
            same(first[key], second[key])
    else:
        np.testing.assert_array_equal(first, second)


def of_lane(batch, lane):
    return {key: value[lane] for key, value in batch.items()}


@settings(deadline=None, max_examples=8)
@given(
    seed=st.integers(0, 10**6),
    lanes=st.integers(1, 5),
    changes=st.sampled_from(
        [{}, {"robots.drive": "omnidirectional"}, {"robots.acceleration": [1.0, 2.0]}]
    ),
    obstacle_map=st.sampled_from([None, crowdbench.MapGeometry(16, 6.0, 4.0)]),
)
def test_every_lane_is_the_single_environment_to_the_last_bit(seed, lanes, changes, obstacle_map):
    """Observations, rewards, flags, infos and states, over ends and the episodes after them."""
    scenarios = [scenario.override(changes) for scenario in ALL]
    rng = np.random.default_rng(seed)
    chosen = rng.integers(len(ALL), size=lanes)
    env = vector_env(scenarios, lanes, autoreset_mode="Disabled", obstacle_map=obstacle_map)
    seen, infos = env.reset(seed=seed, options={"scenario": chosen})
    singles = [CrowdNavEnv(scenarios[k], obstacle_map=obstacle_map) for k in chosen]
    for lane, single in enumerate(singles):
        same(of_lane(seen, lane), single.reset(seed=seed + lane)[0])
    np.testing.assert_array_equal(infos["seed"], seed + np.arange(lanes))
    low, high = env.single_action_space.low, env.single_action_space.high
    for _ in range(24):
        actions = rng.uniform(low - 0.2, high + 0.2, (lanes, 2)).astype(np.float32)
        seen, rewards, ended, late, infos = env.step(actions)
        over = np.zeros(lanes, dtype=bool)
        for lane, single in enumerate(singles):
            expected, reward, single_ended, single_late, single_infos = single.step(actions[lane])
            same(of_lane(seen, lane), expected)
            assert rewards[lane] == reward
            assert (ended[lane], late[lane]) == (single_ended, single_late)
            assert infos["outcome"][lane] == single_infos["outcome"]
            assert infos["contact"][lane] == single_infos["contact"]
            for name, term in single_infos["reward_terms"].items():
                assert infos["reward_terms"][name][lane] == term
            same(env.state(lane), single.crowd.state())
            over[lane] = single_ended or single_late
        if over.any():
            seeds = [int(rng.integers(10**6)) if end else None for end in over]
            seen, _ = env.reset(seed=seeds, options={"reset_mask": over, "scenario": chosen})
            for lane in np.flatnonzero(over):
                same(of_lane(seen, lane), singles[lane].reset(seed=seeds[lane])[0])


@pytest.mark.parametrize("mode", list(AutoresetMode)[:2])
def test_lanes_begin_again_as_gymnasiums_own_vector_environment_does(mode):
    ours = gymnasium.make_vec(
        "crowdbench:CrowdNav-v0", num_envs=3, scenario=OPEN, autoreset_mode=mode
    )
    theirs = gymnasium.vector.SyncVectorEnv([lambda: CrowdNavEnv(OPEN)] * 3, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] is mode
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    same(ours.reset(seed=4)[0], theirs.reset(seed=4)[0])
    rng, ends = np.random.default_rng(1), 0
    for _ in range(40):
        actions = rng.uniform([0, -1.5], [1, 1.5], (3, 2)).astype(np.float32)
        seen, rewards, ended, late, infos = ours.step(actions)
        their_seen, their_rewards, their_ended, their_late, their_infos = theirs.step(actions)
        same(seen, their_seen)
        assert ours.observation_space.contains(seen)
        np.testing.assert_array_equal(rewards, their_rewards)
        np.testing.assert_array_equal(ended, their_ended)
        np.testing.assert_array_equal(late, their_late)
        same_infos(infos, their_infos)
        ends += (ended | late).sum()
    assert ends >= 6


def same_infos(ours, theirs):
    """What Gymnasium batches of single infos; ours name seeds and scenarios as well."""
    for key, value in theirs.items():
        mask = theirs.get(f"_{key}")
        if key == "final_obs":
            for mine, other in zip(ours[key], value, strict=True):
                assert (mine is None) == (other is None)
                if mine is not None:
                    same(mine, other)
        elif isinstance(value, dict):
            same_infos(ours[key], value)
        elif key.startswith("_"):
            np.testing.assert_array_equal(ours[key], value)
        else:
            np.testing.assert_array_equal(ours[key][mask], value[mask])


def test_what_was_returned_is_not_written_to_later():
    env = vector_env(OPEN, 2)
    first = env.reset(seed=0)[0]
    before = {key: value.copy() for key, value in first.items()}
    step = env.step(np.ones((2, 2)))
    rewards = step[1].copy()
    first["lidar"][:] = -1.0
    second = env.step(np.ones((2, 2)))[0]
    assert (second["lidar"] >= 0.0).all()
    np.testing.assert_array_equal(step[1], rewards)
    np.testing.assert_array_equal(first["goal"], before["goal"])


def test_the_obstacle_map_is_where_four_beams_meet_the_walls_of_a_corridor():
    empty = {"pedestrians.count": 0, "obstacles.count": 0, "lidar.beams": 4, "time_limit": 1}
    plain = empty | {"lidar.noise": 0.0, "lidar.dropout": 0.0}
    geometry = crowdbench.MapGeometry(cells=16, size=8.0, ahead=4.0)  # the robot is in its middle
    env = vector_env(CORRIDOR, 2, obstacle_map=geometry, **plain)
    seen, _ = env.reset(seed=3)
    expected = np.zeros((2, 16, 16), np.uint8)
    for lane in range(2):
        _, y, heading = env.state(lane)["robot_pose"][0]
        for beam in range(4):
            angle = beam * np.pi / 2
            across = np.sin(heading + angle)
            distance = (2.0 - np.sign(across) * y) / abs(across)  # walls at y = -2 m and 2 m
            if distance < 6.0:
                place = np.array([np.cos(angle), np.sin(angle)]) * distance
                i, j = np.floor((place + 4.0) / 0.5).astype(int)
                if min(i, j) >= 0 and max(i, j) < 16:
                    expected[lane, i, j] = 1
    assert expected.any(axis=(1, 2)).all()
    np.testing.assert_array_equal(seen["map"], expected)
    assert env.observation_space.contains(seen)
    for step in range(1, 6):
        seen = env.step(np.zeros((2, 2)))[0]
        np.testing.assert_array_equal(seen["map"], expected * (2 ** (step + 1) - 1))
    again = env.step(np.zeros((2, 2)))[0]["map"]
    assert set(np.unique(again)) == {0, 1}, "the next episode has seen one scan"


def test_scenarios_are_drawn_by_weights_that_can_change():
    env = vector_env([OPEN, NOBODY], 40, weights=[3, 1])
    np.testing.assert_allclose(env.weights, [0.75, 0.25])
    drawn = env.reset(seed=100)[1]["scenario"]
    assert 4 <= drawn.sum() <= 16
    np.testing.assert_array_equal(drawn, env.reset(seed=100)[1]["scenario"])
    env.weights = [0, 1]
    assert (env.reset(seed=200)[1]["scenario"] == 1).all()


def test_later_episodes_are_fixed_by_a_lanes_first_seed_alone():
    few, many = vector_env(OPEN, 1), vector_env(OPEN, 3)
    few.reset(seed=7), many.reset(seed=[5, 7, 9])
    seeds = []
    for _ in range(35):
        alone = few.step(np.tile([0.8, 0.1], (1, 1)))
        beside = many.step(np.tile([0.8, 0.1], (3, 1)))
        same(of_lane(alone[0], 0), of_lane(beside[0], 1))
        assert alone[4]["seed"][0] == beside[4]["seed"][1]
        seeds.append(int(alone[4]["seed"][0]))
    assert len(set(seeds)) >= 3


def test_lanes_that_are_over_stay_as_they_are_until_reset():
    env = vector_env([NOBODY], 2, autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=0)
    for _ in range(10):
        seen, _, _, late, _ = env.step(np.zeros((2, 2)))
    assert late.all()
    again, rewards, ended, late, infos = env.step(np.full((2, 2), np.nan))
    same(again, seen)
    assert (rewards == 0).all() and not ended.any() and late.all()
    assert not infos["_outcome"].any()
    env.reset(options={"reset_mask": np.array([True, False])})
    late = env.step(np.zeros((2, 2)))[3]
    assert late.tolist() == [False, True]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"num_envs": 0}, "num_envs: 0; allowed: a whole number of at least 1"),
        ({"num_envs": 2.5}, "num_envs: 2.5"),
        ({"scenario": []}, "scenario: an empty list"),
        ({"scenario": "nowhere"}, "nowhere"),
        ({"scenario": [OPEN, OPEN.override({"robots.speed": [0, 2]})]}, r"robots\.speed.*\(0.*2"),
        (
            {"scenario": [OPEN, OPEN.override({"lidar.beams": 9})]},
            r"scenario 1 \('open'\): lidar\.beams: 9, but 180 in scenario 0 \('open'\)",
        ),
        ({"scenario": OPEN.override({"robots.count": 2})}, r"robots\.count: 2"),
        ({"pedestrians": {"control": "agents"}}, r"pedestrians\.control: 'agents'"),
        ({"weights": [1, 2]}, r"weights: \[1, 2\]; allowed: 1 finite"),
        ({"weights": [0]}, "weights"),
        ({"weights": [-1]}, "weights"),
        ({"weights": [float("nan")]}, "weights"),
        ({"weights": "much"}, "weights"),
        ({"autoreset_mode": "never"}, "autoreset_mode: 'never'; allowed: 'NextStep', 'SameStep'"),
    ],
)
def test_what_cannot_be_is_refused_with_the_reason(arguments, told):
    with pytest.raises((ScenarioError, ValueError), match=told):
        vector_env(**{"scenario": OPEN, "num_envs": 2} | arguments)


def test_bad_actions_seeds_and_options_are_named_and_change_nothing():
    env = vector_env(OPEN, 3)
    with pytest.raises(RuntimeError, match="reset"):
        env.step(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="every lane has to begin first"):
        env.reset(options={"reset_mask": np.array([True, False, False])})
    env.reset(seed=0)
    before, first = env.state(1), env.state(0)
    bad = np.zeros((3, 2))
    bad[1, 0] = np.inf
    with pytest.raises(ValueError, match="action in lane 1: expected finite"):
        env.step(bad)
    with pytest.raises(ValueError, match=r"expected shape \(3, 2\), got \(2, 2\)"):
        env.step(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="not numeric"):
        env.step("left")
    with pytest.raises(ValueError, match="not numeric"):
        env.step(np.full((3, 2), "1"))
    with pytest.raises(ValueError, match="2 seeds for 3 lanes"):
        env.reset(seed=[1, 2])
    with pytest.raises(ValueError, match="seed of lane 1: -1; allowed: whole numbers from 0"):
        env.reset(seed=[5, -1, 6])
    with pytest.raises(ValueError, match="seed of lane 2: 9223372036854775808"):
        env.reset(seed=2**63 - 2)
    with pytest.raises(ValueError, match=r"seed of lane 1: 0\.5"):
        env.reset(seed=[5, 0.5, 6])
    with pytest.raises(ValueError, match=r"seed: 1\.5; allowed: a whole number, or one per lane"):
        env.reset(seed=1.5)
    with pytest.raises(ValueError, match=r"unknown.*room"):
        env.reset(options={"room": 1})
    with pytest.raises(ValueError, match="reset_mask"):
        env.reset(options={"reset_mask": [1, 0, 0]})
    with pytest.raises(ValueError, match="indices from 0 to 0"):
        env.reset(options={"scenario": [0, 1, 0]})
    same(env.state(1), before)
    same(env.state(0), first)
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.step(np.zeros((3, 2)))


def test_make_vec_takes_names_and_overrides():
    env = gymnasium.make_vec(
        "crowdbench:CrowdNav-v0", num_envs=2, scenario=["multimodal_fast", "corridor_dense"],
        **{"lidar.beams": 30},
    )  # fmt: skip
    assert isinstance(env, crowdbench.CrowdVectorEnv)
    assert env.single_observation_space["lidar"].shape == (30,)
    assert env.scenarios[1] == load_scenario("corridor_dense", **{"lidar.beams": 30})
