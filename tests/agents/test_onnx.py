"""Policies in ONNX files: what they are given, and which are refused."""

import sys
from pathlib import Path

import numpy as np
import onnx
import onnx.parser
import psutil
import pytest
from onnx.external_data_helper import convert_model_to_external_data

import crowdbench
from crowdbench.agent import AgentError
from crowdbench.evaluation.rollout import run_episode

ROBOT = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario("multimodal_fast"))
ALL = "float[180] lidar, float[2] velocity, float[2] goal, float[3] pose"
PICK = """
    three = Constant<value = int64[1] {3}>()
    lidar_3 = Gather(lidar_flat, three)
    one = Constant<value = int64[1] {1}>()
    two = Constant<value = int64[1] {2}>()
    velocity_1 = Gather(velocity_flat, one)
    goal_1 = Gather(goal_flat, one)
    pose_2 = Gather(pose_flat, two)
    first = Add(lidar_3, velocity_1)
    second = Mul(goal_1, pose_2)
    action = Concat<axis = 0>(first, second)
"""
FLAT = "flat = Constant<value = int64[1] {-1}>()" + "".join(
    f"\n{name}_flat = Reshape({name}, flat)" for name in ("lidar", "velocity", "goal", "pose")
)
STILL = "action = Constant<value = float[2] {0.5, 0.25}>()"
COUNT = """
    some = Cast<to = 1>(map)
    all = ReduceSum<keepdims = 0>(some)
    scale = Constant<value = float[2] {0.001, 0.0}>()
    action = Mul(all, scale)
"""
EXTENT = '{"cells": 16, "size": 4.0, "ahead": 3.0}'


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Writes an ONNX file from its text and returns its name, in the working folder."""
    monkeypatch.chdir(tmp_path)

    def write(inputs, body=STILL, output="float[2] action", name="policy.onnx", **metadata):
        text = f'<ir_version: 8, opset_import: ["": 18]> g ({inputs}) => ({output}) {{ {body} }}'
        model = onnx.parser.parse_model(text)
        onnx.helper.set_model_props(
            model, {f"crowdbench.{key}": text for key, text in metadata.items()}
        )
        onnx.save(model, name)
        return name

    return write


def make(text):
    return crowdbench.AgentSpec.parse(text).make()


def refusal(text) -> str:
    with pytest.raises(AgentError) as caught:
        make(text)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def observation(rng):
    return crowdbench.Observation(
        lidar=rng.uniform(0.5, 6.0, 180).astype(np.float32),
        velocity=rng.uniform([0, -1.5], [1, 1.5]).astype(np.float32),
        goal=rng.uniform(-4, 4, 2).astype(np.float32),
        pose=rng.uniform(-1, 1, 3).astype(np.float32),
    )


@pytest.mark.parametrize("batch", ["", "1,", "N,"], ids=["no batch", "batch of 1", "any batch"])
def test_inputs_are_told_apart_by_name_with_a_batch_axis_or_without(written, batch):
    file = written(ALL.replace("[", f"[{batch}"), FLAT + PICK)
    agent = make(f"onnx:{file}")
    agent.reset(ROBOT, 0)
    rng = np.random.default_rng(0)
    for _ in range(3):
        seen = observation(rng)
        expected = seen.lidar[3] + seen.velocity[1], seen.goal[1] * seen.pose[2]
        np.testing.assert_array_equal(agent.act(seen), np.array(expected, np.float32))


@pytest.mark.parametrize(
    ("output", "body"),
    [
        ("float[2] action", STILL),
        ("float[1,2] action", STILL.replace("[2]", "[1,2]")),
        ("float[N,M] action", STILL.replace("[2]", "[1,2]")),
        ("float[1] value, float[2] action", STILL + "\nvalue = Constant<value = float[1] {9}>()"),
    ],
)
def test_the_action_is_two_numbers_with_a_batch_axis_or_without(written, output, body):
    agent = make(f"onnx:{written('float[2] goal', body, output)}")
    agent.reset(ROBOT, 0)
    np.testing.assert_array_equal(agent.act(observation(np.random.default_rng(0))), [0.5, 0.25])


def test_the_map_is_that_of_the_scans_since_the_reset(written):
    agent = make(f"onnx:{written('uint8[1,16,16] map', COUNT, perception=EXTENT)}")
    rng = np.random.default_rng(0)
    for _ in range(2):
        agent.reset(ROBOT, 0)
        geometry = crowdbench.MapGeometry(cells=16, size=4.0, ahead=3.0)
        maps = crowdbench.ObstacleMap(ROBOT, geometry)
        for _ in range(3):
            seen = observation(rng)
            count = maps.update(seen.lidar, seen.pose).astype(float).sum()
            np.testing.assert_allclose(agent.act(seen), [0.001 * count, 0.0], rtol=1e-6)
            assert count > 40


def test_an_episode_is_driven_by_it_the_same_each_time(written):
    file = written(
        "float[2] goal", "w = Constant<value = float[2] {0.5, 1}>() action = Mul(goal, w)"
    )
    runs = [run_episode("unimodal_slow", f"onnx:{file}", 1_000_000)[0] for _ in range(2)]
    assert runs[0].outcome != "agent_error"
    assert runs[0].agent == f"onnx:file={file}"
    np.testing.assert_array_equal(runs[0].commands, runs[1].commands)
    assert runs[0].commands[:, 1].std() > 0.01


def test_it_computes_in_the_thread_that_calls_it(written):
    file = written(ALL, FLAT + PICK)
    make(f"onnx:{file}")
    before = psutil.Process().num_threads()
    agent = make(f"onnx:{file}")
    agent.reset(ROBOT, 0)
    agent.act(observation(np.random.default_rng(0)))
    assert psutil.Process().num_threads() == before


def test_its_hash_is_that_of_the_file(written):
    first = make(f"onnx:{written('float[2] goal')}").weights_sha256
    second = make(f"onnx:{written('float[2] goal', STILL.replace('0.25', '0.26'))}").weights_sha256
    assert len(first) == len(second) == 64
    assert first != second


@pytest.mark.parametrize(
    ("inputs", "told"),
    [
        ("float[2] speed", "input 'speed' is no part of an observation; allowed: lidar, velocity, "
         "goal, pose, map"),
        ("float[3] goal", "input 'goal' is 'tensor(float)' of shape (3,); allowed: tensor(float) "
         "of shape (2,) or (1, 2)"),
        ("float[4,2] goal", "input 'goal' is 'tensor(float)' of shape (4, 2); allowed"),
        ("float[1,1,180] lidar", "input 'lidar' is 'tensor(float)' of shape (1, 1, 180); allowed: "
         "tensor(float) of shape (beams,) or (1, beams)"),
        ("float lidar", "input 'lidar' is 'tensor(float)' of shape (); allowed"),
        ("double[2] goal", "input 'goal' is 'tensor(double)' of shape (2,); allowed"),
        ("float[16,16] map", "input 'map' is 'tensor(float)' of shape (16, 16); allowed: "
         "tensor(uint8) of shape (cells, cells) or (1, cells, cells)"),
        ("uint8[16,16] map", "input 'map' needs the metadata 'crowdbench.perception', a JSON "
         "object with cells, size [m] and ahead [m]"),
    ],
)  # fmt: skip
def test_other_inputs_are_refused_with_what_is_allowed(written, inputs, told):
    file = written(inputs)
    assert f"{file}: {told}" in refusal(f"onnx:{file}")


@pytest.mark.parametrize(
    ("output", "body", "told"),
    [
        ("float[2] actions", STILL.replace("action", "actions"),
         "expected an output 'action', found 'actions'"),
        ("float[3] action", "action = Constant<value = float[3] {1, 2, 3}>()",
         "output 'action' is 'tensor(float)' of shape (3,); allowed: tensor(float) of shape (2,) "
         "or (1, 2)"),
        ("int64[2] action", "action = Constant<value = int64[2] {1, 2}>()",
         "output 'action' is 'tensor(int64)' of shape (2,)"),
    ],
)  # fmt: skip
def test_other_outputs_are_refused_with_what_is_allowed(written, output, body, told):
    file = written("float[2] goal", body, output)
    assert f"{file}: {told}" in refusal(f"onnx:{file}")


@pytest.mark.parametrize(
    ("metadata", "told"),
    [
        ({"perception": EXTENT.replace("16", "32")}, "input 'map' has (16, 16) cells, but the "
         "metadata 'crowdbench.perception' says 32"),
        ({"perception": EXTENT.replace("4.0", "-4.0")}, "metadata 'crowdbench.perception': size: "
         "-4.0 is out of range; allowed: > 0"),
        ({"perception": "{"}, "metadata 'crowdbench.perception': "),
        ({"perception": EXTENT, "robot": '{"wheels": 3}'}, "metadata 'crowdbench.robot': unknown "
         "key 'wheels'"),
    ],
)  # fmt: skip
def test_unusable_metadata_is_refused(written, metadata, told):
    file = written("uint8[16,16] map", COUNT, **metadata)
    assert f"{file}: {told}" in refusal(f"onnx:{file}")


def test_files_that_are_no_onnx_models_are_refused(written):
    assert "ONNX file 'none.onnx': No such file or directory" in refusal("onnx:none.onnx")
    assert "ONNX file '.': Is a directory" in refusal("onnx:file=.")
    assert "agent 'onnx' needs the option 'file'" in refusal("onnx")
    assert "file: expected the name of an ONNX file, got 3" in refusal("onnx:file=3")
    for content in (b"", b"text " * 100, Path(written("float[2] goal")).read_bytes()[:40]):
        Path("broken.onnx").write_bytes(content)
        assert "broken.onnx: not a" in refusal("onnx:broken.onnx")


def test_weights_may_lie_in_a_file_beside_it(written):
    """As PyTorch's exporter writes them; the hash is of both."""
    Path("folder").mkdir()
    hashes, contents = set(), set()
    for factor in (0.25, 0.5):
        file = written("float[2] goal", "action = Mul(goal, w)", name="folder/policy.onnx")
        model = onnx.load(file)
        weights = onnx.numpy_helper.from_array(np.full(2, factor, np.float32), "w")
        model.graph.initializer.append(weights)
        Path("folder/policy.data").unlink(missing_ok=True)
        convert_model_to_external_data(model, location="policy.data", size_threshold=0)
        onnx.save(model, file)
        agent = make(f"onnx:{file}")
        agent.reset(ROBOT, 0)
        seen = observation(np.random.default_rng(0))
        np.testing.assert_array_equal(agent.act(seen), factor * seen.goal)
        hashes.add(agent.weights_sha256)
        contents.add(Path(file).read_bytes())
    assert (len(hashes), len(contents)) == (2, 1)
    Path("folder/policy.data").unlink()
    assert "folder/policy.onnx: not an ONNX model (" in refusal(f"onnx:{file}")


@pytest.mark.parametrize("library", ["onnx", "onnxruntime"])
def test_without_its_libraries_it_says_what_to_install(written, monkeypatch, library):
    file = written("float[2] goal")
    monkeypatch.setitem(sys.modules, library, None)
    told = f"{library} is not installed: pip install 'crowdbench-nav[onnx]'"
    assert told in refusal(f"onnx:{file}")


def test_a_robot_with_another_number_of_beams_is_refused_at_its_reset(written):
    agent = make(f"onnx:{written('float[1,90] lidar')}")
    with pytest.raises(ValueError, match="'lidar' takes 90 beams, and the robot has 180"):
        agent.reset(ROBOT, 0)
    make(f"onnx:{written('float[1,B] lidar')}").reset(ROBOT, 0)


def test_the_robot_in_the_metadata_is_the_one_to_drive(written):
    plain = make(f"onnx:{written('float[2] goal')}")
    assert plain.drives is None
    slow = written("float[2] goal", robot='{"speed": [0.0, 0.5]}')
    agent = make(f"onnx:{slow}")
    assert agent.drives == ("differential",)
    with pytest.warns(UserWarning, match=r"the policy in policy.onnx .* speed 0 to 1 m/s \(in"):
        agent.reset(ROBOT, 0)
