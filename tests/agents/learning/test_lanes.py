"""What networks see in training is what they see when they drive."""

from pathlib import Path

import numpy as np
from crowdbench_agents.geometry.under_way import CommandsUnderWay
from crowdbench_agents.learning.lanes import Lanes
from crowdbench_agents.learning.worlds import as_they_are

import crowdbench

GEOMETRY = crowdbench.MapGeometry(16, 6.0, 4.0)
LATE = """\
extends: multimodal_fast
robots: {latency: 2, acceleration: [1.0, 3.0], odometry: {rotation: 0.01, translation: 0.01}}
lidar: {mount: [0.1, 0.0, 0.3], noise: 0.02}
"""


def test_late_commands_are_foreseen_in_lanes_as_by_an_agent(tmp_path):
    """In scenarios of two control periods."""
    files = [str(tmp_path / name) for name in ("late.yaml", "slower.yaml")]
    for file, period in zip(files, (0.2, 0.5), strict=True):
        Path(file).write_text(f"{LATE}control_period: {period}\n")
    lanes = Lanes(2, as_they_are(files), zip(files, (3, 4), strict=True), GEOMETRY)
    assert lanes.begin(np.arange(2)).tolist() == [0, 1]
    robots = [crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario(file)) for file in files]
    under_way = [CommandsUnderWay(robot) for robot in robots]
    maps = [crowdbench.ObstacleMap(robot, GEOMETRY) for robot in robots]
    actions = np.random.default_rng(0).uniform([0.0, -2.0], [1.3, 2.0], (6, 2, 2))
    for action in actions:
        for lane in range(2):
            seen = lanes.observation(lane)
            ahead = under_way[lane].foresee(seen)
            np.testing.assert_allclose(lanes.sensed.velocity[lane], ahead.velocity, atol=1e-6)
            np.testing.assert_allclose(lanes.sensed.goal[lane], ahead.goal, atol=1e-6)
            drawn = maps[lane].update(seen.lidar, seen.pose, ahead.pose)
            # A point on the border of two cells may fall to either side.
            assert np.count_nonzero(drawn != lanes.sensed.map[lane]) <= 2
            under_way[lane].send(action[lane])
        lanes.step(action)
    assert [lanes.robot(lane).control_period for lane in range(2)] == [0.2, 0.5]
    assert np.abs(lanes.sensed.velocity - lanes.seen["velocity"]).max() > 0.1
