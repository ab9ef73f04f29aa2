"""The hand-computed figures are those of docs/metrics.md."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench import load_scenario
from crowdbench.evaluation import navigation_metrics as navigation
from crowdbench.evaluation.metrics import METRICS, metrics
from crowdbench.evaluation.rollout import run_episode
from crowdbench.evaluation.statistics import estimate
from crowdbench.simulation.contact import Contact


def line(*places):
    """Poses along some places, heading along x."""
    return [[x, y, 0.0] for x, y in places]


def standing(steps):
    return np.zeros((steps + 1, 3))


# Progress


def test_progress_is_the_share_of_the_shortest_path_behind_the_robot(make_episode):
    # 4 m to the goal's centre less 0.3 m of tolerance; 1.7 m are left.
    episode = make_episode(line((0, 0), (1, 1), (2, 0)), outcome="collision")
    assert navigation.progress(episode) == pytest.approx(1 - 1.7 / 3.7)


def test_progress_follows_the_path_around_an_obstacle(make_episode):
    # Half of the way around: a tangent of sqrt(3) and half of the arc are left.
    episode = make_episode(line((0, 0), (2, 1)), obstacles=[[2.0, 0.0, 0.85]])
    whole = 2 * math.sqrt(3) + math.pi / 3 - 0.3
    left = math.sqrt(3) + math.pi / 6 - 0.3
    assert navigation.progress(episode) == pytest.approx(1 - left / whole)


def test_who_arrives_has_made_the_whole_way_and_who_goes_back_none(make_episode):
    there = make_episode(line((0, 0), (3.75, 0)), outcome="success")
    back = make_episode(line((0, 0), (-1, 0)), outcome="timeout")
    assert (navigation.progress(there), navigation.progress(back)) == (1.0, 0.0)


def test_progress_of_a_robot_against_a_wall_is_that_of_its_last_free_state(make_episode):
    # 0.1 m from the wall, the disc of the least clearance overlaps it: no path begins there.
    walls = [[1.0, 0.5, 3.0, 0.5]]
    episode = make_episode(line((0, 0), (2, 0), (2.2, 0.4)), walls=walls, outcome="collision")
    assert navigation.progress(episode) == pytest.approx(1 - 1.7 / 3.7)


def test_progress_is_undefined_where_no_path_leads_to_the_goal(make_episode):
    episode = make_episode(line((0, 0), (1, 0)), obstacles=[[4.0, 0.0, 0.2]])
    assert math.isnan(navigation.progress(episode))


# Time


@pytest.mark.parametrize(
    ("steps", "stl", "barn"),
    [
        (18, 1.0, 0.5),  # 3.6 s, as fast as can be
        (25, 3.7 / 5, 0.5),  # 5 s: 1.35 times as long
        (50, 0.37, 0.37),  # 10 s: 2.70 times
        (200, 3.7 / 40, 1 / 8),  # 40 s: 10.8 times
    ],
)
def test_arrivals_are_weighted_by_their_time(make_episode, steps, stl, barn):
    episode = make_episode(standing(steps), outcome="success")  # 3.7 m at 1 m/s: 3.7 s at least
    assert navigation.time_in_scene(episode) == pytest.approx(steps * 0.2)
    assert navigation.stl(episode) == pytest.approx(stl)
    assert navigation.barn_score(episode) == pytest.approx(barn)


def test_failures_have_no_score_for_their_time(make_episode):
    for outcome in ("collision", "timeout", "agent_error"):
        episode = make_episode(standing(30), outcome=outcome)
        assert navigation.stl(episode) == navigation.barn_score(episode) == 0.0


def test_a_slow_robot_is_measured_by_its_own_top_speed(make_episode):
    episode = make_episode(standing(50), outcome="success", top_speed=0.5)
    assert navigation.stl(episode) == pytest.approx(7.4 / 10)


def test_a_start_at_the_goal_takes_no_time_at_best(make_episode):
    episode = make_episode([[3.9, 0, 0], [3.9, 0, 0]], outcome="success")
    assert (navigation.stl(episode), navigation.barn_score(episode)) == (0.0, 1 / 8)


def test_times_of_an_arrival_without_a_path_are_undefined(make_episode):
    episode = make_episode(line((0, 0), (3.7, 0)), obstacles=[[4.0, 0.0, 0.2]], outcome="success")
    assert math.isnan(navigation.stl(episode)) and math.isnan(navigation.barn_score(episode))


@pytest.mark.parametrize(
    ("robots", "speed"),
    [
        ({"speed": (-1.5, 0.8)}, 1.5),
        ({"drive": "omnidirectional", "speed": (0, 0.4), "lateral_speed": (-0.3, 0.2)}, 0.5),
    ],
)
def test_an_episode_knows_how_fast_its_robot_can_be(robots, speed):
    world = load_scenario("corridor_sparse", robots=robots, time_limit=0.2)
    (episode,) = run_episode(world, "straight_line", seed=0)
    assert episode.top_speed == pytest.approx(speed)


# Turning


def test_heading_changes_add_up_left_and_right(make_episode):
    headings = [0.0, 0.5, -0.5, 3.0, -3.0]
    poses = [[0.0, 0.0, heading] for heading in headings]
    # The last turn is the short one, over pi.
    assert navigation.heading_changes(make_episode(poses)) == pytest.approx(
        0.5 + 1.0 + (2 * math.pi - 3.5) + (2 * math.pi - 6.0)
    )


def test_curvature_of_a_corner_is_its_angle_by_half_of_both_chords(make_episode):
    episode = make_episode(line((0, 0), (1, 0), (1, 1)))
    assert navigation.curvature(episode) == pytest.approx(math.pi / 2)
    longer = make_episode(line((0, 0), (3, 0), (3, 1)))
    assert navigation.curvature(longer) == pytest.approx(math.pi / 2 / 2)


@pytest.mark.parametrize("radius", [0.5, 2.0])
def test_curvature_of_a_circle_is_that_of_its_chords(make_episode, radius):
    angle = np.linspace(0, 2, 21)
    poses = np.stack([radius * np.sin(angle), radius * (1 - np.cos(angle)), angle], axis=1)
    chord = 2 * radius * math.sin(0.05)
    assert navigation.curvature(make_episode(poses)) == pytest.approx(0.1 / chord)


def test_waiting_and_turning_on_the_spot_do_not_bend_a_path(make_episode):
    poses = [[0, 0, 0], [1, 0, 0], [1, 0, 1.5], [1.0005, 0, 0], [2, 0, 0]]
    assert navigation.curvature(make_episode(poses)) == 0.0
    assert math.isnan(navigation.curvature(make_episode([[0, 0, 0], [1, 0, 0], [1, 0, 1]])))


def test_irregularity_leaves_out_the_turn_towards_the_goal(make_episode):
    # A quarter turn is needed; 0.3 rad to either side later are not. 4 m.
    poses = [[0, 0, math.pi / 2], [0, 0, 0], [2, 0, 0.3], [4, 0, 0]]
    assert navigation.path_irregularity(make_episode(poses)) == pytest.approx(0.6 / 4)


def test_irregularity_leaves_out_the_turns_around_an_obstacle(make_episode):
    # The shortest path leaves at 30 degrees and turns back by 60: pi / 2 in all.
    poses = [[0, 0, 0], [0, 0, math.pi / 6], [2, 1.2, math.pi / 6], [4, 0, -math.pi / 2]]
    episode = make_episode(poses, obstacles=[[2.0, 0.0, 0.85]])
    driven = 2 * math.hypot(2, 1.2)
    turned = math.pi / 6 + 2 * math.pi / 3
    assert navigation.path_irregularity(episode) == pytest.approx((turned - math.pi / 2) / driven)


def test_irregularity_is_never_negative_and_needs_a_path(make_episode):
    assert navigation.path_irregularity(make_episode([[0, 0, 2.0], [1, 0, 2.0]])) == 0.0
    assert math.isnan(navigation.path_irregularity(make_episode(standing(3))))
    blocked = make_episode(line((0, 0), (1, 0)), obstacles=[[4.0, 0.0, 0.2]])
    assert math.isnan(navigation.path_irregularity(blocked))


# Collisions


@pytest.mark.parametrize(
    ("speeds", "caused", "suffered"), [((0.8, 0.2), 500.0, 0.0), ((0.2, 0.8), 0.0, 500.0)]
)
def test_collisions_are_counted_by_who_drove_into_whom(make_episode, speeds, caused, suffered):
    contact = Contact("pedestrian", 0, *speeds)
    episode = make_episode(line((0, 0), (2, 0)), outcome="collision", contact=contact)
    assert navigation.collisions_caused_per_km(episode) == pytest.approx(caused)
    assert navigation.collisions_suffered_per_km(episode) == pytest.approx(suffered)


def test_collisions_of_many_episodes_are_all_over_all_kilometres(make_episode):
    contact = Contact("wall", 0, 0.5, 0.0)
    early = make_episode(line((0, 0), (0.05, 0)), outcome="collision", contact=contact)
    others = [make_episode(line((0, 0), (8, 0)), outcome="success") for _ in range(9)]
    entry = METRICS["collisions_caused_per_km"]
    measured = [metrics(episode) for episode in (early, *others)]
    values, weights = (
        [one[name] for one in measured] for name in ("collisions_caused_per_km", entry.weight)
    )
    assert estimate(entry, values, weights).mean == pytest.approx(1000 / 72.05)


def test_a_robot_that_never_moved_has_no_collisions_per_kilometre(make_episode):
    contact = Contact("pedestrian", 0, 0.0, 0.5)
    episode = make_episode(standing(3), outcome="collision", contact=contact)
    assert math.isnan(navigation.collisions_suffered_per_km(episode))


# Bounds


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    outcome=st.sampled_from(["success", "collision", "timeout"]),
)
def test_scores_stay_within_their_bounds(random_episode, seed, outcome):
    measured = metrics(dataclasses.replace(random_episode(seed), outcome=outcome))
    for name, highest in (("progress", 1.0), ("stl", 1.0), ("barn_score", 0.5)):
        assert math.isnan(measured[name]) or 0.0 <= measured[name] <= highest
    turned = measured["heading_changes"] / measured["path_length"]
    assert math.isnan(measured["path_irregularity"]) or (
        0.0 <= measured["path_irregularity"] <= turned + 1e-12
    )
    assert measured["severe_cutoffs_per_min"] <= measured["cutoffs_per_min"]
