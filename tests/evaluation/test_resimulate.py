"""Episodes simulated again from seed and commands."""

from dataclasses import fields

import numpy as np
import pytest

from crowdbench.agent import Agent
from crowdbench.evaluation.driven import ResimulationError
from crowdbench.evaluation.resimulate import resimulate
from crowdbench.evaluation.rollout import run_episode
from crowdbench.scenario import load_scenario

NOT_SIMULATED = {"inference_s", "processor_share", "diagnostics"}


class Swerves(Agent):
    """Asks for more than there is, and fails at a step if told so."""

    drives = ("differential", "omnidirectional")

    def __init__(self, fails_at=None):
        self.fails_at = fails_at

    def reset(self, robot, seed):
        self.rng, self.step = np.random.default_rng(seed), 0

    def act(self, observation):
        if self.step == self.fails_at:
            raise RuntimeError("no more")
        self.step += 1
        return self.rng.normal([0.8, 0.0], [0.5, 2.0])


def assert_same(a, b):
    for field in fields(a):
        if field.name not in NOT_SIMULATED:
            one, other = getattr(a, field.name), getattr(b, field.name)
            np.testing.assert_array_equal(one, other, err_msg=field.name)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"robots.acceleration": [1.0, 3.0]},
        {"robots.count": 3, "pedestrians.model": "social_force"},
        {"lidar.noise": 0.05, "pedestrians.reactive": 0.5},
        {"robots.drive": "omnidirectional"},
    ],
)
def test_everything_that_is_simulated_comes_out_the_same(changes):
    scenario = load_scenario("corridor_dense", **changes)
    count = scenario.robots.count
    agents = [Swerves(5 if r == 1 else None) for r in range(count)]
    before = run_episode(scenario, agents, 11, label="swerves")
    again = resimulate(
        scenario,
        11,
        [episode.commands for episode in before],
        label="swerves",
        errors=[episode.error for episode in before],
    )
    for one, other in zip(before, again, strict=True):
        assert_same(one, other)
    assert any(len(episode.commands) > 3 for episode in before)


def test_commands_of_another_seed_are_refused():
    scenario = load_scenario("multimodal_fast")
    (before,) = run_episode(scenario, [Swerves()], 3, label="swerves")
    with pytest.raises(ResimulationError, match=r"swerves, multimodal_fast, seed 3, robot_0: goes"):
        resimulate(scenario, 3, [before.commands[:-1]], label="swerves")
    longer = np.vstack([before.commands, before.commands])
    with pytest.raises(ResimulationError, match=f"ended after {before.steps} steps"):
        resimulate(scenario, 3, [longer], label="swerves")
    with pytest.raises(ResimulationError, match="ended"):
        resimulate(scenario, 3, [before.commands], label="swerves", errors=["it broke"])
