"""The hand-computed figures are those of docs/metrics.md."""

from __future__ import annotations

import math

import numpy as np
import pytest

from crowdbench.evaluation import social_metrics as social
from crowdbench.simulation.contact import Contact

APPROACHES = [0.60, 0.40, 0.15, 0.05, 0.05, 0.40, 0.10]
"""Clearances to a robot that stands at the origin [m]: near, away again, and near."""


@pytest.fixture
def approaches(make_episode):
    """Somebody who comes along x with the speeds given, one for each state."""

    def make(speeds, **fields):
        places = [[[clearance + 0.45, 0.0]] for clearance in APPROACHES]
        velocity = [[[-speed, 0.0]] for speed in speeds]
        return make_episode(np.zeros((7, 3)), None, places, velocity, **fields)

    return make


def test_every_fast_approach_is_one_near_miss(approaches):
    # Two in 1.2 s; the second state of the first one is no event of its own.
    episode = approaches([1.0, 1.0, 1.0, 1.0, 0.0, -1.0, 1.0])
    assert social.near_misses_per_min(episode) == pytest.approx(100.0)


@pytest.mark.parametrize(
    "speeds",
    [
        [0.5] * 7,  # not faster than 0.5 m/s
        [-1.0] * 7,  # going away
        [1.0, 1.0, 0.4, 0.4, 0.4, 1.0, 0.4],  # fast only while it is far
    ],
)
def test_slow_and_far_approaches_are_no_near_misses(approaches, speeds):
    assert social.near_misses_per_min(approaches(speeds)) == 0.0


def test_the_robot_s_own_speed_counts(make_episode):
    episode = make_episode(np.zeros((2, 3)), [[0.6, 0.0]], [[0.6, 0.0]])
    assert social.near_misses_per_min(episode) == pytest.approx(300.0)
    across = make_episode(np.zeros((2, 3)), [[0.6, 0.0]], [[0.0, 0.5]])
    assert social.near_misses_per_min(across) == 0.0


def test_an_approach_that_ends_in_contact_is_a_collision_and_no_near_miss(approaches):
    speeds = [1.0] * 7
    contact = Contact("pedestrian", 0, 0.0, 1.0)
    episode = approaches(speeds, outcome="collision", contact=contact)
    assert social.near_misses_per_min(episode) == pytest.approx(50.0)
    wall = approaches(speeds, outcome="collision", contact=Contact("wall", 0, 0.5, 0.0))
    assert social.near_misses_per_min(wall) == pytest.approx(100.0)


def crossing(make_episode, x):
    """A robot that crosses the path of somebody who walks along x at 1 m/s, at x, in 2 s."""
    steps = np.arange(11)
    poses = np.stack([np.full(11, x), -1.05 + 0.2 * steps, np.full(11, np.pi / 2)], axis=1)
    walk = np.stack([0.2 * steps, np.zeros(11)], axis=1)[:, None]
    velocity = np.tile([1.0, 0.0], (11, 1, 1))
    return make_episode(poses, np.tile([1.0, 0.0], (10, 1)), walk, velocity)


def test_cut_offs_are_counted_by_the_minute_and_by_their_gap(make_episode):
    # At the crossing, after 1.05 s: 2.5 - 1.05 - 0.5 = 0.95 s and 3.0 - 1.05 - 0.5 = 1.45 s.
    severe, mild = crossing(make_episode, 2.5), crossing(make_episode, 3.0)
    assert social.cutoffs_per_min(severe) == social.cutoffs_per_min(mild) == pytest.approx(30.0)
    assert social.severe_cutoffs_per_min(severe) == pytest.approx(30.0)
    assert social.severe_cutoffs_per_min(mild) == 0.0


def test_rates_of_an_episode_without_steps_are_undefined(make_episode):
    episode = make_episode([[0, 0, 0]], pedestrians=[[1, 0]], outcome="agent_error")
    for rate in (social.cutoffs_per_min, social.near_misses_per_min, social.social_work):
        assert math.isnan(rate(episode))


def test_social_work_is_the_mean_over_steps(make_episode):
    # Somebody who stands 2 m ahead of a robot at 1 m/s: |D| = 3, 2.1 exp(-2 / 1.05) on either.
    force = 2.1 * math.exp(-2 / 1.05)
    poses = [[0, 0, 0], [0.2, 0, 0], [0.4, 0, 0]]
    moving = make_episode(poses, [[1.0, 0], [1.0, 0]], [[[9, 9]], [[2.2, 0]], [[2.4, 0]]])
    assert social.social_work(moving) == pytest.approx(2 * force)
    assert social.social_work(make_episode(poses)) == 0.0
