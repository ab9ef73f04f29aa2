"""Acting while training."""

import numpy as np
import pytest
from crowdbench_agents.latent_planner.exploration import Explorer
from crowdbench_agents.latent_planner.learner import Learner
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.inputs import ActionBounds, Sensed
from crowdbench_agents.learning.replay import PLANNER

import crowdbench


def test_epsilon_falls_from_a_half_to_a_twentieth_over_25000_decisions(tiny):
    config = Config()
    learner = Learner(tiny(), seed=0)
    robot = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario("unimodal_slow"))
    explorer = Explorer(learner.model, config, ActionBounds.of(robot), np.arange(32), seed=0)
    seen = []
    for explorer.decisions in (0, 12_500, 25_000, 10**6):
        seen.append(explorer.epsilon)
    assert seen == pytest.approx([0.5, 0.275, 0.05, 0.05])


@pytest.mark.parametrize("reflect", [False, True])
def test_plans_are_examples_only_where_they_have_just_been_made(reflect, tiny):
    config = tiny(
        **{
            "training.planning_environments": 4, "training.labelled_environments": 0,
            "planner.reflect": reflect,
        }
    )  # fmt: skip
    robot = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario("unimodal_slow"))
    model = Learner(config, seed=0).model
    explorer = Explorer(model, config, ActionBounds.of(robot), np.arange(4), seed=0)
    sensed = Sensed(
        np.zeros((4, 16, 16), np.uint8), np.zeros((4, 2), np.float32), np.ones((4, 2), np.float32)
    )
    examples = sum((explorer.act(sensed).source == PLANNER).sum() for _ in range(30))
    assert examples == explorer.decisions < 30 * 4
