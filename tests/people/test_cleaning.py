"""Short gaps are filled, long ones end a track."""

from pathlib import Path

import numpy as np
import pytest

from crowdbench.people import RecordingError
from crowdbench.people.cleaning import Rows, clean


def line(person, frames):
    return [(person, f, 0.1 * f, 0.05 * f) for f in frames]


@pytest.mark.parametrize(
    ("fps", "absent", "tracks"),
    [(10, 5, 1), (10, 6, 2), (25, 12, 1), (25, 13, 2), (2.5, 1, 1), (2.5, 2, 2)],
)
def test_a_gap_of_half_a_second_is_filled_and_a_longer_one_ends_the_track(
    cleaned, fps, absent, tracks
):
    scale = fps / 10  # at 1 m/s or so
    rows = [(1, f, 0.1 * f / scale, 0.0) for f in [*range(10), *range(10 + absent, 30 + absent)]]
    recording = cleaned(rows, fps=fps)
    assert recording.people.tolist() == [1] * tracks
    assert int(recording.interpolated.sum()) == (absent if tracks == 1 else 0)
    assert len(recording.times) == 30 + recording.interpolated.sum()


def test_filled_positions_lie_evenly_on_the_line(cleaned):
    recording = cleaned(line(3, [0, 1, 2, 6, 7, 8]))
    assert recording.frames.tolist() == list(range(9))
    assert recording.interpolated.tolist() == [False] * 3 + [True] * 3 + [False] * 3
    assert recording.positions == pytest.approx(np.outer(np.arange(9), [0.1, 0.05]))
    assert recording.times == pytest.approx(np.arange(9) / 10)


def test_frames_in_steps_are_filled_in_steps(cleaned):
    recording = cleaned(line(1, [0, 6, 12, 24, 30]), fps=15)
    assert recording.frames.tolist() == [0, 6, 12, 18, 24, 30]
    assert recording.period == pytest.approx(0.4)


def test_the_order_of_rows_does_not_matter(cleaned):
    rows = [*line(2, range(8)), *line(1, range(3, 9)), *line(5, range(4))]
    first = cleaned(rows)
    second = cleaned([rows[n] for n in np.random.default_rng(1).permutation(len(rows))])
    for name in ("people", "starts", "times", "frames", "positions"):
        assert np.array_equal(getattr(first, name), getattr(second, name))


def test_who_is_seen_once_is_left_out(cleaned):
    recording = cleaned([(9, 0, 5.0, 5.0), *line(1, range(20, 30))])
    assert recording.people.tolist() == [1]
    assert recording.times[0] == 0.0
    assert recording.frames[0] == 20


def test_times_that_are_not_even_stay_as_they_are():
    times = np.array([3.0, 3.11, 3.19, 3.3, 3.41])
    rows = Rows("test", np.ones(5, int), times, np.outer(times, [1.0, 0.0]))
    recording = clean(Path("walk.csv"), rows)
    assert recording.times == pytest.approx(times - 3.0)
    assert not recording.interpolated.any()
    assert recording.at(0.15).positions == pytest.approx(np.array([[3.15, 0.0]]))


def test_a_track_with_rare_positions_lasts_where_they_are_a_little_late():
    times = np.array([0.0, 2.0, 4.8, 6.8, 8.8])
    rows = Rows("test", np.ones(5, int), times, np.outer(times, [1.0, 0.0]))
    recording = clean(Path("walk.csv"), rows)
    assert recording.people.tolist() == [1] and len(recording.times) == 5


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ([(1, 0, 0.0, 0.0), (1, 1, np.nan, 0.0)], "frame 1, person 1: time, x and y have to be"),
        ([(1, 0, 0.0, 0.0), (1, 1, np.inf, 0.0)], "frame 1, person 1: time, x and y have to be"),
        (
            [(1, 0, 0.0, 0.0), (2, 4, 0.0, 0.0), (2, 4, 1.0, 0.0)],
            "frame 4, person 2: is there twice",
        ),
        ([(1, -2, 0.0, 0.0), (1, 1, 0.1, 0.0)], "frame -2, person 1: frames and times are 0 or"),
        ([(1, 0, 0.0, 0.0), (2, 1, 0.1, 0.0)], "nobody is seen twice"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(cleaned, rows, told):
    with pytest.raises(RecordingError, match=told):
        cleaned(rows)


def test_centimetres_read_as_metres_are_refused_with_the_unit(cleaned):
    rows = [(p, f, 12.0 * f, 100.0 * p) for p in range(3) for f in range(20)]
    with pytest.raises(RecordingError, match=r"at 120 m/s .* in cm it would be 1.2 .*unit: cm"):
        cleaned(rows)


def test_metres_read_as_centimetres_are_refused_with_the_unit(cleaned):
    rows = [(p, f, 0.0012 * f, 0.01 * p) for p in range(3) for f in range(20)]
    with pytest.raises(
        RecordingError, match=r"read in cm, .* in m it would be 1.2 m/s \(unit: m\)"
    ):
        cleaned(rows, unit="cm")


def test_only_units_in_which_people_would_walk_are_offered(cleaned):
    rows = [(p, f, 12.0 * f, 100.0 * p) for p in range(3) for f in range(20)]
    with pytest.raises(RecordingError) as caught:
        cleaned(rows)
    told = str(caught.value)
    assert "unit: cm" in told and "unit: mm" in told
    with pytest.raises(RecordingError) as caught:
        cleaned([(p, f, 120.0 * f, 1000.0 * p) for p in range(3) for f in range(20)])
    assert "unit: mm" in str(caught.value) and "unit: cm" not in str(caught.value)


@pytest.mark.parametrize("alone", [True, False])
def test_somebody_alone_may_stand_and_a_crowd_needs_room(cleaned, alone):
    rows = [(p, f, 0.001 * f, 0.1 * p) for p in range(1 if alone else 2) for f in range(20)]
    if alone:
        assert len(cleaned(rows).times) == 20
    else:
        with pytest.raises(RecordingError, match=r"at 0\.01 m/s"):
            cleaned(rows)


def test_a_tenth_of_the_time_people_may_be_faster_than_anybody(cleaned):
    rows = [(1, f, 0.1 * f + 50 * (f > 99), 0.0) for f in range(200)]
    assert cleaned(rows).speeds.max() > 10
    jumping = [(1, f, 0.1 * f + 10 * (f // 20), 0.0) for f in range(200)]
    with pytest.raises(RecordingError, match="a tenth of the time faster"):
        cleaned(jumping)


def test_a_frame_rate_that_no_unit_explains_is_asked_about(cleaned):
    rows = [(p, f, 4.5 * f, 3.0 * p) for p in range(3) for f in range(20)]
    with pytest.raises(RecordingError, match="is the frame rate wrong"):
        cleaned(rows)


@pytest.mark.parametrize("fps", [0.025, 25_000])
def test_times_that_are_not_in_seconds_are_asked_about(cleaned, fps):
    with pytest.raises(RecordingError, match=r"a position every \S+ s, .* are times or frame rate"):
        cleaned(line(1, range(9)), fps=fps)


def test_people_who_stand_are_a_recording(cleaned):
    recording = cleaned([(p, f, 3.0 * p, 0.0) for p in range(3) for f in range(10)])
    assert recording.speeds.max() == 0.0
