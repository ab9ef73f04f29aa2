"""DUNE: the closed form against other solvers, the network against the closed form."""

import hashlib
import json

import daqp
import numpy as np
import pytest
import shapely
from crowdbench_agents.neupan.agent import FOLDER, load_settings
from crowdbench_agents.neupan.dune import Footprint, WeightsError, load_dune
from crowdbench_agents.neupan.dune_training import (
    measure,
    sample_inside,
    sample_outside,
    save_dune,
    train_dune,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import save_file

ROBOT = np.array([[0.2, 0.15], [-0.2, 0.15], [-0.2, -0.15], [0.2, -0.15]])


def polygon(seed: int) -> Footprint:
    """A random convex polygon around the origin, 3 to 8 corners."""
    rng = np.random.default_rng(seed)
    corners = shapely.MultiPoint(rng.normal(size=(rng.integers(4, 12), 2))).convex_hull
    ring = shapely.geometry.polygon.orient(corners, 1.0).exterior.coords[:-1]
    return Footprint.from_corners(np.array(ring))


@pytest.mark.parametrize(
    "corners",
    [
        ROBOT[::-1],  # clockwise
        np.array([[0, 0], [1, 0], [0.1, 0.1], [0, 1]]),  # not convex
        np.array([[0, 0], [1, 0], [2, 0], [0, 1]]),  # three corners in line
        ROBOT[:2],
        ROBOT[[0, 2, 1, 3]],  # crosses itself
        np.ones((4, 3)),
    ],
)
def test_a_footprint_that_is_no_convex_polygon_is_refused(corners):
    with pytest.raises(ValueError, match="footprint corners"):
        Footprint.from_corners(corners)


def test_the_rectangle_by_hand():
    footprint = Footprint.from_corners(ROBOT)
    points = np.array([[1.2, 0.0], [0.0, -0.65], [0.5, 0.55], [0.0, 0.1]])
    mu = footprint.dual(points)
    front, left, right = 3, 0, 2
    assert mu[0, front] == pytest.approx(1.0)
    assert mu[1, right] == pytest.approx(1.0)
    # 0.3 m ahead of and 0.4 m left of a corner: a 3-4-5 triangle.
    assert mu[2, front] == pytest.approx(0.6)
    assert mu[2, left] == pytest.approx(0.8)
    assert not mu[3].any()
    assert footprint.distance(points, mu) == pytest.approx([1.0, 0.5, 0.5, 0.0])


@pytest.mark.parametrize("seed", range(12))
def test_labels_agree_with_a_generic_convex_solver(seed):
    """The nearest point of the polygon as a QP: its value is the distance, its multipliers mu."""
    footprint = polygon(seed)
    points = np.random.default_rng(seed).normal(scale=2.0, size=(20, 2))
    mu = footprint.dual(points)
    found = footprint.distance(points, mu)
    for p, label, value in zip(points, mu, found, strict=True):
        unbounded = np.full(len(footprint.h), -np.inf)
        y, _, flag, info = daqp.solve(np.eye(2), -p, footprint.G, footprint.h, unbounded)
        assert flag == 1
        distance = np.linalg.norm(p - y)
        assert value == pytest.approx(distance, abs=1e-8)
        if distance > 1e-6:
            assert label == pytest.approx(info["lam"] / distance, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10_000),
    st.tuples(st.floats(-5, 5), st.floats(-5, 5)),
)
def test_the_dual_is_feasible_and_its_value_is_the_distance(seed, point):
    footprint = polygon(seed)
    p = np.array([point])
    mu = footprint.dual(p)
    assert np.all(mu >= 0)
    assert np.linalg.norm(mu @ footprint.G) <= 1 + 1e-9
    truth = shapely.Polygon(footprint.corners).distance(shapely.Point(point))
    assert footprint.distance(p, mu)[0] == pytest.approx(truth, abs=1e-9)


def test_inside_the_nearest_edge_shows_the_way_out():
    footprint = Footprint.from_corners(ROBOT)
    points = np.array([[0.19, 0.0], [0.0, -0.1], [1.0, 0.0]])
    mu = footprint.with_interior(points, footprint.dual(points))
    assert footprint.distance(points, mu) == pytest.approx([-0.01, -0.05, 0.8])
    assert mu @ footprint.G == pytest.approx(np.array([[1, 0], [0, -1], [1, 0]]))


@pytest.mark.parametrize("seed", range(5))
def test_training_points_lie_where_they_are_meant_to(seed):
    footprint = polygon(seed)
    shape = shapely.Polygon(footprint.corners)
    rng = np.random.default_rng(seed)
    inside = shapely.points(sample_inside(footprint, rng, 200))
    assert shapely.distance(shape, inside).max() < 1e-9
    wanted = rng.uniform(0.0, 3.0, 200)
    outside = shapely.points(sample_outside(footprint, rng, wanted))
    assert shapely.distance(shape, outside) == pytest.approx(wanted, abs=1e-9)


def test_the_shipped_network_reaches_its_accuracy():
    s = load_settings()
    dune = load_dune(FOLDER / "weights" / s.weights, s.weights_sha256)
    assert dune.footprint.corners == pytest.approx(ROBOT)
    for row in measure(dune, Footprint.from_corners(ROBOT), seed=1, count=20_000):
        assert row.infeasibility < 1e-3
        if row.band[1] <= 3.0:
            assert row.rmse < 0.005
        if row.band[0] >= 0.1:
            assert row.normal_p99 < 5.0


def test_training_learns_the_footprint_it_is_given(tmp_path):
    footprint = Footprint.from_corners(np.array([[0.5, 0.0], [-0.3, 0.4], [-0.3, -0.4]]))
    dune = train_dune(footprint, seed=3, iterations=300, batch=512)
    rows = {row.band: row for row in measure(dune, footprint, seed=1, count=5_000)}
    # An untrained network is off by the distance itself.
    assert rows[0.5, 1.0].rmse < 0.05
    assert rows[1.0, 3.0].rmse < 0.2
    assert all(row.infeasibility < 1e-9 for row in rows.values())
    again = train_dune(footprint, seed=3, iterations=300, batch=512)
    points = np.random.default_rng(0).normal(size=(50, 2))
    assert np.array_equal(dune.dual(points), again.dual(points))
    path = tmp_path / "weights" / "triangle.safetensors"
    loaded = load_dune(path, save_dune(dune, path))
    assert loaded.footprint.corners == pytest.approx(footprint.corners)
    assert np.array_equal(loaded.dual(points), dune.dual(points))


def test_weights_that_are_not_what_they_should_be_are_refused(tmp_path):
    s = load_settings()
    original = (FOLDER / "weights" / s.weights).read_bytes()
    path = tmp_path / "dune.safetensors"
    with pytest.raises(WeightsError, match=r"dune\.safetensors.*cannot be read"):
        load_dune(path, s.weights_sha256)
    flipped = bytearray(original)
    flipped[-7] ^= 1
    path.write_bytes(flipped)
    with pytest.raises(WeightsError, match="corrupted or replaced"):
        load_dune(path, s.weights_sha256)
    for content in (b"not a tensor file", original[: len(original) // 2]):
        path.write_bytes(content)
        with pytest.raises(WeightsError, match="not an encoder"):
            load_dune(path, hashlib.sha256(content).hexdigest())
    save_file({"something": np.zeros(3, dtype=np.float32)}, path)
    with pytest.raises(WeightsError, match="not an encoder"):
        load_dune(path, hashlib.sha256(path.read_bytes()).hexdigest())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"1.bias": np.full(4, np.nan, np.float32)}, "'1.bias' has to be of finite float32"),
        ({"1.bias": np.zeros(4)}, "'1.bias' has to be of finite float32"),
        ({"1.bias": np.zeros(3, np.float32)}, r"'1.bias' has shape \(3,\), not \(4,\)"),
        (
            {"1.weight": np.zeros((8, 4), np.float32)},
            r"'1.weight' has shape \(8, 4\), not \(9, n\)",
        ),
        ({"1.weight": np.zeros(4, np.float32)}, "'1.weight' has shape"),
        ({"other": np.zeros(4, np.float32)}, "'other' is of no layer"),
        ({"1.bias": None, "x": np.zeros(1, np.float32)}, "'1.bias' is missing"),
    ],
)
def test_tensors_that_are_no_encoder_are_named(tmp_path, changes, message):
    path = tmp_path / "dune.safetensors"
    tensors = {
        "0.weight": np.ones((2, 9), np.float32), "0.bias": np.ones(9, np.float32),
        "1.weight": np.ones((9, 4), np.float32), "1.bias": np.ones(4, np.float32),
    }  # fmt: skip
    metadata = {"corners": json.dumps(ROBOT.tolist())}

    def load():
        return load_dune(path, hashlib.sha256(path.read_bytes()).hexdigest())

    save_file(tensors, path, metadata)
    assert load().dual(np.ones((3, 2))).shape == (3, 4)
    changed = {name: value for name, value in (tensors | changes).items() if value is not None}
    save_file(changed, path, metadata)
    with pytest.raises(
        WeightsError, match=rf"dune\.safetensors: not an encoder .*{message}"
    ) as caught:
        load()
    assert "\n" not in str(caught.value)
