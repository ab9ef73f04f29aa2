"""Who is where at a time, and how fast."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench.people.cleaning import Rows, clean


def walk(person, frames, speed=1.0, y=0.0):
    """Straight along x at 10 frames a second, beginning at x = 0."""
    return [(person, f, speed * (f - frames[0]) / 10, y) for f in frames]


def test_positions_at_frames_are_those_of_the_file(cleaned):
    rng = np.random.default_rng(3)
    rows = [(p, f, *rng.normal(size=2) * 0.1) for p in (4, 9) for f in range(5 * p, 5 * p + 12)]
    recording = cleaned(rows)
    for person, frame, *position in rows:
        present = recording.at((frame - 20) / 10)
        (there,) = np.flatnonzero(recording.people[present.tracks] == person)
        assert present.positions[there] == pytest.approx(position, abs=1e-9)


def test_between_frames_people_are_on_the_line(cleaned):
    recording = cleaned([(1, 0, 0.0, 0.0), (1, 1, 0.1, 0.2), (1, 2, 0.2, 0.0)])
    assert recording.at(0.025).positions == pytest.approx(np.array([[0.025, 0.05]]))
    assert recording.at(0.15).positions == pytest.approx(np.array([[0.15, 0.1]]))


def test_people_are_there_from_their_first_to_their_last_position(cleaned):
    recording = cleaned([*walk(7, range(10, 21)), *walk(3, range(15, 31))])
    there = {
        t: recording.people[recording.at(t).tracks].tolist()
        for t in (-0.01, 0.0, 0.49, 0.5, 1.0, 1.01, 2.0, 2.01)
    }
    assert there == {
        -0.01: [], 0.0: [7], 0.49: [7], 0.5: [3, 7], 1.0: [3, 7], 1.01: [3], 2.0: [3], 2.01: []
    }  # fmt: skip
    assert recording.duration == pytest.approx(2.0)


def test_several_times_are_asked_for_at_once(cleaned):
    recording = cleaned([*walk(7, range(10, 21)), *walk(3, range(15, 31), y=1.0)])
    which, there = recording.at_times(np.array([0.25, 3.0, 0.75]))
    assert which.tolist() == [0, 2, 2]
    assert recording.people[there.tracks].tolist() == [7, 3, 7]
    assert there.positions == pytest.approx(np.array([[0.25, 0.0], [0.25, 1.0], [0.75, 0.0]]))
    assert len(recording.at_times(np.array([3.0]))[0]) == 0


ROWS = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 60)), min_size=8, unique=True)


@settings(max_examples=30)
@given(ROWS, st.integers(0, 12_000))
def test_positions_are_those_of_numpys_interpolation(cells, milliseconds):
    rng = np.random.default_rng(len(cells))
    ids, frames = np.array(cells).T
    positions = 0.2 * rng.normal(size=(len(cells), 2)) + 5.0 * ids[:, None]
    recording = clean(Path("w"), Rows("test", ids, frames / 10, positions, frames))
    time = milliseconds / 2000 + 1e-4  # on no frame
    present = recording.at(time)
    for track in range(len(recording.people)):
        rows = slice(*recording.starts[track : track + 2])
        times = recording.times[rows]
        if times[0] <= time <= times[-1]:
            expected = [np.interp(time, times, recording.positions[rows, k]) for k in range(2)]
            found = present.positions[present.tracks == track]
            assert found == pytest.approx(np.array([expected]), abs=1e-9)
        else:
            assert track not in present.tracks


def test_a_steady_walker_has_one_speed_from_beginning_to_end(cleaned):
    recording = cleaned([*walk(1, range(30), speed=1.3), *walk(2, range(5), speed=0.4)])
    assert recording.speeds == pytest.approx(np.repeat([1.3, 0.4], [30, 5]))


def test_speeds_are_those_of_pedpy_away_from_the_ends(cleaned):
    pedpy = pytest.importorskip("pedpy")
    import pandas as pd

    rng = np.random.default_rng(5)
    way = rng.normal(scale=0.05, size=(2, 40, 2)).cumsum(axis=1)
    rows = [(p, f, *way[p, f]) for p in range(2) for f in range(40)]
    data = pedpy.TrajectoryData(
        pd.DataFrame(rows, columns=["id", "frame", "x", "y"]), frame_rate=10
    )
    border = pedpy.SpeedCalculation.BORDER_EXCLUDE
    theirs = pedpy.compute_individual_speed(
        traj_data=data, frame_step=4, speed_calculation=border
    ).sort_values(["id", "frame"])
    ours = cleaned(rows).speeds.reshape(2, 40)[:, 4:-4]
    assert ours.ravel() == pytest.approx(theirs["speed"].to_numpy())


def test_jumps_are_named_by_frame_and_person(cleaned):
    rows = [*walk(1, range(20)), *walk(2, range(3, 23), y=2.0)]
    rows = [(p, f, x, y + 0.6 * (p == 2 and f >= 10)) for p, f, x, y in rows]
    (jump,) = cleaned(rows).jumps()
    assert (jump.frame, jump.person) == (10, 2)
    assert jump.time == pytest.approx(1.0)
    assert jump.speed == pytest.approx(np.hypot(0.1, 0.6) / 0.1)


def test_jumps_are_told_in_their_order_in_time(cleaned):
    rows = [
        (p, f, 0.1 * f + (f >= jump), float(p)) for p, jump in ((1, 9), (2, 4)) for f in range(12)
    ]
    assert [(jump.frame, jump.person) for jump in cleaned(rows).jumps()] == [(4, 2), (9, 1)]


def test_the_next_persons_beginning_is_no_jump(cleaned):
    assert cleaned([*walk(1, range(5)), *walk(2, range(5, 10), y=40.0)]).jumps() == []


def test_the_area_is_that_of_the_cells_that_somebody_enters(cleaned):
    recording = cleaned([(1, 0, 0.1, 0.1), (1, 1, 0.4, 0.4), (1, 2, 0.6, 0.4), (1, 3, 0.6, 0.1)])
    assert recording.area == pytest.approx(2 * 0.25)
    low, high = recording.extent
    assert [*low, *high] == pytest.approx([0.1, 0.1, 0.6, 0.4])
