"""Configurations that cannot be, and those of earlier weights."""

import pytest
from crowdbench_agents.learning.config import (
    STORED_NAMES,
    Config,
    ConfigError,
    load_config,
    with_present_names,
)


@pytest.mark.parametrize("decay", [[4, 4], [5, 4], [-1, 4], [3]])
def test_a_decay_without_length_is_refused(decay):
    with pytest.raises(ConfigError, match=r"training\.learning_rate_decay"):
        Config().override({"training.learning_rate_decay": decay})


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"cells": 50}, "cells: expected a whole number >= 16 and a multiple of 16 (got 50)"),
        ({"cells": 0}, "cells: 0 is out of range; allowed: >= 16 and a multiple of 16"),
        ({"size": 100.5}, "size: 100.5 is out of range; allowed: > 0 and <= 100"),
        (
            {"size": 5.0, "ahead": 5.5},
            "ahead: 5.5 m leave the robot out of the map; allowed: 0 to 5.0 (size)",
        ),
    ],
)
def test_a_map_has_cells_for_the_encoder_and_the_robot_in_it(changes, told):
    with pytest.raises(ConfigError) as caught:
        Config().override({f"perception.{name}": value for name, value in changes.items()})
    assert str(caught.value) == f"override: perception.{told}"


@pytest.mark.parametrize(("size", "ahead"), [(6, 4), (9, 6), (100, 100), (6, 0)])
def test_a_robot_may_be_anywhere_from_the_rear_edge_of_the_map_to_the_front(size, ahead):
    seen = Config().override({"perception.size": size, "perception.ahead": ahead}).perception
    assert (seen.size, seen.ahead) == (size, ahead)


@pytest.mark.parametrize("value", [float("inf"), float("nan")])
@pytest.mark.parametrize(
    "name", ["training.gradient_clip", "loss.entropy_target", "perception.size"]
)
def test_numbers_are_finite_as_checkpoints_are(name, value):
    with pytest.raises(ConfigError, match=name):
        Config().override({name: value})


@pytest.mark.parametrize("tiers", [["papper"], [], "paper", ["hard", "hard"], None, [["hard"]]])
def test_tiers_are_a_list_of_known_ones_each_once(tiers):
    with pytest.raises(ConfigError, match=r"training\.tiers: expected a list of paper, hard, sit"):
        Config().override({"training.tiers": tiers})


def test_configurations_of_earlier_weights_are_read_under_the_present_names():
    present = load_config().model_dump()
    stored = {section: dict(fields) for section, fields in present.items()}
    for (section, before), now in STORED_NAMES.items():
        stored[section][before] = stored[section].pop(now)
    assert with_present_names(stored) == present
    assert with_present_names(present) == present


def test_the_names_of_earlier_weights_are_not_those_of_a_configuration():
    for section, before in STORED_NAMES:
        with pytest.raises(ConfigError, match=f"{section}.{before}"):
            Config().override({f"{section}.{before}": 1})
