"""The latent planner and its TD-MPC-style relative as agents."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from crowdbench_agents.latent_planner import mppi
from crowdbench_agents.latent_planner.agent import LatentPlanner
from crowdbench_agents.latent_planner.mppi import Plan
from crowdbench_agents.latent_planner.world_model import FORMAT, WorldModel, load_world_model
from crowdbench_agents.learning.config import load_config
from crowdbench_agents.learning.inputs import Inputs, reflect
from crowdbench_agents.learning.weights import file_digest, save_weights
from crowdbench_agents.tdmpc.agent import Tdmpc

import crowdbench

SMALL = {
    "perception.cells": 16, "model.latent": 32, "model.hidden": 24, "model.dynamics_hidden": 40,
    "planner.smoothness_weight": 0.3, "planner.policy_share": 0.2, "planner.candidates": 120,
    "planner.elites": 12, "planner.reflect": True,
}  # fmt: skip
BUDGET = {"iterations": 2, "candidates": 20, "elites": 5}
ROBOT = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario("multimodal_fast"))


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A small model with random parameters, none of them zero."""
    config = load_config().override(SMALL)
    torch.manual_seed(0)
    model = WorldModel(config.model, config.perception.cells)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    path = tmp_path_factory.mktemp("weights") / "small.safetensors"
    save_weights(path, model.state_dict(), config, {}, FORMAT)
    return str(path)


def observations(count, seed=0):
    """What a robot might see that drives among random obstacles."""
    rng = np.random.default_rng(seed)
    pose = np.zeros(3)
    for _ in range(count):
        velocity = rng.uniform([0, -1.5], [1, 1.5])
        pose = pose + 0.2 * np.array([velocity[0], 0, velocity[1]])
        yield crowdbench.Observation(
            lidar=rng.uniform(0.5, 6.0, 180).astype(np.float32),
            velocity=velocity.astype(np.float32),
            goal=rng.uniform(-4, 4, 2).astype(np.float32),
            pose=pose.astype(np.float32),
        )


def drive(agent, steps, seed=0):
    agent.reset(ROBOT, seed)
    return np.array([agent.act(observation) for observation in observations(steps)])


class Script:
    """Stands in for the planner: plan n is filled with the numbers n + t / 100."""

    def __init__(self):
        self.calls = []

    def __call__(self, evaluator, views, previous, settings, *others, warm_start, score):
        self.calls.append((views, previous, warm_start))
        numbers = len(self.calls) * 0.1 + torch.arange(settings.horizon) / 100
        actions = numbers[None, :, None].expand(1, -1, 2)
        return Plan(actions, actions, torch.zeros(1))


@pytest.fixture
def script(monkeypatch):
    script = Script()
    monkeypatch.setattr(mppi, "plan", script)
    return script


def ready(weights, horizon, execute):
    agent = LatentPlanner(weights=weights, horizon=horizon, execute=execute, **BUDGET)
    agent.reset(ROBOT, 0)
    return agent


@pytest.mark.parametrize("execute", [1, 2, 4])
def test_the_first_actions_of_each_plan_are_executed_in_order(weights, script, execute):
    agent = ready(weights, horizon=4, execute=execute)
    actions = np.array([agent.act(observation) for observation in observations(8)])
    expected = [(1 + step // execute) * 0.1 + (step % execute) / 100 for step in range(8)]
    np.testing.assert_allclose(actions[:, 0], np.array(expected) / 2 + 0.5, atol=1e-6)
    np.testing.assert_allclose(actions[:, 1], np.array(expected) * 1.5, atol=1e-6)
    assert agent.diagnostics() == {"plans": 8 / execute}


@pytest.mark.parametrize(
    ("execute", "expected"),
    [(1, [0.11, 0.12, 0.13, 0.13]), (2, [0.12, 0.13, 0.13, 0.13]), (4, [0.13] * 4)],
)
def test_the_search_starts_from_the_part_of_the_last_plan_that_is_left(
    weights, script, execute, expected
):
    agent = ready(weights, horizon=4, execute=execute)
    for observation in observations(execute + 1):
        agent.act(observation)
    (_, _, first), (_, _, second) = script.calls
    assert not first.any()
    np.testing.assert_allclose(second[0, :, 0], expected, atol=1e-6)


def test_plans_are_made_from_the_stacked_map_and_the_present_velocity(weights, script):
    agent = ready(weights, horizon=3, execute=3)
    model, config, _ = load_world_model(weights)
    seen = list(observations(10))
    for observation in seen:
        agent.act(observation)
    # The fourth plan is made at step 9: scans of steps 2 to 9 are in the map, planned or not.
    maps = crowdbench.ObstacleMap(ROBOT, config.perception.geometry)
    for observation in seen[2:]:
        drawn = maps.update(observation.lidar, observation.pose)
    last = seen[-1]
    other_way = np.float32([1, -1])
    views, previous, _ = script.calls[-1]
    for view, arrays in zip(
        views,
        [
            (drawn, last.velocity, last.goal),
            (reflect(drawn), last.velocity * other_way, last.goal * other_way),
        ],
        strict=True,
    ):
        inputs = Inputs(*(torch.from_numpy(array[None]) for array in arrays))
        torch.testing.assert_close(view, model.encode(inputs))
    np.testing.assert_allclose(previous[0], [2 * last.velocity[0] - 1, last.velocity[1] / 1.5])


def test_all_eight_scans_are_drawn_where_things_really_are():
    env = crowdbench.parallel_env("corridor_very_dense", **{"pedestrians.count": 0})
    observed, _ = env.reset(seed=900_000)
    maps = crowdbench.ObstacleMap(ROBOT)
    geometry, rng = maps.geometry, np.random.default_rng(0)
    for step in range(20):
        seen = observed["robot_0"]
        bits = maps.update(seen["lidar"], seen["pose"])
        state = env.state()
        x, y, heading = state["robot_pose"][0]
        ahead, left = ((np.argwhere(bits) + 0.5) * geometry.cell + geometry.origin).T
        px = x + np.cos(heading) * ahead - np.sin(heading) * left
        py = y + np.sin(heading) * ahead + np.cos(heading) * left
        round_things = [abs(np.hypot(px - a, py - b) - r) for a, b, r in state["obstacles"]]
        walls = [abs(py - wall[1]) for wall in state["walls"]]  # along x
        assert np.min(round_things + walls, axis=0).max() <= geometry.cell
        if step >= 8:
            assert all((bits & (1 << age)).any() for age in range(8))
        action = np.array([0.4, rng.uniform(-1.5, 1.5)], np.float32)
        observed, *_ = env.step({"robot_0": action})


def test_reset_forgets_the_plan_and_the_scans(weights):
    agent = LatentPlanner(weights=weights, horizon=3, execute=3, **BUDGET)
    first = drive(agent, 4)
    assert np.array_equal(drive(agent, 4), first)


def test_actions_follow_from_the_seed_and_nothing_else(weights):
    agent = LatentPlanner(weights=weights, **BUDGET)
    first = drive(agent, 3, seed=7)
    torch.manual_seed(99)
    np.random.seed(99)  # noqa: NPY002 - to see that it has no effect
    state = torch.get_rng_state()
    assert np.array_equal(drive(LatentPlanner(weights=weights, **BUDGET), 3, seed=7), first)
    assert torch.equal(torch.get_rng_state(), state)
    assert not np.array_equal(drive(agent, 3, seed=8), first)


def test_policy_alone_is_the_worlds_models_policy(weights):
    agent = LatentPlanner(weights=weights, use_mppi=False)
    agent.reset(ROBOT, 0)
    model, config, _ = load_world_model(weights)
    maps = crowdbench.ObstacleMap(ROBOT, config.perception.geometry)
    for seen in observations(3):
        drawn = maps.update(seen.lidar, seen.pose)
        arrays = (drawn, seen.velocity, seen.goal)
        z = model.encode(Inputs(*(torch.from_numpy(array[None]) for array in arrays)))
        expected = agent._bounds.physical(model.act(z)[0].numpy())
        np.testing.assert_allclose(agent.act(seen), expected, atol=1e-6)


def test_policy_executed_open_loop_goes_through_the_model(weights):
    agent = LatentPlanner(weights=weights, use_mppi=False, execute=2)
    agent.reset(ROBOT, 0)
    first, second = observations(2)
    agent.act(first)
    action = agent.act(second)
    model, config, _ = load_world_model(weights)
    drawn = crowdbench.ObstacleMap(ROBOT, config.perception.geometry)
    arrays = (drawn.update(first.lidar, first.pose), first.velocity, first.goal)
    z = model.encode(Inputs(*(torch.from_numpy(array[None]) for array in arrays)))
    expected = model.act(model.next(z, model.act(z)))[0].numpy()
    np.testing.assert_allclose(action, agent._bounds.physical(expected), atol=1e-6)


ROWS_OF_THE_PAPER = [
    *[f"horizon={h},execute={e}" for h in (3, 6, 10) for e in (1, h)],
    "use_mppi=false",
    "policy_prior=false",
    "smoothness_weight=0",
    "smoothness_weight=0,execute=6",
    "score=reward",
    "score=q",
]


@pytest.mark.parametrize("row", ROWS_OF_THE_PAPER)
def test_every_row_of_the_papers_tables_can_be_run(weights, row):
    spec = crowdbench.AgentSpec.parse(
        f"latent_planner:{row},weights={weights},iterations=2,candidates=20,elites=5"
    )
    agent = spec.make()
    actions = drive(agent, 12)
    assert np.all((actions >= [0, -1.5]) & (actions <= [1, 1.5]))
    plans = np.ceil(12 / spec.options.get("execute", 1))
    assert agent.diagnostics() == {"plans": plans}
    assert len(np.unique(actions[:, 1])) > plans / 2


def test_an_action_beyond_its_bounds_by_rounding_is_brought_back(weights, monkeypatch):
    beyond = np.float32([1.0000001, -1.0000001])
    assert np.all(np.abs(beyond) > 1)
    monkeypatch.setattr(LatentPlanner, "_choose", lambda agent, inputs: beyond)
    assert drive(LatentPlanner(weights=weights), 1).tolist() == [[1.0, -1.5]]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, (0.3, 0.2)),
        ({"smoothness_weight": 0}, (0.0, 0.2)),
        ({"policy_prior": False}, (0.3, 0.0)),
        ({"values": "final"}, (0.3, 0.2)),
        ({"constant_actions": False}, (0.3, 0.2)),
        ({"reflect": False}, (0.3, 0.2)),
    ],
)
def test_what_options_leave_open_is_taken_from_the_weights(weights, options, expected):
    agent = LatentPlanner(weights=weights, **options)
    agent.reset(ROBOT, 0)
    assert (agent._settings.smoothness_weight, agent._settings.policy_share) == expected
    # not those of config.yaml
    assert (agent._settings.candidates, agent._settings.elites) == (120, 12)
    assert agent._settings.values == options.get("values", "lambda")
    assert agent._settings.constant_actions == (
        (5, 9) if options.get("constant_actions", True) else None
    )
    assert agent._settings.reflect == options.get("reflect", True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("horizon=0", "horizon: input should be greater than or equal to 1, got 0"),
        ("horizon=6.5", "horizon: input should be a valid integer, got 6.5"),
        ("execute=7", r"execute: should be 1 to horizon \(6\), got 7"),
        ("horizon=3,execute=6", r"execute: should be 1 to horizon \(3\), got 6"),
        ("smoothness_weight=-1", "smoothness_weight: input should be greater than or equal to 0"),
        ("policy_prior=1", "policy_prior: input should be a valid boolean, got 1"),
        ("score=both", "score: input should be 'reward_q', 'reward' or 'q', got 'both'"),
        ("candidates=32,elites=64", r"elites: should be 1 to candidates \(32\), got 64"),
        ("values=best", "values: input should be 'final', 'mean' or 'lambda', got 'best'"),
        ("reflect=2", "reflect: input should be a valid boolean, got 2"),
        ("constant_actions=5", "constant_actions: input should be a valid boolean, got 5"),
        ("threads=0", "threads: input should be greater than or equal to 1"),
        ("iterations=none", "iterations: input should be a valid integer, got 'none'"),
        ("horzon=3", "no option 'horzon'.*horizon"),
        ("weights=3", "weights: expected a name or path, got 3"),
        ("weights=missing.safetensors", "there is no file 'missing.safetensors'"),
        ("weights=unheard_of", "no weights 'unheard_of'.*`crowdbench train latent_planner`"),
    ],
)
def test_options_that_cannot_be_are_refused_by_name(options, message):
    with pytest.raises(ValueError, match=message):
        crowdbench.AgentSpec.parse(f"latent_planner:{options}").make()


def test_weights_are_identified_when_the_agent_is_made(weights):
    assert LatentPlanner(weights=weights).weights_sha256 == file_digest(Path(weights))


def test_weights_that_break_are_refused_before_anything_runs(weights, tmp_path):
    path = tmp_path / "copy.safetensors"
    content = bytearray(Path(weights).read_bytes())
    content[-100] ^= 1
    path.write_bytes(content)
    with pytest.raises(crowdbench.AgentError, match=r"copy\.safetensors are damaged: their hash"):
        crowdbench.AgentSpec.parse(f"latent_planner:weights={path}").make()


def test_an_agent_drives_by_the_weights_that_it_was_made_with(weights, tmp_path):
    path = tmp_path / "copy.safetensors"
    path.write_bytes(Path(weights).read_bytes())
    agent = LatentPlanner(weights=str(path), **BUDGET)
    path.write_bytes(b"other weights")
    expected = drive(LatentPlanner(weights=weights, **BUDGET), 2)
    assert np.array_equal(drive(agent, 2), expected)
    assert agent.weights_sha256 == file_digest(Path(weights))


@pytest.mark.parametrize("name", ["x" * 5000, "x" * 5000 + ".safetensors", "../weights/social", ""])
def test_weights_that_are_nowhere_are_told_in_a_short_line(name):
    with pytest.raises(ValueError, match=r"no weights|there is no file") as caught:
        LatentPlanner(weights=name)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("content", [b"", b"no weights at all"])
def test_a_file_without_weights_is_refused_before_anything_runs(content, tmp_path):
    path = tmp_path / "w.safetensors"
    path.write_bytes(content)
    for agent in ("latent_planner", "sac", "tdmpc"):
        with pytest.raises(crowdbench.AgentError, match=r"w\.safetensors are damaged"):
            crowdbench.AgentSpec.parse(f"{agent}:weights={path}").make()


def test_tdmpc_is_the_same_code_with_weights_of_its_own(weights):
    options = dict(weights=weights, **BUDGET)
    np.testing.assert_array_equal(drive(Tdmpc(**options), 3), drive(LatentPlanner(**options), 3))
    assert Tdmpc.folder != LatentPlanner.folder
    with pytest.raises(ValueError, match=re.escape("train with `crowdbench train tdmpc`")):
        crowdbench.AgentSpec.parse("tdmpc:weights=nothing").make()


def test_pytorch_is_not_imported_with_the_agents_module():
    code = (
        "import sys, crowdbench_agents.latent_planner.agent, crowdbench_agents.tdmpc.agent, "
        "crowdbench_agents.sac.agent; sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
