"""Options of the built-in agents without training: each has a range, said in one line."""

from __future__ import annotations

import inspect

import pytest

from crowdbench.agent import AgentError, AgentSpec, agent_options, find_agent

RANGES = {
    "orca": {"responsibility": (0, 1), "margin": (0, 1)},
    "dynamic_window": {"heading": (0, 1000), "clearance": (0, 1000), "speed": (0, 1000)},
    "informed": {"growth": (0, 10), "price": (0, 1000), "futures": (1, 100)},
    "neupan": {"horizon": (1, 100), "iterations": (1, 100), "reference_speed": (0.01, 20)},
}
"""Of numbers, both ends allowed."""
CHOICES = {
    ("neupan", "exact"),
    ("neupan", "predict"),
    ("neupan", "config"),
    ("informed", "intent"),
    ("informed", "view"),
}
NEEDED = {
    ("informed", "growth"): {"intent": "velocity"},
    ("informed", "price"): {"intent": "velocity"},
    ("informed", "futures"): {"intent": "sampled"},
}
"""Other options without which one has no meaning."""
CASES = [(agent, option) for agent, options in RANGES.items() for option in options]


def refusal(agent, option, text) -> str:
    with pytest.raises(AgentError) as caught:
        AgentSpec.parse(f"{agent}:{option}={text}").make()
    message = str(caught.value)
    assert message.startswith(f"agent '{agent}', option '{option}': expected ")
    assert "\n" not in message
    assert len(message) < 300
    return message


@pytest.mark.parametrize("agent", RANGES)
def test_every_option_has_a_range(agent):
    options = set(agent_options(find_agent(agent)))
    assert options == set(RANGES[agent]) | {o for a, o in CHOICES if a == agent}
    parameters = inspect.signature(find_agent(agent).__init__, eval_str=True).parameters
    assert all(hasattr(parameters[option].annotation, "__metadata__") for option in options)


@pytest.mark.parametrize(("agent", "option"), CASES)
def test_the_ends_of_a_range_are_allowed_and_what_lies_beyond_is_not(agent, option):
    low, high = RANGES[agent][option]
    for value in (low, high):
        AgentSpec(agent, {option: value, **NEEDED.get((agent, option), {})}).make()
    for value in (-low - 1, -1, high + 1, 1e300, ".inf", "-.inf", 10**50):
        assert f"<= {high}" in refusal(agent, option, value)


@pytest.mark.parametrize(("agent", "option"), [*CASES, *sorted(CHOICES)])
@pytest.mark.parametrize("text", ["1e-4x", "yes", "-3", "2020-01-01", ".nan", "9" * 4000])
def test_values_of_another_kind_are_refused(agent, option, text):
    if (option, text) in (("exact", "yes"), ("config", "1e-4x"), ("config", "2020-01-01")):
        return
    refusal(agent, option, text)


def test_an_agent_from_elsewhere_declares_ranges_the_same_way(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        "from typing import Annotated\n"
        "from pydantic import Field\n"
        "import crowdbench\n"
        "class Mine(crowdbench.Agent):\n"
        "    def __init__(self, gain: Annotated[float, Field(gt=0, le=5)] = 1.0, way: float = 0):\n"
        "        self.gain = gain\n"
        "    def reset(self, robot, seed): pass\n"
        "    def act(self, observation): return 0.0, 0.0\n"
    )
    assert AgentSpec.parse(f"{path}:gain=1e-2,way=left").make().gain == 0.01
    with pytest.raises(AgentError, match="option 'gain': expected a number > 0 and <= 5, got 7"):
        AgentSpec.parse(f"{path}:gain=7").make()


def test_annotations_that_mean_nothing_are_no_obstacle(tmp_path):
    path = tmp_path / "odd.py"
    path.write_text(
        "import crowdbench\n"
        "class Odd(crowdbench.Agent):\n"
        "    def __init__(self, gain: 'no such type' = 1.0): self.gain = gain\n"
        "    def reset(self, robot, seed): pass\n"
        "    def act(self, observation): return 0.0, 0.0\n"
    )
    assert AgentSpec.parse(f"{path}:gain=7").make().gain == 7
