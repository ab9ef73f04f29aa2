"""The world model's networks, configuration and weights files."""

import json

import numpy as np
import pytest
import torch
from crowdbench_agents.latent_planner.world_model import FORMAT, WorldModel, load_world_model
from crowdbench_agents.learning.config import Config, ConfigError, load_config
from crowdbench_agents.learning.inputs import ActionBounds, Inputs
from crowdbench_agents.learning.weights import WeightsError, save_weights
from safetensors import safe_open
from safetensors.torch import save_file

import crowdbench


@pytest.fixture(params=["coarse", "fine"])
def config(request):
    return load_config().override({"model.encoder": request.param})


@pytest.fixture
def model(config):
    torch.manual_seed(0)
    return WorldModel(config.model, cells=48)


@pytest.fixture
def inputs():
    generator = torch.Generator().manual_seed(1)
    return Inputs(
        torch.randint(0, 256, (3, 5, 48, 48), dtype=torch.uint8, generator=generator),
        torch.rand(3, 5, 2, generator=generator),
        torch.randn(3, 5, 2, generator=generator),
    )


def test_shapes_follow_the_leading_dimensions(model, inputs):
    z = model.encode(inputs)
    action = torch.zeros(3, 5, 2)
    assert z.shape == (3, 5, 256)
    assert model.next(z, action).shape == (3, 5, 256)
    assert model.q(z, action).shape == (2, 3, 5)
    assert all(x.shape == (3, 5) for x in model.reward_and_end(z, action))
    assert model.act(z).shape == (3, 5, 2)


def test_q_along_an_action_is_q(model, inputs):
    for network in model.q_networks:  # which start as the constant 0
        torch.nn.init.normal_(network[-1].weight)
    z, action = model.encode(inputs).detach(), inputs.velocity.clone().requires_grad_()
    found, expected = model.q_along_action(z, action), model.q(z, action)
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-5)
    slope = torch.tensor([1.0, -2.0]).view(2, 1, 1)
    torch.testing.assert_close(
        *(torch.autograd.grad(q, action, slope.expand_as(q))[0] for q in (found, expected)),
        atol=1e-4, rtol=1e-4,
    )  # fmt: skip


def test_residual_dynamics_start_as_the_identity(model, inputs):
    z = model.encode(inputs)
    # not exactly: the normalisation adds a small constant to the variance
    torch.testing.assert_close(model.next(z, torch.ones(3, 5, 2)), z, atol=0.03, rtol=0.01)


def test_encoder_sees_each_of_the_eight_frames(model):
    empty = torch.zeros(1, 48, 48, dtype=torch.uint8)
    still = torch.zeros(1, 2)
    codes = [model.encode(Inputs(empty, still, still + 1))]
    for bit in range(8):
        one = empty.clone()
        one[0, 20:28, 20:28] = 1 << bit
        codes.append(model.encode(Inputs(one, still, still + 1)))
    distances = torch.cdist(torch.cat(codes), torch.cat(codes))
    assert distances[~torch.eye(9, dtype=torch.bool)].min() > 1e-3


def test_the_fine_encoder_is_a_3d_network_whose_first_kernels_span_all_frames(inputs):
    encoder = WorldModel(Config().override({"model.encoder": "fine"}).model, cells=48).encoder
    maps = inputs.map[0]
    frames = np.unpackbits(maps.numpy()[:, None], axis=1, bitorder="little")
    x = torch.from_numpy(frames).float()[:, None]  # (B, 1, 8, 48, 48)
    for number, layer in enumerate(layer for layer in encoder.f_map if hasattr(layer, "weight")):
        kernel = layer.weight[:, None] if number == 0 else layer.weight[:, :, None]
        stride, padding = (1, *layer.stride), (0, *layer.padding)
        x = torch.nn.functional.conv3d(x, kernel, layer.bias, stride, padding)
        x = torch.nn.functional.silu(x)
    goal = inputs.goal[0]
    distance = goal.norm(dim=-1, keepdim=True)
    features = torch.cat([goal / 5, distance / 5, goal / distance], dim=-1)
    parts = [x.flatten(1), encoder.f_vel(inputs.velocity[0]), encoder.f_goal(features)]
    expected = encoder.fuse(torch.cat(parts, dim=-1))
    found = encoder(Inputs(*(x[0] for x in inputs)))
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)


def test_log_probability_of_the_policy_equals_the_change_of_variables(model, inputs):
    z = model.encode(inputs)
    noise = torch.randn(3, 5, 2, generator=torch.Generator().manual_seed(2))
    action, log_prob = model.sample(z, noise)
    mean, log_std = model.policy(z)
    distribution = torch.distributions.TransformedDistribution(
        torch.distributions.Normal(mean, log_std.exp()),
        torch.distributions.TanhTransform(cache_size=1),
    )
    expected = distribution.log_prob(action).sum(-1)
    torch.testing.assert_close(log_prob, expected, atol=2e-3, rtol=1e-3)


def test_simplex_latents_are_groups_of_probabilities(inputs):
    config = Config().override({"model.latent_norm": "simplex"})
    z = WorldModel(config.model, cells=48).encode(inputs)
    torch.testing.assert_close(z.unflatten(-1, (-1, 8)).sum(-1), torch.ones(3, 5, 32))


def test_action_bounds_map_the_unit_square_onto_the_robot():
    robot = crowdbench.RobotSpec.from_scenario(
        crowdbench.Scenario(name="x", robots={"speed": (-0.5, 1.0), "turn_rate": (-1.5, 1.5)})
    )
    bounds = ActionBounds.of(robot)
    np.testing.assert_allclose(bounds.physical(np.array([[-1, 1], [1, 0]])), [[-0.5, 1.5], [1, 0]])
    random = np.random.default_rng(0).uniform(-1, 1, (9, 2))
    np.testing.assert_allclose(bounds.normalised(bounds.physical(random)), random, atol=1e-6)


def contiguous(model):
    return {name: tensor.contiguous() for name, tensor in model.state_dict().items()}


def test_weights_survive_the_round_trip(model, config, inputs, tmp_path):
    save_weights(tmp_path / "w.safetensors", model.state_dict(), config, {"seed": 1}, FORMAT)
    loaded, loaded_config, _ = load_world_model(tmp_path / "w.safetensors")
    assert loaded_config == config
    assert torch.equal(loaded.encode(inputs), model.eval().encode(inputs))


def test_damaged_weights_are_refused(model, config, tmp_path):
    path = tmp_path / "w.safetensors"
    save_weights(path, model.state_dict(), config, {}, FORMAT)
    content = bytearray(path.read_bytes())
    content[-100] ^= 1
    path.write_bytes(content)
    with pytest.raises(WeightsError, match=r"w\.safetensors are damaged: their hash"):
        load_world_model(path)
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(WeightsError, match="damaged"):
        load_world_model(path)


def test_weights_of_other_networks_are_refused(model, tmp_path):
    path = tmp_path / "w.safetensors"
    other = load_config().override({"model.latent": 128})
    save_weights(path, model.state_dict(), other, {}, FORMAT)
    with pytest.raises(WeightsError, match=r"do not fit .*tensor '[\w.]+' has shape .*, not .*"):
        load_world_model(path)
    save_weights(path, model.state_dict(), other, {}, "something-else")
    with pytest.raises(WeightsError, match="'something-else', expected"):
        load_world_model(path)
    with pytest.raises(WeightsError, match=r"none\.safetensors do not exist"):
        load_world_model(tmp_path / "none.safetensors")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda tensor: tensor.double(), "is of torch.float64, not torch.float32"),
        (lambda tensor: tensor[1:], r"has shape \(255,\), not \(256,\)"),
        (lambda tensor: tensor * float("nan"), "has values that are not finite"),
        (lambda tensor: tensor / 0, "has values that are not finite"),
        (lambda tensor: None, "is missing"),
    ],
)
@pytest.mark.parametrize("honest", [True, False], ids=["with their hash", "with another hash"])
def test_tensors_that_cannot_be_used_are_named(config, model, tmp_path, change, message, honest):
    path, name = tmp_path / "w.safetensors", "encoder.fuse.bias"
    tensors = contiguous(model)
    changed = change(torch.ones_like(tensors.pop(name)))
    tensors |= {} if changed is None else {name: changed}
    save_weights(path, tensors, config, {}, FORMAT)
    if not honest:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() | {"sha256": "0" * 64}
        save_file(tensors, path, metadata)
    with pytest.raises(
        WeightsError, match=rf"w\.safetensors .*tensor '{name}' {message}"
    ) as caught:
        load_world_model(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("config", "[1]", "'config' is missing or no JSON object"),
        ("config", "{", "unusable metadata"),
        ("config", "[" * 100_000, "unusable metadata"),
        ("config", '{"model": {"latent": -1}}', r"model\.latent: -1 is out of range"),
        ("config", '{"model": {"latent": 1000000000}}', "do not fit the networks: tensor"),
        ("config", '{"model": {"latent": 9' + "0" * 40 + "}}", "no network has the sizes"),
        ("training", "null", "'training' is missing or no JSON object"),
    ],
)
def test_metadata_that_cannot_be_used_are_told(config, model, tmp_path, key, value, message):
    path, tensors = tmp_path / "w.safetensors", contiguous(model)
    save_weights(path, tensors, config, {}, FORMAT)
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata() | {key: value}
    save_file(tensors, path, metadata)
    with pytest.raises(WeightsError, match=rf"w\.safetensors.*{message}") as caught:
        load_world_model(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


def test_tensors_of_somebody_else_are_refused(tmp_path):
    path = tmp_path / "w.safetensors"
    save_file({"layer.weight": torch.ones(3)}, path)
    with pytest.raises(WeightsError, match="of no format that is known, expected 'crowdbench-w"):
        load_world_model(path)


def test_the_papers_values_are_the_defaults():
    config = Config()
    planner, training = config.planner, config.training
    assert (planner.horizon, planner.iterations, planner.candidates, planner.elites) == (
        6,
        6,
        512,
        64,
    )
    assert (training.learning_rate_model, training.learning_rate) == (1e-4, 3e-4)
    assert (training.epsilon_start, training.epsilon_end, training.epsilon_decisions) == (
        0.5,
        0.05,
        25_000,
    )
    assert (config.model.latent, config.model.dynamics) == (256, "plain")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("planner: {horizont: 6}", "planner.horizont"),
        ("planner: {horizon: 0}", "planner.horizon: 0 is out of range; allowed: >= 1"),
        ("just words", "expected sections"),
        ("a: [", r"config\.yaml: not a YAML file \(line 1: "),
    ],
)
def test_bad_configuration_is_refused_by_name(tmp_path, text, message):
    path = tmp_path / "config.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_config(path)


def test_configuration_survives_json():
    config = load_config()
    assert Config.model_validate(json.loads(config.model_dump_json())) == config
