"""Commands for robots that cannot do anything at once."""

import dataclasses

import numpy as np
import pytest
from crowdbench_agents.geometry.steering import reachable, turn_towards

import crowdbench

SPEC = crowdbench.RobotSpec.from_scenario(crowdbench.Scenario(name="test"))
LIMITED = dataclasses.replace(SPEC, acceleration=(1.0, 3.0))


@pytest.mark.parametrize("bearing", [-2.0, 0.0, 0.3])
def test_without_limits_a_turn_takes_one_period(bearing):
    assert turn_towards(SPEC, bearing) == bearing / 0.2


@pytest.mark.parametrize("bearing", [-3.0, -0.4, 0.05, 1.0, 2.5])
def test_with_limits_a_turn_comes_to_rest_where_it_should(bearing):
    left, turning, rates = bearing, 0.0, []
    for _ in range(40):
        wanted = np.clip(turn_towards(LIMITED, left), -1.5, 1.5)
        _, turning = reachable(LIMITED, (0.0, wanted), (0.0, turning))
        left -= 0.2 * turning
        rates.append(turning)
    assert left == pytest.approx(0.0, abs=1e-9)
    # It never turns back.
    assert min(np.sign(bearing) * np.array(rates)) > -1e-9


def test_what_is_reachable_is_within_the_limits():
    assert reachable(SPEC, (1.0, -1.5), (0.0, 0.0)) == (1.0, -1.5)
    assert reachable(LIMITED, (1.0, -1.5), (0.3, 0.0)) == pytest.approx((0.5, -0.6))
    assert reachable(LIMITED, (0.35, 0.1), (0.3, 0.0)) == pytest.approx((0.35, 0.1))
