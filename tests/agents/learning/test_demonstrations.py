"""Demonstrations: recorded once, however many runs want them."""

import threading

import crowdbench_agents.learning.demonstrations as module
import numpy as np
import pytest
from crowdbench_agents.learning.demonstrations import LANES, Demonstrations
from crowdbench_agents.learning.experts import Experts
from crowdbench_agents.learning.worlds import training_worlds
from simple_kind import SMALL

from crowdbench.agent import find_agent

WANTED = 200


def demonstrations(folder, **changes):
    config = SMALL.override({"training.demonstrations": WANTED, **changes})
    return Demonstrations(folder, config, True, training_worlds(config.training))


@pytest.mark.slow
def test_of_two_runs_that_start_together_one_records_and_the_other_waits(
    in_empty_folder, monkeypatch
):
    recorders, waited = [], []
    monkeypatch.setattr(module, "LOOK", 0.001)
    monkeypatch.setattr(module, "Experts", lambda *given: recorders.append(0) or Experts(*given))
    first, second = demonstrations(in_empty_folder), demonstrations(in_empty_folder)
    looked = threading.Event()

    def wait(there):
        waited.append(there)
        looked.set()

    other = threading.Thread(target=second.record, args=(wait, lambda: False))

    def progress(there):
        if there == 10 * LANES:
            other.start()
            assert looked.wait(60), "the second run tells how far the first one is"

    first.record(progress, lambda: False)
    other.join()
    assert len(recorders) == 1
    assert waited[0] == 10 * LANES
    assert WANTED <= len(first) == len(second) < WANTED + 2 * LANES


def test_what_one_run_has_left_another_one_records(in_empty_folder):
    seen = []
    demonstrations(in_empty_folder).record(seen.append, lambda: len(seen) > 5)
    later = demonstrations(in_empty_folder)
    assert len(later) == seen[-1] < WANTED
    later.record(seen.append, lambda: False)
    assert len(later) >= WANTED
    goals = [later._data.goal[lane, :n] for lane, n in enumerate(later.lengths())]
    assert len(np.unique(np.concatenate(goals), axis=0)) == len(later), "nothing comes twice"


@pytest.mark.parametrize("change", [("size", 9.0), ("ahead", 2.0), ("cells", 64)])
def test_a_run_with_another_map_has_demonstrations_of_its_own(in_empty_folder, change):
    demonstrations(in_empty_folder).record(lambda there: None, lambda: True)
    name, value = change
    demonstrations(in_empty_folder, **{f"perception.{name}": value})
    assert len(list(in_empty_folder.glob("demonstrations-*"))) == 2


EXPERT = """\
import crowdbench


class Stands(crowdbench.Agent):
    def reset(self, robot, seed):
        pass

    def act(self, observation):
        return 0.0, 0.0
"""


def test_demonstrations_of_another_expert_or_world_are_not_used(in_empty_folder, monkeypatch):
    file = in_empty_folder / "stands.py"
    file.write_text(EXPERT)

    def folders(expert):
        demonstrations(in_empty_folder / "runs", **{"training.expert": expert})
        return len(list((in_empty_folder / "runs").glob("demonstrations-*")))

    assert folders(f"{file.name}:Stands") == 1
    assert folders(f"{file.name}:Stands") == 1
    file.write_text(EXPERT.replace("0.0, 0.0", "0.5, 0.0"))
    assert folders(f"{file.name}:Stands") == 2
    monkeypatch.setattr(module, "WORLD_VERSION", "of tomorrow")
    assert folders(f"{file.name}:Stands") == 3
    assert folders("straight_line") == 4
    monkeypatch.setattr(find_agent("straight_line"), "version", "of tomorrow")
    assert folders("straight_line") == 5
    monkeypatch.setattr(find_agent("straight_line"), "weights_sha256", "abc")
    assert folders("straight_line") == 6
