"""The hand-computed figures are those of docs/metrics.md."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench.evaluation.metrics import METRICS, metrics
from crowdbench.simulation.contact import Contact

UNTOUCHED_BY_STEPS = {
    "success", "spl", "cutoff", "timeout", "path_length", "stalled_time",
    "collision_pedestrian", "collision_obstacle", "collision_wall", "collision_robot",
    "time_in_scene", "progress", "stl", "barn_score", "heading_changes",
}  # fmt: skip
NEED_PEOPLE = {"min_dist", "min_clearance"}
NEED_TWINS = {
    f"{name}{end}" for name in ("delay", "detour", "displacement") for end in ("", "_by_chance")
}
"""Of what the episode was simulated from, which these logs were not."""


def value(name, episode):
    return METRICS[name].function(episode)


def straight(steps, speed=1.0, heading=0.0):
    """Poses and actions of a robot that drives straight from the origin at 0.2 s per step."""
    along = np.arange(steps + 1) * speed * 0.2
    poses = np.stack(
        [along * np.cos(heading), along * np.sin(heading), np.full(steps + 1, heading)], axis=1
    )
    return poses, np.tile([speed, 0.0], (steps, 1))


@pytest.mark.parametrize("outcome", ["success", "collision", "timeout", "agent_error"])
def test_success_and_timeout_follow_the_outcome(make_episode, outcome):
    episode = make_episode([[0, 0, 0], [1, 0, 0]], outcome=outcome)
    assert value("success", episode) == (outcome == "success")
    assert value("timeout", episode) == (outcome == "timeout")


def test_spl_compares_with_the_path_around_an_obstacle(make_episode):
    episode = make_episode(
        [[0, 0, 0], [2, 1.5, 0], [4, 0, 0]], obstacles=[[2.0, 0.0, 0.85]], outcome="success"
    )
    shortest = 2 * math.sqrt(3) + math.pi / 3 - 0.3
    assert value("spl", episode) == pytest.approx(shortest / 5.0)
    assert value("spl", episode) == pytest.approx(0.84226, abs=1e-5)


def test_spl_of_a_straight_drive_to_the_edge_of_the_goal_is_one(make_episode):
    episode = make_episode([[0, 0, 0], [3.7, 0, 0]], outcome="success")
    assert value("spl", episode) == pytest.approx(1.0)


def test_spl_never_exceeds_one(make_episode):
    episode = make_episode([[0, 0, 0], [3.0, 0, 0]], outcome="success")
    assert value("spl", episode) == 1.0


def test_spl_of_a_start_within_the_tolerance_is_one(make_episode):
    episode = make_episode([[3.9, 0, 0]], outcome="success")
    assert value("spl", episode) == 1.0


def test_spl_of_a_failure_is_zero(make_episode):
    assert value("spl", make_episode([[0, 0, 0], [4, 0, 0]], outcome="timeout")) == 0.0


def test_spl_is_undefined_when_no_path_leads_to_the_goals_centre(make_episode):
    episode = make_episode([[0, 0, 0], [3.7, 0, 0]], obstacles=[[4.3, 0.0, 0.2]], outcome="success")
    assert math.isnan(value("spl", episode))


def test_smoothness_is_the_mean_squared_change_of_the_action(make_episode):
    episode = make_episode(np.zeros((4, 3)), [[0, 0], [1, 0], [1, 0.5]])
    assert value("smoothness", episode) == pytest.approx((1.0 + 0.25) / 2)


def test_smoothness_of_one_action_is_undefined(make_episode):
    assert math.isnan(value("smoothness", make_episode(np.zeros((2, 3)), [[1, 1]])))


def test_inference_is_the_mean_over_steps(make_episode):
    episode = make_episode(np.zeros((3, 3)), inference_s=[0.01, 0.03])
    assert value("inference_s", episode) == pytest.approx(0.02)


def test_distances_between_centres_and_surfaces(make_episode):
    ahead, beside, off_corner = [1.0, 0.0], [0.0, 1.0], [0.5, 0.55]
    assert value("min_dist", make_episode([[0, 0, 0]], pedestrians=[ahead, beside])) == 1.0
    for place, clearance in ((ahead, 0.55), (beside, 0.60), (off_corner, 0.25)):
        episode = make_episode([[0, 0, 0]], pedestrians=[place])
        assert value("min_clearance", episode) == pytest.approx(clearance)


def test_clearance_turns_with_the_robot(make_episode):
    episode = make_episode([[0, 0, np.pi / 2]], pedestrians=[[1.0, 0.0]])
    assert value("min_clearance", episode) == pytest.approx(0.60)


def test_clearance_of_an_overlap_is_zero(make_episode):
    episode = make_episode([[0, 0, 0]], pedestrians=[[0.1, 0.0]])
    assert value("min_clearance", episode) == 0.0


def test_minima_are_over_the_whole_episode(make_episode):
    poses, actions = straight(10)
    episode = make_episode(poses, actions, pedestrians=[[1.2, 1.0]])
    assert value("min_dist", episode) == pytest.approx(1.0)


def test_share_of_steps_with_a_time_to_collision_below_one_second(make_episode):
    # Discs of 0.25 m each, passing at 0.4 m: they touch 0.3 m before the robot is abreast, so
    # 1.1 s after the first step and 0.9 s after the second.
    poses, actions = straight(2)
    episode = make_episode(poses, actions, pedestrians=[[1.6, 0.4]])
    assert value("ttc_below_1s", episode) == 0.5


@pytest.mark.parametrize(
    ("velocity", "share"),
    [
        ([-1.0, 0.0], 1.0),  # oncoming: 1.0 m between surfaces, closing at 2 m/s
        ([0.0, 0.0], 0.0),  # standing: 1.0 m at 1 m/s is not below a second
        ([1.0, 0.0], 0.0),  # walking ahead at the robot's own speed
        ([0.0, 1.0], 0.0),  # gone before the robot arrives
    ],
)
def test_time_to_collision_depends_on_both_velocities(make_episode, velocity, share):
    poses, actions = straight(1)
    episode = make_episode(poses, actions, [[1.7 + 1e-6, 0.0]], [velocity])
    assert value("ttc_below_1s", episode) == share


def test_a_robot_that_stands_still_can_be_run_into(make_episode):
    episode = make_episode(np.zeros((2, 3)), None, [[1.2, 0.0]], [[-1.0, 0.0]])
    assert value("ttc_below_1s", episode) == 1.0


@pytest.mark.parametrize("kind", ["pedestrian", "obstacle", "wall", "robot"])
def test_a_collision_counts_for_its_kind_only(make_episode, kind):
    contact = Contact(kind, 0, 0.5, 0.0)
    episode = make_episode(
        np.zeros((2, 3)), pedestrians=[[0.4, 0.0]], outcome="collision", contact=contact
    )
    measured = metrics(episode)
    kinds = {name for name in measured if name.startswith("collision_") and measured[name]}
    assert kinds == {f"collision_{kind}"}
    assert measured["robot_at_fault"] == 1.0


@pytest.mark.parametrize(
    ("robot_speed", "other_speed", "at_fault"),
    [(0.8, 0.2, 1.0), (0.2, 0.8, 0.0), (0.0, 0.5, 0.0), (0.5, 0.5, 1.0), (-0.1, 0.0, 1.0)],
)
def test_whoever_closes_in_faster_is_at_fault(make_episode, robot_speed, other_speed, at_fault):
    contact = Contact("pedestrian", 0, robot_speed, other_speed)
    episode = make_episode(np.zeros((2, 3)), outcome="collision", contact=contact)
    assert value("robot_at_fault", episode) == at_fault


def test_nobody_is_at_fault_without_a_collision(make_episode):
    assert math.isnan(value("robot_at_fault", make_episode(np.zeros((2, 3)), outcome="success")))


def test_time_to_goal_is_undefined_unless_the_goal_was_reached(make_episode):
    episode = make_episode(*straight(10), outcome="success")
    assert value("time_to_goal", episode) == pytest.approx(2.0)
    assert math.isnan(value("time_to_goal", replace(episode, outcome="collision")))


def test_path_length_sums_the_steps(make_episode):
    episode = make_episode([[0, 0, 0], [3, 4, 0], [3, 5, 0]])
    assert value("path_length", episode) == pytest.approx(6.0)


def test_a_robot_that_turns_on_the_spot_is_stalled(make_episode):
    episode = make_episode(np.zeros((4, 3)), [[0.0, 1.0], [0.04, 0.0], [0.5, 0.0]])
    assert value("stalled_time", episode) == pytest.approx(0.4)


def test_a_robot_that_slips_sideways_is_not_stalled(make_episode):
    velocity = np.array([[0.0, 0.0], [0.0, 0.5], [0.0, 0.3], [0.0, 0.5]])
    episode = make_episode(
        np.zeros((4, 3)), velocity[1:], robot_world_velocity=velocity, robot_speed=velocity[:, 1]
    )
    assert value("stalled_time", episode) == 0.0
    assert value("jerk", episode) == pytest.approx(0.4 / 0.2**2)


def test_jerk_is_the_second_difference_of_the_velocity(make_episode):
    episode = make_episode(np.zeros((4, 3)), [[0, 0], [1, 0], [0, 0]])
    assert value("jerk", episode) == pytest.approx(2.0 / 0.2**2)


def test_jerk_of_a_turn_at_constant_speed_is_that_of_circular_motion(make_episode):
    # The velocity turns by w dt per step: |second difference| = 2 v (1 - cos(w dt)).
    heading = 0.5 * 0.2 * np.arange(21)
    poses = np.stack([np.zeros(21), np.zeros(21), heading], axis=1)
    episode = make_episode(poses, np.tile([0.8, 0.5], (20, 1)))
    assert value("jerk", episode) == pytest.approx(2 * 0.8 * (1 - math.cos(0.1)) / 0.04)


def test_jerk_of_two_actions_is_undefined(make_episode):
    assert math.isnan(value("jerk", make_episode(np.zeros((3, 3)), [[0, 0], [1, 0]])))


def test_zones_are_shares_of_steps_by_surface_distance(make_episode):
    # Surfaces 0.45 m less than centres: 2.0, 1.0, 0.4 and 0.0 m after the four steps.
    places = [[[9.0, 0]], [[2.45, 0]], [[1.45, 0]], [[0.85, 0]], [[0.3, 0]]]
    episode = make_episode(np.zeros((5, 3)), pedestrians=places)
    assert value("personal_space_share", episode) == 0.75
    assert value("intimate_space_share", episode) == 0.5


@pytest.mark.parametrize(
    ("people", "robot", "among"),
    [
        ([[0, 0.6], [0, -0.6]], [0.2, 0], 1),
        ([[0, 0.6], [0, -0.6]], [0.3, 0], 0),
        ([[0, 0], [1, 0], [0, 1]], [0.3, 0.3], 1),
        ([[0, 0], [1, 0], [0, 1]], [0.7, 0.7], 0),  # 0.28 m off
        ([[0, 3.1], [0, -3.1]], [0, 0], 0),  # not together
    ],
)
def test_who_is_between_the_people_of_a_group_is_in_its_space(make_episode, people, robot, among):
    poses = [[9, 9, 0], [*robot, 0]]
    episode = make_episode(poses, pedestrians=people, pedestrian_group=[0] * len(people))
    assert value("group_space_share", episode) == among
    alone = make_episode(poses, pedestrians=people)
    assert math.isnan(value("group_space_share", alone))


def test_an_episode_without_steps_has_its_metrics(make_episode):
    measured = metrics(make_episode([[0, 0, 0]], pedestrians=[[1, 0]], outcome="agent_error"))
    defined = {name for name, number in measured.items() if not math.isnan(number)}
    assert defined == UNTOUCHED_BY_STEPS | NEED_PEOPLE
    assert sum(measured[name] for name in UNTOUCHED_BY_STEPS) == 0.0


def test_an_episode_without_pedestrians_has_its_metrics(make_episode):
    measured = metrics(make_episode(*straight(19), outcome="success"))
    undefined = {name for name, number in measured.items() if math.isnan(number)}
    assert undefined == NEED_PEOPLE | NEED_TWINS | {"robot_at_fault", "group_space_share"}
    assert measured["ttc_below_1s"] == measured["cutoff"] == measured["personal_space_share"] == 0


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    angle=st.floats(-math.pi, math.pi),
    shift=st.tuples(st.floats(-50, 50), st.floats(-50, 50)),
    mirror=st.booleans(),
)
def test_metrics_do_not_depend_on_the_frame(random_episode, moved, seed, angle, shift, mirror):
    episode = random_episode(seed)
    before, after = metrics(episode), metrics(moved(episode, angle, shift, mirror))
    assert after == pytest.approx(before, rel=1e-6, abs=1e-6, nan_ok=True)


def test_the_random_episodes_exercise_every_metric(random_episode):
    drawn = [metrics(random_episode(seed)) for seed in range(20)]
    exercised = (
        "spl", "cutoff", "ttc_below_1s", "intimate_space_share", "stalled_time", "curvature",
        "cutoffs_per_min", "near_misses_per_min", "path_irregularity", "social_work",
    )  # fmt: skip
    for name in exercised:
        assert len({measured[name] for measured in drawn}) >= 3, name


def test_pedestrians_in_another_order_give_the_same_metrics(random_episode):
    episode = random_episode(5)
    reordered = replace(
        episode,
        pedestrian_position=episode.pedestrian_position[:, ::-1],
        pedestrian_velocity=episode.pedestrian_velocity[:, ::-1],
    )
    assert metrics(reordered) == pytest.approx(metrics(episode), nan_ok=True)


def test_the_documentation_says_what_the_entries_say():
    page = (Path(__file__).parents[2] / "docs" / "metrics.md").read_text(encoding="utf-8")
    section = page.split("## Every metric")[1].split("##")[0]
    rows = re.findall(r"^\| `(\w+)` \|(.*?)\|(.*?)\|(.*?)\|", section, flags=re.MULTILINE)
    printed = {
        name: ", ".join(
            filter(None, [m.unit, f"printed in {m.printed_unit}" * (m.printed_unit != m.unit)])
        )
        for name, m in METRICS.items()
    }
    assert [tuple(map(str.strip, row)) for row in rows] == [
        (name, printed[name], metric.better, metric.kind) for name, metric in METRICS.items()
    ]
    (main,) = re.findall(r"unless others are asked for: (.*)\.$", section, flags=re.MULTILINE)
    assert re.findall(r"`(\w+)`", main) == [n for n, metric in METRICS.items() if metric.main]
