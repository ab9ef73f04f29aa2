"""What networks see in training is what they see when they drive."""

import numpy as np
from crowdbench_agents.geometry.under_way import CommandsUnderWay
from crowdbench_agents.learning.lanes import Lanes

import crowdbench

GEOMETRY = crowdbench.MapGeometry(16, 6.0, 4.0)
LATE = """\
extends: multimodal_fast
robots: {latency: 2, acceleration: [1.0, 3.0], odometry: {rotation: 0.01, translation: 0.01}}
lidar: {mount: [0.1, 0.0, 0.3], noise: 0.02}
"""


def test_late_commands_are_foreseen_in_lanes_as_by_an_agent(tmp_path):
    file = tmp_path / "late.yaml"
    file.write_text(LATE)
    lanes = Lanes(2, [str(file)], ((str(file), seed) for seed in (3, 4)), GEOMETRY)
    assert lanes.begin(np.arange(2)).tolist() == [0, 1]
    under_way = [CommandsUnderWay(lanes.env.robot) for _ in range(2)]
    maps = [crowdbench.ObstacleMap(lanes.env.robot, GEOMETRY) for _ in range(2)]
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
    assert np.abs(lanes.sensed.velocity - lanes.seen["velocity"]).max() > 0.1
