"""LiDARs that are not at the robot's centre."""

import numpy as np
import pytest
import shapely

import crowdbench
from crowdbench.simulation import streams


def scan(scenario="corridor_dense", seed=4, steps=3, **lidar):
    """A robot's specification, its scan, and the true state it is of."""
    env = crowdbench.parallel_env(scenario, lidar=lidar, **{"obstacles.count": 3})
    env.reset(seed=seed)
    for _ in range(steps):
        seen, *_ = env.step({"robot_0": (0.5, 0.7)})
    return env.robot_spec(), seen["robot_0"]["lidar"].astype(float), env.state()


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.2, -0.15, 0.0), (-0.1, 0.05, 2.5)])
@pytest.mark.parametrize("view", [360.0, 200.0])
def test_beams_end_on_surfaces_where_the_specification_says_they_begin(mount, view):
    spec, ranges, state = scan(mount=mount, field_of_view=view)
    assert spec.lidar_mount == mount
    hit = ranges < spec.lidar_range
    assert hit.sum() > 20
    ends = np.array(spec.lidar_mount[:2]) + ranges[hit, None] * np.column_stack(
        [np.cos(spec.lidar_angles[hit]), np.sin(spec.lidar_angles[hit])]
    )
    x, y, heading = state["robot_pose"][0]
    c, s = np.cos(heading), np.sin(heading)
    ends = ends @ np.array([[c, s], [-s, c]]) + [x, y]
    discs = [(*place, 0.25) for place in state["pedestrian_position"]] + list(state["obstacles"])
    surfaces = [shapely.Point(a, b).buffer(r, quad_segs=64).exterior for a, b, r in discs]
    surfaces += [shapely.LineString(wall.reshape(2, 2)) for wall in state["walls"]]
    off = shapely.MultiLineString([list(one.coords) for one in surfaces])
    assert max(off.distance(shapely.Point(end)) for end in ends) < 1e-4


def test_a_lidar_that_is_turned_begins_its_scan_elsewhere():
    _, plain, _ = scan()
    _, turned, _ = scan(mount=(0.0, 0.0, np.pi / 2))
    np.testing.assert_allclose(turned, np.roll(plain, -45), atol=1e-5)


def test_what_happens_does_not_depend_on_where_the_lidar_is():
    one, other = scan()[2], scan(mount=(0.2, 0.0, 1.0))[2]
    for key in one:
        np.testing.assert_array_equal(one[key], other[key])


def test_every_scan_takes_noise_and_then_dropout_from_the_generator_of_its_episode():
    settings = [(0.05, 0.2), (0.3, 0.0), (0.0, 0.3), (0.0, 0.0)]
    far = np.float32(3.3)  # scans hold float32, and in float64 3.3 is another number
    small = {"pedestrians.count": 2, "lidar.beams": 60, "lidar.range": 3.3}
    worlds = [
        crowdbench.load_scenario(
            "corridor_sparse", **small, **{"lidar.noise": s, "lidar.dropout": d}
        )
        for s, d in settings
    ]
    lanes = np.arange(len(worlds))
    env, clean = crowdbench.vector_env(worlds, len(worlds)), crowdbench.vector_env(worlds[-1], 4)
    seen, _ = env.reset(seed=30, options={"scenario": lanes})
    true, _ = clean.reset(seed=30)
    generators = [streams.lidar(30 + lane, 0) for lane in lanes.tolist()]
    for _ in range(3):
        for lane, (noise, dropout) in enumerate(settings):
            expected = true["lidar"][lane].copy()
            if noise:
                off = np.clip(expected + generators[lane].normal(0.0, noise, 60), 0.0, 3.3)
                expected[expected < far] = off[expected < far]
            if dropout:
                expected[generators[lane].random(60) < dropout] = far
            np.testing.assert_array_equal(seen["lidar"][lane], expected)
        seen, true = env.step(np.full((4, 2), 0.2))[0], clean.step(np.full((4, 2), 0.2))[0]
