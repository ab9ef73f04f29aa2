"""A run's folder and checkpoint."""

from pathlib import Path

import pytest
import torch
from crowdbench_agents.learning.checkpoints import load_checkpoint, run_folder, save_checkpoint
from crowdbench_agents.learning.errors import TrainingError

import crowdbench


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_full_disk_is_told_and_leaves_the_checkpoint_before(tmp_path):
    save_checkpoint(tmp_path, {"updates": 7}, {})
    (tmp_path / "checkpoint.part").symlink_to("/dev/full")
    with pytest.raises(TrainingError, match=r"checkpoint\.part: .* make room on the disk"):
        save_checkpoint(tmp_path, {"updates": 8, "weights": torch.zeros(100_000)}, {})
    assert load_checkpoint(tmp_path)["updates"] == 7


def test_resuming_nothing_is_refused(tmp_path):
    with pytest.raises(TrainingError, match="nothing to resume"), run_folder(tmp_path, resume=True):
        pass


def test_a_run_that_is_being_trained_cannot_be_trained_by_another(tmp_path):
    folder = tmp_path / "run"
    refused = pytest.raises(TrainingError, match=r"run: another process is training this run")
    with run_folder(folder, resume=False), refused, run_folder(folder, resume=False):
        pass
    with run_folder(folder, resume=False):
        pass


def test_a_checkpoint_of_scenarios_that_have_changed_is_refused_by_their_names(tmp_path):
    digests = {"corridor_sparse": crowdbench.load_scenario("corridor_sparse").digest}
    save_checkpoint(tmp_path, {"updates": 7}, digests)
    assert load_checkpoint(tmp_path) == {"updates": 7}
    save_checkpoint(tmp_path, {"updates": 8}, digests | {"unimodal_slow": "0123456789ab"})
    with pytest.raises(TrainingError, match=r"changed .*: unimodal_slow .then 0123456789ab, now "):
        load_checkpoint(tmp_path)


def test_a_checkpoint_that_does_not_name_its_scenarios_is_refused(tmp_path):
    torch.save({"worlds": "0123456789ab", "updates": 7}, tmp_path / "checkpoint.pt")
    with pytest.raises(TrainingError, match=r"earlier version of crowdbench.* under a new name"):
        load_checkpoint(tmp_path)


def test_a_damaged_checkpoint_is_told(tmp_path):
    (tmp_path / "checkpoint.pt").write_bytes(b"torn")
    with pytest.raises(TrainingError, match=r"checkpoint\.pt: cannot be read"):
        load_checkpoint(tmp_path)
