"""What is trained in: scenarios of some tiers with one robot, and others drawn around them."""

import numpy as np
import pytest
from crowdbench_agents.learning.config import load_config
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.lanes import Lanes
from crowdbench_agents.learning.worlds import as_they_are, digests, training_worlds

import crowdbench

GEOMETRY = crowdbench.MapGeometry(16, 6.0, 4.0)


def worlds(**changes):
    given = {f"training.{name}": value for name, value in changes.items()}
    return training_worlds(load_config().override(given).training)


def test_by_default_the_scenarios_of_the_paper_are_trained_in_as_they_are():
    made = worlds()
    assert list(made) == crowdbench.scenario_names("paper")
    assert digests(made) == {name: crowdbench.load_scenario(name).digest for name in made}


def test_all_tiers_are_driven_with_the_robot_of_the_last():
    made = worlds(tiers=["paper", "situation", "hard"])
    assert len(made) == 28
    for (scenario,) in made.values():
        assert (scenario.robots.acceleration, scenario.robots.latency) == ((1.0, 3.0), 1)
        assert (scenario.lidar.noise, scenario.lidar.dropout) == (0.02, 0.01)
    for tier in ("hard", "situation"):
        own = as_they_are(crowdbench.scenario_names(tier))
        assert digests(own).items() <= digests(made).items()


def test_variants_are_drawn_around_a_scenario_and_are_the_same_in_each_run():
    made = worlds(tiers=["hard"], variants=6)
    assert digests(made) == digests(worlds(tiers=["hard"], variants=6))
    for name, (own, *others) in made.items():
        assert own.digest == crowdbench.load_scenario(name).digest
        assert len({one.digest for one in (own, *others)}) == 6
        assert len({one.pedestrians.count for one in others}) > 1
        for one in others:
            people, usual = one.pedestrians, own.pedestrians
            assert 0.6 * usual.count - 0.5 <= people.count <= 1.2 * usual.count + 0.5
            assert abs(people.reactive - usual.reactive) <= 0.3
            pace = people.speed_mean / usual.speed_mean
            assert people.speed == pytest.approx(np.multiply(usual.speed, pace))
            assert 0 <= one.lidar.noise <= 0.04
            assert one.arena == own.arena
            assert one.robots == own.robots
    assert digests(made)["hard_station"] != digests(worlds(tiers=["hard"]))["hard_station"]


def test_a_scenario_that_is_full_has_no_variants(monkeypatch):
    def full(scenario, changes):
        raise crowdbench.ScenarioError("no room")

    monkeypatch.setattr(crowdbench.Scenario, "override", full)
    refused = r"training\.variants: 'unimodal_slow' has no room for any; allowed: 1"
    plain = crowdbench.Scenario(name="unimodal_slow")
    monkeypatch.setattr(crowdbench, "load_scenario", lambda name, **_: plain)
    monkeypatch.setattr(crowdbench, "scenario_names", lambda tier: ["unimodal_slow"])
    with pytest.raises(TrainingError, match=refused):
        worlds(variants=2)


def test_a_lane_takes_variants_in_turn_by_the_seed():
    made = {"unimodal_slow": worlds(tiers=["paper"], variants=3)["unimodal_slow"]}
    episodes = [("unimodal_slow", seed) for seed in range(1_000_000, 1_000_006)]
    lanes = Lanes(6, made, iter(episodes), GEOMETRY)
    lanes.begin(np.arange(6))
    counts = [len(lanes.observation(lane).state["pedestrian_position"]) for lane in range(6)]
    assert counts == [made["unimodal_slow"][seed % 3].pedestrians.count for _, seed in episodes]
    assert set(lanes.scenario) == {"unimodal_slow"}


def test_where_there_is_no_room_for_people_the_next_episode_begins(monkeypatch):
    reset, refused = crowdbench.CrowdVectorEnv.reset, []

    def without_room(env, *, seed, options):
        if 1_000_001 in seed:
            refused.append(seed)
            raise crowdbench.NoRoomError("no room", 1_000_001)
        return reset(env, seed=seed, options=options)

    monkeypatch.setattr(crowdbench.CrowdVectorEnv, "reset", without_room)
    made = as_they_are(["unimodal_slow", "corridor_sparse"])
    episodes = [("unimodal_slow", 1_000_000), ("unimodal_slow", 1_000_001)]
    lanes = Lanes(2, made, iter([*episodes, ("corridor_sparse", 1_000_002)]), GEOMETRY)
    lanes.begin(np.arange(2))
    assert lanes.scenario.tolist() == ["unimodal_slow", "corridor_sparse"]
    assert len(refused) == 1
    with pytest.raises(crowdbench.NoRoomError):
        Lanes(2, made, iter(episodes), GEOMETRY).begin(np.arange(2))
