"""A run's folder and checkpoint."""

import numpy as np
import pytest
import torch
from crowdbench_agents.learning import checkpoints
from crowdbench_agents.learning.checkpoints import (
    CHECKPOINT,
    load_checkpoint,
    require_fitting,
    require_same_scenarios,
    run_folder,
    run_name,
    save_checkpoint,
)
from crowdbench_agents.learning.errors import TrainingError
from full_disk import room_for
from safetensors.torch import save_file

FORM = "some-networks"


def test_a_full_disk_is_told_and_leaves_the_checkpoint_before_alone(tmp_path):
    save_checkpoint(tmp_path, {"updates": 7}, {}, FORM)
    told = r"checkpoint\.safetensors: could not be written \(File too large\); make room on the"
    with room_for(1000), pytest.raises(TrainingError, match=told):
        save_checkpoint(tmp_path, {"updates": 8, "weights": torch.zeros(100_000)}, {}, FORM)
    assert load_checkpoint(tmp_path, FORM).state["updates"] == 7
    assert [path.name for path in tmp_path.iterdir()] == [CHECKPOINT]


def test_resuming_nothing_is_refused(tmp_path):
    with pytest.raises(TrainingError, match="nothing to resume"), run_folder(tmp_path, resume=True):
        pass


def test_a_folder_that_cannot_be_made_is_told(tmp_path):
    (tmp_path / "runs").write_text("no folder")
    refused = pytest.raises(TrainingError, match=r"runs/mine: cannot be written to \(")
    with refused, run_folder(tmp_path / "runs" / "mine", resume=False):
        pass


def test_a_run_that_is_being_trained_cannot_be_trained_by_another(tmp_path):
    folder = tmp_path / "run"
    refused = pytest.raises(TrainingError, match=r"run: another process is training this run")
    with run_folder(folder, resume=False), refused, run_folder(folder, resume=False):
        pass
    with run_folder(folder, resume=False):
        pass


def test_a_checkpoint_of_scenarios_that_have_changed_is_refused_by_their_names(tmp_path):
    then, now = {"one": "0123456789ab", "other": "123456789abc"}, {"one": "0123456789ab"}
    save_checkpoint(tmp_path, {"updates": 7}, then, FORM)
    assert load_checkpoint(tmp_path, FORM) == ({"updates": 7}, then)
    require_same_scenarios(tmp_path, now, then)
    for there, shown in ((now, "none"), (now | {"other": "23456789abcd"}, "23456789abcd")):
        changed = f"checkpoint.*other ones now: other .then 123456789abc, now {shown}"
        with pytest.raises(TrainingError, match=changed):
            require_same_scenarios(tmp_path, then, there)
    five = dict.fromkeys("abcde", "0" * 12)
    with pytest.raises(TrainingError, match=r"c \(then 0+, now none\) and 2 more; .*variants"):
        require_same_scenarios(tmp_path, five, then)


def test_a_damaged_checkpoint_is_told(tmp_path):
    (tmp_path / "checkpoint.safetensors").write_bytes(b"torn")
    with pytest.raises(TrainingError, match=r"checkpoint\.safetensors: cannot be read"):
        load_checkpoint(tmp_path, FORM)


def refusal(folder, form=FORM):
    with pytest.raises(TrainingError) as caught:
        load_checkpoint(folder, form)
    message = str(caught.value)
    assert message.startswith(f"{folder / 'checkpoint.safetensors'}: ")
    assert "\n" not in message
    return message.partition(": ")[2]


def test_every_flipped_bit_of_a_tensor_is_noticed(tmp_path):
    save_checkpoint(tmp_path, {"networks": {"weight": torch.full((50, 50), 0.3)}}, {}, FORM)
    path = tmp_path / "checkpoint.safetensors"
    content = bytearray(path.read_bytes())
    # 0.3 in float32
    content[content.index(bytes.fromhex("9a99993e") * 100) + 401] ^= 1
    path.write_bytes(content)
    assert refusal(tmp_path).startswith("damaged: its hash")


def test_a_torn_checkpoint_is_told(tmp_path):
    save_checkpoint(tmp_path, {"weight": torch.ones(5000)}, {}, FORM)
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes(path.read_bytes()[:9000])
    assert refusal(tmp_path).startswith("cannot be read")


@pytest.mark.parametrize("metadata", [None, {"format": "crowdbench-world-model-1"}])
def test_what_is_no_checkpoint_is_refused(tmp_path, metadata):
    save_file({"weight": torch.ones(3)}, tmp_path / "checkpoint.safetensors", metadata)
    assert refusal(tmp_path).startswith("no checkpoint")


def test_a_state_comes_back_as_it_was(tmp_path):
    model = torch.nn.Linear(3, 2)
    optimizer = torch.optim.Adam(model.parameters())
    model(torch.ones(3)).sum().backward()
    optimizer.step()
    generator = np.random.default_rng(3)
    state = {
        "optimizer": optimizer.state_dict(), "rng": generator.bit_generator.state,
        "noise": torch.Generator().manual_seed(5).get_state(), "best": 0.1, "name": "x", "no": {},
    }  # fmt: skip
    save_checkpoint(tmp_path, state, {}, FORM)
    found = load_checkpoint(tmp_path, FORM).state
    assert found.keys() == state.keys()
    other = torch.optim.Adam(torch.nn.Linear(3, 2).parameters())
    other.load_state_dict(found["optimizer"])
    for a, b in zip(optimizer.state.values(), other.state.values(), strict=True):
        for name in ("step", "exp_avg", "exp_avg_sq"):
            assert torch.equal(a[name], b[name])
    again = np.random.default_rng(0)
    again.bit_generator.state = found["rng"]
    assert again.random() == generator.random()
    assert torch.equal(found["noise"], state["noise"])
    assert (found["best"], found["name"], found["no"]) == (0.1, "x", {})


@pytest.mark.parametrize("bad", [torch.tensor([0.0, float("nan")]), float("inf")])
def test_what_has_diverged_never_takes_the_place_of_a_good_checkpoint(tmp_path, bad):
    save_checkpoint(tmp_path, {"updates": 7}, {}, FORM)
    with pytest.raises(TrainingError, match=r"not written, since 'a.1' has values .* is intact"):
        save_checkpoint(tmp_path, {"updates": 8, "a": [1.0, bad]}, {}, FORM)
    assert load_checkpoint(tmp_path, FORM).state == {"updates": 7}


def test_a_number_that_is_not_finite_is_named(tmp_path, monkeypatch):
    state = {"optimizer": {"state": {0: {"exp_avg": torch.tensor([0.0, float("nan")])}}}}
    with monkeypatch.context() as unchecked:
        unchecked.setattr(checkpoints, "_not_finite", lambda state: None)
        save_checkpoint(tmp_path, state, {}, FORM)
    assert refusal(tmp_path).startswith("'optimizer.state.0.exp_avg' has values")


def test_a_checkpoint_of_other_networks_is_refused(tmp_path):
    save_checkpoint(tmp_path, {}, {}, "other-networks")
    assert refusal(tmp_path) == "is of 'other-networks' networks, expected 'some-networks'"


def test_a_run_begins_without_the_replay_of_one_that_left_no_checkpoint(tmp_path):
    left = tmp_path / "replay" / "written.npy"
    left.parent.mkdir()
    left.touch()
    with run_folder(tmp_path, resume=False):
        assert not left.parent.exists()
        left.parent.mkdir()
        left.touch()
        (tmp_path / CHECKPOINT).touch()
    with run_folder(tmp_path, resume=True):
        assert left.is_file()


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ({"a": {"w": torch.ones(3)}}, r"'a.w' is a tensor of .*shape \(3,\), not .*shape \(2,\)"),
        ({"a": {"w": torch.ones(2).double()}}, "'a.w' is a tensor of torch.float64"),
        ({"a": {"w": 1.0}}, "'a.w' is no tensor, not a tensor"),
        ({"a": 1.0}, "'a.w' is missing"),
    ],
)
def test_a_state_of_other_sizes_is_refused_by_its_tensor(tmp_path, found, message):
    with pytest.raises(TrainingError, match=r"checkpoint\.safetensors: does not fit .*" + message):
        require_fitting(tmp_path, found, {"a": {"w": torch.ones(2)}})


@pytest.mark.parametrize("name", ["a", "latent_planner", "7", "A.b-c_d", "x" * 100])
def test_names_of_runs_are_names_of_files(name):
    assert run_name(name) == name


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "../x", "/tmp/x", "a/b", "a\\b", ".hidden", "-x", "x\n", "\0", "x" * 5000, "é"],
)
def test_names_that_lead_elsewhere_are_refused_in_a_short_line(name):
    with pytest.raises(TrainingError, match="1 to 100 letters, digits") as caught:
        run_name(name)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250
