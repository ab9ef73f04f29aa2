"""A small task that our SAC and Stable-Baselines3's both learn."""

import gymnasium
import numpy as np
import pytest
import torch
from crowdbench_agents.learning.inputs import Inputs, Sensed
from crowdbench_agents.learning.lanes import Outcomes
from crowdbench_agents.learning.replay import Replay
from crowdbench_agents.sac.learner import Learner
from crowdbench_agents.sac.networks import encode
from gymnasium import spaces

STEPS, BATCH, RANDOM = 1000, 32, 100
LENGTH, REACH = 8, 0.5


class Point(gymnasium.Env):
    """A point moves up to 0.5 along each axis towards a goal; a step costs the distance left."""

    def __init__(self, space):
        self.observation_space, self.action_space = space, spaces.Box(-1, 1, (2,))
        self._nothing = np.zeros((16, 16), np.uint8), np.zeros(2, np.float32)

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self._step, self._goal = 0, self.np_random.uniform(-2, 2, 2)
        return self._seen(), {}

    def step(self, action):
        self._step += 1
        self._goal = self._goal - REACH * action
        cost = np.abs(self._goal).sum() / 4
        return self._seen(), -cost, False, self._step == LENGTH, {}

    def _seen(self):
        maps, velocity = self._nothing
        return {"map": maps, "velocity": velocity, "goal": self._goal.astype(np.float32)}


def mean_return(env, act):
    total = 0.0
    for seed in range(20):
        seen, late = env.reset(seed=seed)[0], False
        while not late:
            seen, reward, _, late, _ = env.step(act(seen))
            total += reward / 20
    return total


def as_inputs(seen):
    return Inputs(*(torch.from_numpy(x[None]) for x in seen.values()))


def trained(config, env):
    """Our learner; it acts and learns in turn, from the replay of all learned agents."""
    learner, rng = Learner(config, seed=0), np.random.default_rng(0)
    actor, replay = learner.actor, Replay(1, 2 * STEPS, 16)
    nobody, no, nothing = np.zeros(1, np.uint8), np.zeros(1, bool), np.zeros((1, 2), np.float32)
    lane = np.zeros(1, np.int64)
    seen, _ = env.reset(seed=1000)
    for step in range(STEPS):
        if step < RANDOM:
            action = rng.uniform(-1, 1, (1, 2)).astype(np.float32)
        else:
            with torch.no_grad():
                features = encode(actor.encoder, as_inputs(seen), bfloat16=False)
                action = actor.sample(features, torch.randn(1, 2))[0].numpy()
        after, reward, _, late, _ = env.step(action[0])
        result = Outcomes(np.array([reward]), np.zeros(1), no, no | late, np.array(["running"]))
        before, behind = (Sensed(*(x[None] for x in given.values())) for given in (seen, after))
        replay.append_step(lane, before, action, result, nothing, nobody, behind)
        seen = env.reset()[0] if late else after
        if step >= RANDOM:
            learner.update(replay.sample(BATCH, 1, rng))
    return lambda seen: actor(as_inputs(seen)).detach().numpy()[0]


@pytest.mark.slow
def test_both_come_equally_close_to_the_best_return(tiny, reference_sac, space):
    changes = {"training.learning_rate": 3e-3, "training.target_rate": 0.05, "loss.discount": 0.9}
    changes |= {"training.reward_scale": 1.0, "training.learning_rate_decay": None}
    config, env = tiny(**changes), Point(space)
    best = mean_return(env, lambda seen: np.clip(seen["goal"] / REACH, -1, 1))
    idle = mean_return(env, lambda _: np.zeros(2))
    model = reference_sac(config, env, seed=0, batch_size=BATCH, learning_starts=RANDOM)
    model.learn(STEPS)
    theirs = mean_return(env, lambda seen: model.predict(seen, deterministic=True)[0])
    ours = mean_return(env, trained(config, env))
    learned = (np.array([ours, theirs]) - idle) / (best - idle)
    assert learned.min() > 0.75
    assert abs(learned[0] - learned[1]) < 0.12
