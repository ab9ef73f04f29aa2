"""MPPI against cases whose answer is known: by hand, or as the solution of a linear system."""

import numpy as np
import pytest
import torch
from crowdbench_agents.latent_planner.batched import BatchedEvaluator
from crowdbench_agents.latent_planner.mppi import (
    constant_actions,
    plan,
    refit,
    smoothness_penalty,
)
from crowdbench_agents.latent_planner.plain import PlainEvaluator, PlainView
from crowdbench_agents.latent_planner.scoring import Scoring
from crowdbench_agents.latent_planner.world_model import WorldModel
from crowdbench_agents.learning.config import Planner, load_config
from hypothesis import given
from hypothesis import settings as settings_of_hypothesis
from hypothesis import strategies as st

STEP, GAIN = 0.5, 20.0
HALF = torch.tensor([0.5, 1.5])
FLAT = torch.tensor([1.0, 1.0])


class LinearModel:
    """A point in the plane: z' = z + 0.5 a, R = -20 |z' - goal|^2, nothing ever ends."""

    def __init__(self, goal):
        self.goal = torch.tensor(goal)

    def next(self, z, action):
        return z + STEP * action

    def reward_and_end(self, z, action):
        reward = -GAIN * (self.next(z, action) - self.goal).square().sum(-1)
        return reward, torch.full_like(reward, -40.0)

    def act(self, z):
        return ((self.goal - z) / STEP).clamp(-1, 1)

    def sample(self, z, noise):
        action = self.act(z) + 0.1 * noise
        return action.clamp(-1, 1), torch.zeros(z.shape[:-1])

    def q(self, z, action):
        return torch.zeros(2, *z.shape[:-1])


class Ledger:
    """R is the action's first component, an end has probability 1/4, Q is 10 and 14 plus w."""

    def next(self, z, action):
        return z

    def reward_and_end(self, z, action):
        return action[..., 0], torch.full(action.shape[:-1], float(np.log(1 / 3)))

    def act(self, z):
        return torch.zeros(*z.shape[:-1], 2)

    def q(self, z, action):
        return torch.stack([10.0 + action[..., 1], 14.0 + action[..., 1]])


def settings(**changes):
    budget = {"horizon": 4, "iterations": 40, "candidates": 1000, "elites": 100}
    search = {"policy_share": 0.0, "temperature": 0.2, "min_std": 0.05, "smoothness_weight": 0.0}
    return Planner(**(budget | search | changes))


def solve(model, chosen, seed=0, score="reward", half=FLAT, previous=(0.0, 0.0), **options):
    generator = torch.Generator().manual_seed(seed)
    start, before = torch.zeros(1, 1, 2), torch.tensor(np.array([previous], np.float32))
    return plan(
        PlainEvaluator(model), start, before, chosen, 1.0, half, generator, score=score, **options
    )


def test_plan_of_a_linear_model_is_the_fastest_way_to_the_goal():
    # x needs 1.2 / 0.5 = 2.4 full steps, y 0.6 of one.
    result = solve(LinearModel([1.2, -0.3]), settings())
    expected = torch.tensor([[1, -0.6], [1, 0], [0.4, 0], [0, 0]])
    torch.testing.assert_close(result.actions[0], expected, atol=0.06, rtol=0)


@pytest.mark.parametrize("weight", [0.5, 5.0])
def test_plan_of_a_linear_model_with_smoothness_solves_the_quadratic_programme(weight):
    goal, previous, half = np.array([0.4, -0.5]), np.array([0.3, 0.2]), HALF.numpy()
    horizon = 4
    # min over a of GAIN sum |STEP (a_0 + .. + a_t) - goal|^2 + weight half^2 sum (a_t - a_{t-1})^2
    reach = STEP * np.tril(np.ones((horizon, horizon)))
    change = np.eye(horizon) - np.eye(horizon, k=-1)
    optimum = np.empty((horizon, 2))
    for k in range(2):
        rough = np.sqrt(weight) * half[k]
        rows = np.vstack([np.sqrt(GAIN) * reach, rough * change])
        before = np.zeros(horizon)
        before[0] = previous[k]
        target = np.concatenate([np.full(horizon, np.sqrt(GAIN) * goal[k]), rough * before])
        optimum[:, k] = np.linalg.lstsq(rows, target)[0]
    assert np.abs(optimum).max() < 1  # else the bounds would matter
    chosen = settings(smoothness_weight=weight)
    result = solve(LinearModel(goal.astype(np.float32)), chosen, half=HALF, previous=previous)
    np.testing.assert_allclose(result.actions[0], optimum, atol=0.06)


def test_guided_candidates_alone_give_the_policys_plan():
    goal = [1.2, -0.3]
    result = solve(LinearModel(goal), settings(policy_share=1.0, iterations=1, elites=1))
    expected = torch.tensor([[1, -0.6], [1, 0], [0.4, 0], [0, 0]])
    torch.testing.assert_close(result.actions[0], expected, atol=0.3, rtol=0)
    assert (result.actions[0] - expected).abs().max() > 1e-3  # the policy's noise is in it


def test_warm_start_is_where_the_search_begins():
    start = torch.tensor([[[0.9, -0.9]] * 4])
    narrow = settings(iterations=1, max_std=0.021)
    result = solve(LinearModel([0.0, 0.0]), narrow, warm_start=start)
    torch.testing.assert_close(result.actions, start, atol=0.05, rtol=0)


def test_with_start_policy_the_search_begins_at_the_policys_plan():
    narrow = settings(iterations=1, max_std=0.021, min_std=0.02, policy_share=0.01, start="policy")
    start = torch.tensor([[[0.9, -0.9]] * 4])
    result = solve(LinearModel([1.2, -0.3]), narrow, warm_start=start)
    expected = torch.tensor([[[1, -0.6], [1, 0], [0.4, 0], [0, 0]]])
    torch.testing.assert_close(result.actions, expected, atol=0.05, rtol=0)


def test_a_constant_action_far_from_everything_drawn_wins_if_it_scores_best():
    # noise of std 0.021 around no motion does not get anywhere near the best actions
    narrow = settings(iterations=1, max_std=0.021, elites=1, constant_actions=(3, 5))
    result = solve(LinearModel([2.0, -1.0]), narrow)
    torch.testing.assert_close(result.actions, torch.tensor([[[1.0, -0.5]] * 4]))


def test_constant_actions_cover_all_speeds_and_turn_rates_evenly():
    kept = constant_actions(settings(constant_actions=(3, 5)))
    assert kept.shape == (15, 4, 2)
    assert {tuple(x) for x in kept[:, 0].tolist()} == {
        (v, w) for v in (-1.0, 0.0, 1.0) for w in (-1.0, -0.5, 0.0, 0.5, 1.0)
    }
    torch.testing.assert_close(kept, kept[:, :1].expand_as(kept))
    assert len(constant_actions(settings())) == 0


@settings_of_hypothesis(max_examples=50, deadline=None)
@given(
    values=st.sampled_from(["final", "mean", "lambda"]),
    horizon=st.integers(1, 12),
    decay=st.floats(0, 1),
)
def test_shares_of_returns_add_up_to_one_so_that_scores_stay_returns(values, horizon, decay):
    chosen = settings(values=values, return_lambda=decay)
    shares = Scoring(chosen, 0.9).shares(horizon)
    assert len(shares) == horizon + 1
    assert sum(shares) == pytest.approx(1.0)


@pytest.mark.parametrize("score", ["reward_q", "q"])
def test_lambda_of_one_is_the_papers_score(score):
    candidates = torch.rand(1, 5, 4, 2, generator=torch.Generator().manual_seed(0))
    forms = settings(values="final"), settings(values="lambda", return_lambda=1.0)
    paper, ours = (
        PlainView(Ledger(), torch.zeros(1, 3), FLAT, Scoring(form, 0.9, score)).returns(candidates)
        for form in forms
    )
    torch.testing.assert_close(ours, paper)


def test_robots_of_a_batch_are_planned_for_their_own_state():
    model, chosen = PlainEvaluator(LinearModel([0.0, 0.0])), settings()
    z = torch.tensor([[0.4, 0.0], [-0.4, 0.2]])
    generator = torch.Generator().manual_seed(0)
    result = plan(
        model,
        z[None],
        torch.zeros(2, 2),
        chosen,
        1.0,
        FLAT,
        generator,
        score="reward",
    )
    torch.testing.assert_close(result.actions[:, 0], -z / STEP, atol=0.06, rtol=0)


def test_both_views_count_alike_each_for_its_own_side():
    # One view says that the goal is 0.1 ahead and 0.3 to the left, the other, a mirror, that it is
    # 0.3 ahead and 0.1 to the right. Nearest to both is 0.2 ahead and 0.2 to the left.
    model = PlainEvaluator(LinearModel([0.0, 0.0]))
    views = torch.tensor([[[-0.1, -0.3]], [[-0.3, 0.1]]])
    generator = torch.Generator().manual_seed(0)
    chosen = settings(horizon=1)
    result = plan(
        model,
        views,
        torch.zeros(1, 2),
        chosen,
        1.0,
        FLAT,
        generator,
        score="reward",
    )
    torch.testing.assert_close(result.actions[0, 0], torch.tensor([0.4, 0.4]), atol=0.02, rtol=0)
    # 20 x (0.1^2 + 0.1^2) from either
    torch.testing.assert_close(result.score, torch.tensor([-0.4]), atol=0.01, rtol=0)


def test_the_policy_proposes_in_each_view_what_is_turned_back():
    class OneSided(LinearModel):  # its policy knows what to do on one side only
        def act(self, z):
            return super().act(z) * (z[..., 1:] > 0)

    # The goal is 0.3 ahead and 0.2 to the left, in the mirror to the right.
    views = torch.tensor([[[-0.3, -0.2]], [[-0.3, 0.2]]])
    chosen = settings(
        horizon=1, iterations=1, policy_share=1.0, candidates=2, elites=1, start="policy"
    )

    def planned(views):
        generator, still = torch.Generator().manual_seed(0), torch.zeros(1, 2)
        model = PlainEvaluator(OneSided([0.0, 0.0]))
        return plan(model, views, still, chosen, 1.0, FLAT, generator, score="reward").actions[0]

    torch.testing.assert_close(planned(views), torch.tensor([[0.6, 0.4]]))
    assert planned(views[:1]).abs().max() < 0.35  # no motion, but for noise


def test_plan_is_a_function_of_the_generators_seed():
    model, chosen = LinearModel([1.2, -0.3]), settings(policy_share=0.1, iterations=2)
    first, again, other = (solve(model, chosen, seed).actions for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize(
    ("score", "values", "expected"),
    [
        # rewards 0.4 and -0.2, the second counts 0.9 x 3/4; the smaller Q, 10, (0.9 x 3/4)^2
        ("reward_q", "final", 0.4 - 0.2 * 0.675 + 10 * 0.675**2),
        ("reward", "final", 0.4 - 0.2 * 0.675),
        ("q", "final", 10.0),
        # behind the first step Q is that of the candidate's own action, w = 0.7
        ("reward_q", "mean", (0.4 + 10.7 * 0.675 + 0.4 - 0.2 * 0.675 + 10 * 0.675**2) / 2),
        ("reward", "mean", 0.4 - 0.2 * 0.675),
        ("q", "mean", (10.7 + 10) / 2),
        # before the first step Q is that of w = 0; lambda is 0.25
        (
            "reward_q", "lambda",
            0.75 * 10 + 0.1875 * (0.4 + 10.7 * 0.675)
            + 0.0625 * (0.4 - 0.2 * 0.675 + 10 * 0.675**2),
        ),
        ("reward", "lambda", 0.4 - 0.2 * 0.675),
        ("q", "lambda", 0.75 * 10 + 0.1875 * 10.7 + 0.0625 * 10),
    ],
)  # fmt: skip
def test_score_of_a_fixed_plan_by_hand(score, values, expected):
    candidates = torch.tensor([[[[0.4, 0.0], [-0.2, 0.7]]]])
    form = settings(values=values, return_lambda=0.25)
    view = PlainView(Ledger(), torch.zeros(1, 3), FLAT, Scoring(form, 0.9, score))
    torch.testing.assert_close(view.returns(candidates), torch.tensor([[expected]]))


@pytest.mark.parametrize(
    ("weight", "expected"),
    [
        # (1, 1) twice, the second reward counts 3/4
        (0.0, 1 + 0.75),
        # v changes by 0.4 m/s and w by 1.5 rad/s, once
        (0.1, 1.75 - 0.1 * (0.4**2 + 1.5**2)),
        # (0.4, 0.1) twice is smoother: 0.1 m/s and 0.15 rad/s
        (0.6, 0.4 * 1.75 - 0.6 * (0.1**2 + 0.15**2)),
    ],
)
def test_the_smoothness_penalty_is_taken_off_every_score(weight, expected):
    class Gentle(Ledger):
        def sample(self, z, noise):
            return torch.tensor([0.4, 0.1]).expand_as(noise), torch.zeros(z.shape[:-1])

    one = {"candidates": 1, "policy_share": 1.0, "elites": 1, "iterations": 1, "horizon": 2}
    chosen = settings(**one, constant_actions=(2, 2), smoothness_weight=weight)
    result = solve(Gentle(), chosen, half=HALF, previous=(0.2, 0.0))
    assert result.score.item() == pytest.approx(expected)


def test_smoothness_penalty_is_zero_only_for_what_goes_on_unchanged():
    previous = torch.tensor([[0.3, -0.7]])
    steady = previous[:, None, None].expand(1, 1, 5, 2)
    assert smoothness_penalty(steady, previous, HALF).item() == 0
    turned = steady.clone()
    turned[0, 0, 4, 1] += 0.2  # 0.3 rad/s in the last step
    torch.testing.assert_close(smoothness_penalty(turned, previous, HALF), torch.tensor([[0.09]]))


def test_elites_and_nobody_else_move_the_gaussian():
    candidates = torch.tensor([[[[0.0, 1.0]], [[0.6, 0.2]], [[0.2, -0.2]], [[-1.0, 0.0]]]])
    scores = torch.tensor([[-9.0, 2.0, 2.0 + float(np.log(3)), -5.0]])
    two = Planner(elites=2, temperature=1.0, min_std=0.1, max_std=0.18)
    result = refit(candidates, scores, two)
    # weights 1/4 and 3/4
    torch.testing.assert_close(result.actions, torch.tensor([[[0.3, -0.1]]]))
    # sqrt(1/4 0.3^2 + 3/4 0.1^2) = 0.173 in both; the limits cut nothing
    torch.testing.assert_close(result.std, torch.full((1, 1, 2), 0.03**0.5))
    torch.testing.assert_close(result.score, torch.tensor([2.0 + float(np.log(3))]))


def test_spread_of_the_gaussian_stays_in_its_limits():
    candidates = torch.tensor([[[[0.0, -1.0]], [[0.0, 1.0]]]])
    result = refit(candidates, torch.zeros(1, 2), Planner(elites=2, min_std=0.1, max_std=0.5))
    torch.testing.assert_close(result.std, torch.tensor([[[0.1, 0.5]]]))


def test_low_temperature_follows_the_best_and_high_temperature_the_mean():
    candidates = torch.tensor([[[[0.0, 0.0]], [[0.4, 0.8]]]])
    scores = torch.tensor([[1.0, 2.0]])
    cold = refit(candidates, scores, Planner(elites=2, temperature=0.01))
    warm = refit(candidates, scores, Planner(elites=2, temperature=1e4))
    torch.testing.assert_close(cold.actions, torch.tensor([[[0.4, 0.8]]]))
    torch.testing.assert_close(warm.actions, torch.tensor([[[0.2, 0.4]]]), atol=1e-4, rtol=0)


def test_candidates_of_the_policy_follow_it_through_the_model():
    scoring = Scoring(settings(), 1.0, "reward")
    view = PlainView(LinearModel([1.2, -0.3]), torch.zeros(1, 2), FLAT, scoring)
    candidates, returns = view.follow_policy(torch.zeros(1, 2, 4, 2))
    expected = torch.tensor([[1, -0.6], [1, 0], [0.4, 0], [0, 0]])
    torch.testing.assert_close(candidates, expected.expand(1, 2, 4, 2), atol=1e-6, rtol=0)
    torch.testing.assert_close(returns, view.returns(candidates))


@pytest.mark.parametrize("score", ["reward_q", "reward", "q"])
@pytest.mark.parametrize(("reflect", "share"), [(True, 0.5), (True, 0.18), (False, 0.2)])
def test_robots_that_are_planned_for_together_get_the_plans_of_the_plain_form(
    score, reflect, share
):
    """With a share of 0.18 of 50 candidates the views propose 5 and 4."""
    torch.manual_seed(0)
    config = load_config().override(
        {
            "perception.cells": 16, "model.latent": 32, "model.hidden": 24,
            "model.dynamics_hidden": 40, "planner.candidates": 50, "planner.elites": 8,
            "planner.policy_share": share, "planner.reflect": reflect, "planner.horizon": 4,
        }
    )  # fmt: skip
    model = WorldModel(config.model, config.perception.cells).requires_grad_(False)
    for parameter in model.parameters():  # no layer left at zero, no norm at one
        parameter.add_(0.1 * torch.randn_like(parameter))
    views = model.normalise(torch.randn(1 + reflect, 3, config.model.latent))
    plans = [
        plan(
            evaluator, views, torch.full((3, 2), 0.3), config.planner, 0.97, HALF,
            torch.Generator().manual_seed(5), score=score,
        )
        for evaluator in (PlainEvaluator(model), BatchedEvaluator(model))
    ]  # fmt: skip
    for expected, actual in zip(*plans, strict=True):
        torch.testing.assert_close(actual, expected, atol=2e-5, rtol=2e-5)
