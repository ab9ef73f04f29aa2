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
