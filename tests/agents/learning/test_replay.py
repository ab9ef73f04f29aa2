"""The replay returns what was written, never across episodes or the ring's seam."""

import numpy as np
import pytest
from crowdbench_agents.learning.batch import join
from crowdbench_agents.learning.detour import Detour
from crowdbench_agents.learning.replay import (
    EXPERT,
    PLANNER,
    Replay,
    ReplayError,
    Rows,
)
from hypothesis import given, settings
from hypothesis import strategies as st


def rows(lanes, values, episode, final=False, collision=False):
    """One row per lane whose every number tells lane, time and episode."""
    n = len(lanes)
    value = np.full(n, float(values), np.float32)
    pair = np.stack([value, np.asarray(lanes, np.float32)], axis=-1)
    maps = np.zeros((n, 16, 16), np.uint8)
    maps[:, 3, 2] = int(values) % 256
    flag = np.full(n, True)
    return Rows(
        maps, pair, np.stack([np.full(n, episode, np.float32), value + 1], -1), pair / 1000,
        value, value / 2,
        flag & collision, flag & collision, flag & final, pair / 1000,
        np.full(n, int(values) % 3, np.uint8),
    )  # fmt: skip


def filled(lengths, ring, lanes=2):
    """Episodes of the given numbers of steps, the same in each lane; every other one collides."""
    replay, at = Replay(lanes, ring, cells=16), np.arange(lanes)
    time = 0
    for episode, steps in enumerate(lengths):
        for step in range(steps + 1):
            last = step == steps
            collision = step == steps - 1 and episode % 2 == 0
            replay.append(at, rows(at, time, episode, final=last, collision=collision))
            time += 1
    return replay


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.integers(1, 9), min_size=3, max_size=12),
    st.integers(8, 40),
    st.integers(0, 10_000),
    st.sampled_from([0.0, 0.5, 1.0]),
)
def test_sequences_are_consecutive_and_stay_in_their_episode(lengths, ring, seed, share):
    replay = filled(lengths, ring)
    horizon = 4
    total = sum(length + 1 for length in lengths)
    if min(ring, total) <= horizon:
        return
    batch = replay.sample(32, horizon, np.random.default_rng(seed), collision_share=share)
    time, episode = batch.inputs.velocity[..., 0], batch.inputs.goal[..., 0]
    lane = batch.inputs.velocity[..., 1]
    assert (lane == lane[0]).all()
    assert time.min() >= total - ring  # nothing that was overwritten
    for t in range(horizon):
        counts = batch.valid[t] == 1
        assert (time[t + 1] - time[t] == 1)[counts].all()
        assert (episode[t + 1] == episode[t])[counts].all()
        assert (batch.reward[t] == 1.5 * time[t])[counts].all()
        for flag, source in ((batch.planned, PLANNER), (batch.labelled, EXPERT)):
            np.testing.assert_array_equal(flag[t] == 1, counts & (time[t] % 3 == source))
    assert (batch.valid.diff(dim=0) <= 0).all()


def test_collision_share_draws_sequences_that_end_in_one():
    replay = filled([30, 30, 30, 30], ring=500)
    rng = np.random.default_rng(0)
    batch = replay.sample(400, 5, rng, collision_share=0.5)
    collided = (batch.collision * batch.valid).sum(0) > 0
    assert collided[:200].all()
    assert collided[200:].float().mean() < 0.3
    # The collision falls on every position of the sequence alike.
    positions = (batch.collision * batch.valid)[:, :200].argmax(0)
    assert set(positions.tolist()) == {0, 1, 2, 3, 4}


def test_reflection_mirrors_maps_goals_and_turns_together():
    replay = filled([10], ring=50)
    plain = replay.sample(64, 3, np.random.default_rng(5))
    both = replay.sample(64, 3, np.random.default_rng(5), reflect=True)
    np.testing.assert_array_equal(plain.inputs.velocity[..., 0], both.inputs.velocity[..., 0])
    mirrored = both.inputs.goal[0, :, 1] < 0
    assert 10 < mirrored.sum() < 54
    np.testing.assert_array_equal(
        both.inputs.map[:, mirrored], plain.inputs.map[:, mirrored].flip(-1)
    )
    for name in ("action", "reference"):
        a, b = getattr(plain, name), getattr(both, name)
        np.testing.assert_array_equal(a[:, mirrored, 1], -b[:, mirrored, 1])
        np.testing.assert_array_equal(a[:, ~mirrored], b[:, ~mirrored])


def test_cut_ends_the_episode_under_way():
    replay = Replay(1, 20, cells=16)
    at = np.array([0])
    for time in range(3):
        replay.append(at, rows(at, time, 0))
    replay.mark_episode_ends(at)
    for time in range(3, 8):
        replay.append(at, rows(at, time, 1))
    batch = replay.sample(50, 3, np.random.default_rng(0))
    time = batch.inputs.velocity[:-1, :, 0]
    assert (batch.valid[time == 2] == 0).all()
    assert (batch.valid[0][time[0] == 0] == 1).all()


def test_files_are_continued_and_a_wrong_size_is_refused(tmp_path):
    at = np.arange(2)
    first = Replay(2, 10, cells=16, folder=tmp_path)
    for time in range(6):
        first.append(at, rows(at, time, 0))
    second = Replay(2, 10, cells=16, folder=tmp_path)
    assert len(second) == 12
    a, b = (r.sample(9, 3, np.random.default_rng(1)) for r in (first, second))
    np.testing.assert_array_equal(a.inputs.map, b.inputs.map)
    with pytest.raises(ReplayError, match=r"has shape .* this run needs"):
        Replay(2, 12, cells=16, folder=tmp_path)


def test_too_few_rows_are_refused():
    with pytest.raises(ReplayError, match="7 rows"):
        filled([3], ring=50).sample(1, 6, np.random.default_rng(0))


def test_join_puts_batches_side_by_side():
    replay = filled([10], ring=50)
    a = replay.sample(3, 2, np.random.default_rng(0))
    b = replay.sample(2, 2, np.random.default_rng(1))
    both = join(a, b)
    assert both.inputs.map.shape == (3, 5, 16, 16)
    np.testing.assert_array_equal(both.reward[:, 3:], b.reward)


def test_the_social_term_is_left_out_where_it_is_switched_off():
    replay = Replay(1, 20, cells=16, social=False)
    for time in range(8):
        replay.append(np.array([0]), rows(np.array([0]), time, 0))
    batch = replay.sample(10, 3, np.random.default_rng(0))
    np.testing.assert_array_equal(batch.reward, batch.inputs.velocity[:-1, :, 0])


def test_what_is_driven_beyond_what_is_gained_has_its_price():
    """By hand: 0.5 m straight on, 0.3 m away from the goal, a turn on the spot, 0.4 m across."""
    velocity = np.float32([[0, 0], [1.0, 0], [0.6, 1], [0, -1], [0.8, 0]])
    goal = np.float32([[3, 4], [2.7, 3.6], [2.88, 3.84], [-4.8, 0], [-4.8, 0.4]])
    price = Detour(metre=2.0, period=0.5).price(velocity[:, None], goal[:, None])
    across = 0.4 + np.hypot(4.8, 0.4) - 4.8
    np.testing.assert_allclose(price[:, 0], [0, 2 * 0.6, 0, 2 * across], atol=1e-5)


def test_the_price_of_detours_is_taken_off_the_rewards():
    replay = Replay(1, 20, cells=16, social=False, detour=Detour(metre=2.0, period=0.5))
    for time in range(8):
        replay.append(np.array([0]), rows(np.array([0]), time, 0))
    batch = replay.sample(10, 3, np.random.default_rng(0), reflect=True)
    time = batch.inputs.velocity[:-1, :, 0]
    # the speed observed after the step is t + 1, and the goal at (0, t + 1) recedes by a metre
    np.testing.assert_allclose(batch.reward, time - 2.0 * (0.5 * (time + 1) + 1))


def test_what_is_drawn_to_be_planned_again_gets_the_new_plan_unless_it_is_overwritten():
    replay, lanes = Replay(3, 40, cells=16), np.arange(3)
    for time in range(30):
        replay.append(lanes, rows(lanes, time, 0, final=time % 10 == 9))
    some = np.array([0, 2])
    which, sensed = replay.draw_observations(some, 200, np.random.default_rng(0))
    times = set(sensed.velocity[:, 0].astype(int))
    assert times == {t for t in range(30) if t % 10 != 9 and t % 3 != EXPERT}
    assert set(sensed.velocity[:, 1].astype(int)) == {0, 2}
    np.testing.assert_array_equal(sensed.map[:, 3, 2], sensed.velocity[:, 0])
    for time in range(30, 50):  # the first ten rows are gone
        replay.append(lanes, rows(lanes, time, 0))
    before = replay._data.reference.copy()
    replay.replace_references(which, np.full((len(which), 2), 0.5, np.float32), PLANNER)
    changed = np.argwhere((replay._data.reference != before).all(axis=-1))
    expected = {(lane, number) for lane, number in which.tolist() if number >= 10}
    assert {tuple(place) for place in changed.tolist()} == expected
    assert (replay._data.source[tuple(changed.T)] == PLANNER).all()


def test_a_replay_in_files_gives_the_sequences_of_one_in_memory(tmp_path):
    """Written by one process and read by another, as far as the files go."""
    plain, written = Replay(2, 20, cells=16), Replay(2, 20, cells=16, folder=tmp_path)
    read, at = Replay(2, 20, cells=16, folder=tmp_path), np.arange(2)
    for time in range(33):
        for replay in (plain, written):
            replay.append(at, rows(at, time, time // 8, final=time % 8 == 7, collision=time == 30))
    a, b = (replay.sample(40, 4, np.random.default_rng(2), 0.25, True) for replay in (plain, read))
    for expected, found in zip([*a.inputs, *a[1:]], [*b.inputs, *b[1:]], strict=True):
        np.testing.assert_array_equal(found, expected)


def test_a_collision_in_a_lane_that_is_too_short_for_a_sequence_is_left_out():
    replay = filled([6, 6], ring=40)
    short = Replay(3, 40, cells=16)
    for time in range(14):
        row = [np.asarray(part[:2, time]) for part in replay._data]
        short.append(np.arange(2), Rows(*row))
    short.append(np.array([2]), rows(np.array([2]), 250, 9, collision=True))
    batch = short.sample(64, 3, np.random.default_rng(0), collision_share=1.0)
    lanes = batch.inputs.velocity[..., 1]
    assert set(lanes.unique().tolist()) == {0.0, 1.0}
    assert (batch.inputs.map.flatten(2).sum(-1) > 0).sum() >= batch.inputs.map.shape[1]
