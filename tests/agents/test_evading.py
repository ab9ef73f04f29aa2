"""Agents that see people only by LiDAR get out of the way of one who does not."""

import numpy as np
import pytest
from crowdbench_agents.dynamic_window import DynamicWindow
from crowdbench_agents.orca import Orca


@pytest.mark.parametrize("offset", [-0.2, 0.1, 0.3])
@pytest.mark.parametrize("agent", [Orca, DynamicWindow])
@pytest.mark.parametrize(
    ("where", "begin", "speed", "goal"),
    [("world", 5.0, 0.8, 5.0), ("slow_world", 8.0, 1.4, 6.0)],
)
def test_it_evades_somebody_who_does_not(request, where, begin, speed, goal, agent, offset):
    """With limits on the acceleration also one who comes faster than the robot drives."""
    path, outcome = request.getfixturevalue(where).drive(
        agent(), goal=(goal, 0.0), discs=[(begin, offset, 0.25)], velocities=[(-speed, 0.0)]
    )
    assert outcome == "success"
    assert np.abs(path[:, 1]).max() > 0.1
