"""What a run tells."""

import pytest
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.journal import Journal
from crowdbench_agents.learning.validation import Validation
from full_disk import room_for


def test_a_learning_curve_keeps_the_columns_it_began_with(tmp_path):
    """An earlier version told no SPL."""
    curve = tmp_path / "curve.csv"
    counts = {"steps": 32, "decisions": 8, "updates": 1, "seconds": 2.0}
    result = Validation({"unimodal_slow": 0.5}, {"unimodal_slow": 0.25}, 0.125, 10.0)
    with Journal("run", tmp_path, curve, 100) as journal:
        journal.validated(result, counts, {})
        assert curve.read_text().splitlines() == [
            "steps,decisions,updates,seconds,success,spl,smoothness,time_to_goal,unimodal_slow",
            "32,8,1,2.0,0.5,0.25,0.125,10.0,0.5",
        ]
        curve.write_text("steps,success,unimodal_slow\n16,0.25,0.25\n")
        journal.validated(result, counts, {})
    assert curve.read_text() == "steps,success,unimodal_slow\n16,0.25,0.25\n32,0.5,0.5\n"


def test_a_curve_that_has_no_room_is_named(tmp_path):
    counts = {"steps": 32, "decisions": 8, "updates": 1, "seconds": 2.0}
    result = Validation({"unimodal_slow": 0.5}, {"unimodal_slow": 0.25}, 0.125, 10.0)
    told = r"curve.csv: could not be written \(File too large\); make room on the disk"
    with (
        Journal("run", tmp_path, tmp_path / "curve.csv", 100) as journal,
        room_for(100),
        pytest.raises(TrainingError, match=told),
    ):
        journal.validated(result, counts, {})


def test_recording_demonstrations_is_told_in_one_line_also_without_a_terminal(tmp_path, capsys):
    with Journal("run", tmp_path, tmp_path / "curve.csv", 100) as journal:
        journal.recorded(0, 80_000)
        journal.recorded(8, 80_000)
        told = capsys.readouterr().out
    assert told.count("recording 80000 expert demonstrations") == 1
