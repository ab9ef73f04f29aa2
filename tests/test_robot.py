"""What a planner is told about its robot."""

import numpy as np
import pytest

from crowdbench import RobotSpec, load_scenario
from crowdbench.robot import lidar_angles


@pytest.mark.parametrize(("beams", "view"), [(4, 360), (3, 180), (1, 90)])
def test_beams_are_spread_over_the_field_of_view(beams, view):
    scenario = load_scenario("multimodal_fast", lidar={"beams": beams, "field_of_view": view})
    expected = {4: [0, 90, 180, 270], 3: [-90, 0, 90], 1: [0]}[beams]
    np.testing.assert_allclose(np.rad2deg(lidar_angles(scenario)), expected, atol=1e-12)


def test_a_robot_spec_says_what_the_scenario_says():
    spec = RobotSpec.from_scenario(load_scenario("multimodal_fast"), "robot_2")
    assert spec.name == "robot_2"
    assert spec.radius == pytest.approx(0.25)
    np.testing.assert_allclose(
        spec.corners, [[0.2, 0.15], [-0.2, 0.15], [-0.2, -0.15], [0.2, -0.15]]
    )
