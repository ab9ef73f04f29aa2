"""Which episode comes next in training."""

import numpy as np
import pytest
from crowdbench_agents.learning.sampler import ScenarioSampler

import crowdbench


def test_the_sampler_draws_what_fails_more_often_and_training_seeds_only():
    sampler = ScenarioSampler(3, crowdbench.scenario_names("paper"))
    for _ in range(500):
        for name in sampler.success:
            sampler.record(name, name != "corridor_dense")
    drawn = [next(sampler) for _ in range(1000)]
    share = np.mean([name == "corridor_dense" for name, _ in drawn])
    assert share == pytest.approx(1.1 / (1.1 + 11 * 0.1), abs=0.06)
    assert min(seed for _, seed in drawn) >= 10_000_000
    assert len({seed for _, seed in drawn}) == 1000
