"""With the fused evaluator the planner makes the plans it makes with the plain one."""

import pytest
import torch
from crowdbench_agents.latent_planner import fused
from crowdbench_agents.latent_planner.fused import FusedEvaluator
from crowdbench_agents.latent_planner.mppi import plan
from crowdbench_agents.latent_planner.plain import PlainEvaluator
from crowdbench_agents.latent_planner.scoring import Scoring
from crowdbench_agents.latent_planner.world_model import WorldModel
from crowdbench_agents.learning.config import Config, load_config

SMALL = {
    "perception.cells": 16, "model.latent": 32, "model.hidden": 24, "model.dynamics_hidden": 40,
    "planner.iterations": 3, "planner.candidates": 60, "planner.elites": 8,
    "planner.policy_share": 0.2,
}  # fmt: skip
HALF = torch.tensor([0.5, 1.5])


def random_model(config):
    torch.manual_seed(0)
    model = WorldModel(config.model, config.perception.cells).eval().requires_grad_(False)
    for parameter in model.parameters():  # no layer left at zero, no norm at one
        parameter.add_(0.1 * torch.randn_like(parameter))
    return model


def both(config, threads=1, score="reward_q", warm=False, seed=5):
    """Plans of both evaluators with equal noise."""
    model = random_model(config)
    g = torch.Generator().manual_seed(1)
    count = 2 if config.planner.reflect else 1
    views = model.normalise(torch.randn(count, 1, config.model.latent, generator=g))
    previous = torch.rand(1, 2, generator=g)
    start = torch.rand(1, config.planner.horizon, 2, generator=g) - 0.5 if warm else None
    arguments = views, previous, config.planner, 0.97, HALF
    return [
        plan(evaluator, *arguments, torch.Generator().manual_seed(seed), start, score)
        for evaluator in (PlainEvaluator(model), FusedEvaluator(model, threads))
    ]


def assert_equal_plans(plain, quick):
    for expected, actual in zip(plain, quick, strict=True):
        torch.testing.assert_close(actual, expected, atol=2e-5, rtol=2e-5)


@pytest.mark.parametrize("score", ["reward_q", "reward", "q"])
@pytest.mark.parametrize("horizon", [1, 3, 10])
@pytest.mark.parametrize("values", ["final", "mean", "lambda"])
def test_plans_are_equal_for_every_score_and_horizon(score, horizon, values):
    changes = {"planner.horizon": horizon, "planner.values": values, "planner.return_lambda": 0.6}
    config = load_config().override(SMALL | changes)
    assert_equal_plans(*both(config, score=score, warm=True))


@pytest.mark.parametrize("dynamics", ["plain", "residual"])
@pytest.mark.parametrize("norm", ["none", "layer", "simplex"])
def test_plans_are_equal_for_every_form_of_the_model(dynamics, norm):
    changes = {"model.dynamics": dynamics, "model.latent_norm": norm}
    assert_equal_plans(*both(Config().override(SMALL | changes)))


@pytest.mark.parametrize("start", ["previous", "policy"])
@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
def test_plans_are_equal_for_every_share_of_the_policys_candidates(share, start):
    changes = {"planner.policy_share": share, "planner.start": start}
    assert_equal_plans(*both(load_config().override(SMALL | changes), warm=True))


@pytest.mark.parametrize("grid", [None, (2, 2), (5, 9)])
@pytest.mark.parametrize("share", [0.0, 0.2])
def test_plans_are_equal_with_and_without_constant_actions(grid, share):
    changes = {
        "planner.constant_actions": grid,
        "planner.policy_share": share,
        "planner.values": "lambda",
    }
    assert_equal_plans(*both(load_config().override(SMALL | changes), warm=True))


@pytest.mark.parametrize("candidates", [1, 2, 60])
@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
def test_plans_are_equal_from_two_views(share, candidates):
    changes = {
        "planner.reflect": True, "planner.policy_share": share, "planner.candidates": candidates,
        "planner.start": "policy",
    }  # fmt: skip
    assert_equal_plans(*both(load_config().override(SMALL | changes), warm=True))


def test_plans_are_equal_at_the_full_budget():
    full = {"planner.candidates": 512, "planner.iterations": 6, "planner.elites": 64}
    assert_equal_plans(*both(load_config().override(full)))


def test_plans_are_equal_without_onednn(monkeypatch):
    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: False)
    assert_equal_plans(*both(load_config().override(SMALL)))


def test_the_plan_does_not_depend_on_the_number_of_threads(monkeypatch):
    monkeypatch.setattr(fused, "BLOCK", 16)
    config = load_config().override(SMALL)
    before = torch.get_num_threads()
    (plain, one), (_, three) = both(config, threads=1), both(config, threads=3)
    assert_equal_plans(plain, three)
    assert all(torch.equal(a, b) for a, b in zip(one, three, strict=True))
    assert torch.get_num_threads() == before


def test_returns_of_candidates_keep_their_order_over_blocks(monkeypatch):
    config = load_config().override(SMALL)
    model = random_model(config)
    z = model.normalise(torch.ones(1, 32).cumsum(dim=1))
    candidates = torch.rand(1, 50, 4, 2, generator=torch.Generator().manual_seed(3)) * 2 - 1

    scoring = Scoring(config.planner, 0.9)

    def returns(evaluator):
        return evaluator.view(z, torch.ones(2), scoring).returns(candidates)

    whole = returns(FusedEvaluator(model))
    torch.testing.assert_close(whole, returns(PlainEvaluator(model)), atol=2e-5, rtol=2e-5)
    monkeypatch.setattr(fused, "BLOCK", 7)
    torch.testing.assert_close(returns(FusedEvaluator(model, 2)), whole)
    assert whole.std() > 1e-3
