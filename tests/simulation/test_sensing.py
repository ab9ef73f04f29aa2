"""LiDARs that are not at the robot's centre."""

import numpy as np
import pytest
import shapely
from scipy import stats

import crowdbench


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


def noisy(noise, dropout, action=(0.2, 0.0), seed=30, steps=60):
    """Scans (steps, beams) of a robot among walls with and without noise, [m]."""
    scans = []
    for settings in ((noise, dropout), (0.0, 0.0)):
        lidar = dict(zip(("lidar.noise", "lidar.dropout"), settings, strict=True))
        env = crowdbench.parallel_env("corridor_sparse", **lidar, **{"obstacles.count": 0})
        seen, _ = env.reset(seed=seed)
        found = []
        for _ in range(steps):
            found.append(seen["robot_0"]["lidar"].astype(float))
            seen, *_ = env.step({"robot_0": action})
        scans.append(found)
    return np.array(scans)


def test_noise_is_normal_where_a_beam_hits():
    seen, true = noisy(0.03, 0.0)
    hit = true < true.max()
    off, there = seen - true, hit & (seen < true.max())
    assert there.sum() > 3000
    assert stats.kstest(off[there], stats.norm(0.0, 0.03).cdf).pvalue > 1e-3
    twice = there[1:] & there[:-1]
    assert stats.pearsonr(off[1:][twice], off[:-1][twice]).pvalue > 1e-3
    np.testing.assert_array_equal(seen[~hit], true[~hit])


def test_noise_never_leads_out_of_a_lidars_range():
    seen, true = noisy(1.0, 0.0)
    assert seen.min() == 0.0
    assert seen.max() == true.max()


def test_beams_are_lost_as_often_as_is_said_and_one_by_one():
    seen, true = noisy(0.0, 0.2)
    hit = true < true.max()
    lost = seen == true.max()
    assert stats.binomtest(int(lost[hit].sum()), int(hit.sum()), 0.2).pvalue > 1e-3
    np.testing.assert_array_equal(seen[~lost], true[~lost])
    both = hit[:, 1:] & hit[:, :-1]
    pairs = (lost[:, 1:] & lost[:, :-1])[both]
    assert stats.binomtest(int(pairs.sum()), len(pairs), 0.04).pvalue > 1e-3
    again = (lost[1:] & lost[:-1])[hit[1:] & hit[:-1]]
    assert stats.binomtest(int(again.sum()), len(again), 0.04).pvalue > 1e-3


def test_what_a_scans_noise_is_does_not_depend_on_what_the_robot_does():
    """Nor on which beams hit anything, nor on whether there are dropouts."""
    ways = [noisy(0.03, 0.0, action) for action in ((0.0, 0.0), (0.3, 0.8))]
    off = [seen - true for seen, true in ways]
    hit = [(true < true.max()) & (seen < true.max()) & (seen > 0) for seen, true in ways]
    both = hit[0] & hit[1]
    assert both.sum() > 3000
    assert not np.array_equal(ways[0][1], ways[1][1])
    np.testing.assert_allclose(off[0][both], off[1][both], atol=1e-6)

    seen, true = noisy(0.03, 0.3, (0.0, 0.0))
    left = (seen < true.max()) & hit[0]
    np.testing.assert_array_equal(seen[left], ways[0][0][left])


def test_robots_and_episodes_have_noise_of_their_own():
    env = crowdbench.parallel_env("corridor_sparse", **{"robots.count": 2, "lidar.noise": 0.5})
    clean = crowdbench.parallel_env("corridor_sparse", **{"robots.count": 2})
    offs = []
    for seed in (3, 4, 3):
        seen, true = env.reset(seed=seed)[0], clean.reset(seed=seed)[0]
        offs += [seen[name]["lidar"] - true[name]["lidar"] for name in env.agents]
    for other in offs[1:3]:
        there = (offs[0] != 0) & (other != 0)
        assert there.sum() > 30
        assert not np.isclose(offs[0], other)[there].any()
    np.testing.assert_array_equal(offs[:2], offs[4:])


def test_lanes_have_the_noise_that_their_scenarios_say():
    """The same as one environment of each has, whichever lanes are beside it."""
    settings = [(0.05, 0.2), (0.3, 0.0), (0.0, 0.3), (0.0, 0.0)]
    small = {"pedestrians.count": 2, "lidar.beams": 60, "lidar.range": 3.3}
    worlds = [
        crowdbench.load_scenario(
            "corridor_sparse", **small, **{"lidar.noise": s, "lidar.dropout": d}
        )
        for s, d in settings
    ]
    env = crowdbench.vector_env(worlds, len(worlds))
    seen, _ = env.reset(seed=30, options={"scenario": np.arange(len(worlds))})
    alone = [crowdbench.parallel_env(world) for world in worlds]
    single = [one.reset(seed=30 + lane)[0] for lane, one in enumerate(alone)]
    for _ in range(3):
        for lane, one in enumerate(single):
            np.testing.assert_array_equal(seen["lidar"][lane], one["robot_0"]["lidar"])
        seen = env.step(np.full((4, 2), 0.2))[0]
        single = [one.step({"robot_0": (0.2, 0.2)})[0] for one in alone]
