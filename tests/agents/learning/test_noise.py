"""Noise that stays alike from one step to the next."""

import numpy as np
import pytest
from crowdbench_agents.learning.noise import CorrelatedNoise


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_noise_has_the_spread_and_correlation_that_were_asked_for(correlation):
    noise = CorrelatedNoise((500, 2), 0.7, correlation, np.random.default_rng(0))
    steps = np.array([noise.step() for _ in range(300)])[50:]
    assert steps.mean() == pytest.approx(0.0, abs=0.02)
    assert steps.std() == pytest.approx(0.7, abs=0.01)
    found = np.corrcoef(steps[:-1].ravel(), steps[1:].ravel())[0, 1]
    assert found == pytest.approx(correlation, abs=0.01)


def test_noise_is_none_without_spread():
    noise = CorrelatedNoise((3,), 0.0, 0.5, np.random.default_rng(0))
    assert not noise.step().any()
