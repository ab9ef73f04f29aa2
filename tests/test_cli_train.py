"""The command that trains hands over to whoever can, and says what comes of it."""

import importlib.metadata
from pathlib import Path

import pytest

from crowdbench.cli import main
from crowdbench.cli.train import _read_seeds


class Trainers:
    """Entry points with one trainer that notes what it is asked."""

    module, name = "tests.fake", "fake"

    def __init__(self, error=None):
        self.asked, self.error = None, error

    def __call__(self, group):
        return [self]

    def load(self):
        return self.train

    def train(self, **asked):
        self.asked = asked
        if self.error:
            raise self.error
        return Path("runs") / asked["name"]


def test_train_hands_over_to_the_agents_trainer(monkeypatch, capsys):
    trainers = Trainers()
    monkeypatch.setattr(importlib.metadata, "entry_points", trainers)
    options = ["--minutes", "1.5", "--seed", "7", "--no-social", "--set", "training.batch=8"]
    assert main(["train", "fake", "--name", "mine", *options]) == 0
    assert trainers.asked == {
        "name": "mine",
        "minutes": 1.5,
        "steps": None,
        "resume": False,
        "seed": 7,
        "social": False,
        "overrides": {"training.batch": 8},
    }
    assert main(["train", "fake", "--resume", "--steps", "100"]) == 0
    own = {"seed", "social", "device", "actors"}
    assert own.isdisjoint(trainers.asked), "the trainer's own defaults"
    assert (trainers.asked["resume"], trainers.asked["steps"]) == (True, 100)
    assert "runs/fake" in capsys.readouterr().out


@pytest.mark.parametrize("options", [[], ["--resume"]])
def test_a_trainer_without_a_seed_of_its_own_begins_and_goes_on_with_0(monkeypatch, options):
    trainers, seeds = Trainers(), []
    monkeypatch.setattr(importlib.metadata, "entry_points", trainers)

    def train(name, minutes, steps, resume, seed, overrides):
        seeds.append(seed)

    monkeypatch.setattr(trainers, "train", train)
    assert main(["train", "fake", *options]) == 0
    assert seeds == [0]


def test_device_and_actors_are_asked_of_trainers_that_know_them(monkeypatch, capsys):
    trainers = Trainers()
    monkeypatch.setattr(importlib.metadata, "entry_points", trainers)
    options = ["--device", "cpu", "--actors", "3"]
    assert main(["train", "fake", *options]) == 0
    assert (trainers.asked["device"], trainers.asked["actors"]) == ("cpu", 3)
    capsys.readouterr()
    monkeypatch.setattr(trainers, "train", lambda name, minutes, steps, resume, seed: None)
    assert main(["train", "fake", *options]) == 2
    assert capsys.readouterr().err == "fake: --device is nothing that its trainer takes\n"


def test_what_a_trainer_says_is_for_the_user_and_bugs_are_not_hidden(monkeypatch, capsys):
    class DivergedError(RuntimeError):
        __module__ = "tests.fake.learner"

    monkeypatch.setattr(importlib.metadata, "entry_points", Trainers(DivergedError("loss is nan")))
    assert main(["train", "fake"]) == 2
    assert capsys.readouterr().err == "fake: loss is nan\n"
    monkeypatch.setattr(importlib.metadata, "entry_points", Trainers(ZeroDivisionError("bug")))
    with pytest.raises(ZeroDivisionError):
        main(["train", "fake"])


@pytest.mark.parametrize("name", ["../x", "/tmp/x", "", "x" * 5000, ".."])
def test_a_run_of_training_stays_in_its_folder(tmp_path, monkeypatch, capsys, name):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert main(["train", "sac", "--name", name, "--steps", "1"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert "expected 1 to 100 letters, digits and _.-" in lines[0]
    assert [path.name for path in tmp_path.rglob("*")] == ["here"]


@pytest.mark.parametrize(
    ("text", "seeds"), [("0-2", [0, 1, 2]), ("7", [7]), ("3,1,3", [3, 1]), ("5-5", [5])]
)
def test_seeds_are_a_range_or_a_list(text, seeds):
    assert _read_seeds(text) == seeds


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--seeds", "0-2"], "--seeds and --address are for --executor ray"),
        (["--executor", "slurm"], "--executor 'slurm': trainings run on local or ray"),
        (["--executor", "ray"], "--minutes or --steps: --executor ray needs one"),
        (["--executor", "ray", "--steps", "9", "--seeds", "4-2"], "--seeds '4-2': expected A-B"),
        (["--executor", "ray", "--steps", "9", "--seeds", "0-1000"], "at most 1000 seeds"),
        (["--executor", "ray", "--steps", "9"], "runs/fake holds a run"),
    ],
)
def test_what_cannot_be_trained_there_is_refused(tmp_path, monkeypatch, capsys, options, told):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs/fake").mkdir(parents=True)
    (tmp_path / "runs/fake/last.safetensors").touch()
    monkeypatch.setattr(importlib.metadata, "entry_points", Trainers())
    assert main(["train", "fake", *options]) == 2
    assert told in capsys.readouterr().err
