"""Validation: which episodes it runs, and that it measures what the evaluator does."""

from collections import defaultdict
from itertools import pairwise

import numpy as np
import pytest
from crowdbench_agents.learning.validation import validate
from crowdbench_agents.learning.worlds import as_they_are

import crowdbench
from crowdbench.evaluation.metrics import metrics
from crowdbench.evaluation.rollout import run_episode


def test_who_stands_still_neither_arrives_nor_turns():
    def stand(moment):
        return np.tile(np.array([-1.0, 0.0], np.float32), (len(moment.place), 1))

    worlds = as_they_are(["corridor_sparse"])
    standing = validate(stand, crowdbench.MapGeometry(16, 6.0, 4.0), 1, worlds)
    assert standing.success == standing.spl == {"corridor_sparse": 0.0}
    assert standing.smoothness == 0.0
    assert np.isnan(standing.seconds)


class Wavering(crowdbench.Agent):
    """Drives towards the goal, and to its left and right on the way, so that L is above L*."""

    def reset(self, robot, seed):
        self._step = 0

    def act(self, observation):
        bearing = np.arctan2(observation.goal[1], observation.goal[0])
        action = waver(np.array([bearing]), np.array([self._step]))[0] * [0.5, 1.5] + [0.5, 0]
        self._step += 1
        return action.astype(np.float32)


def waver(bearing, steps):
    turn = np.clip(bearing + np.sin(steps / 4), -1, 1)
    return np.stack([np.full(len(turn), 0.6), turn], axis=-1).astype(np.float32)


def test_validation_has_the_success_and_spl_of_the_evaluator():
    def act(moment):
        return waver(np.arctan2(moment.sensed.goal[:, 1], moment.sensed.goal[:, 0]), moment.steps)

    names, count = ["corridor_sparse", "unimodal_slow"], 4
    found = validate(act, crowdbench.MapGeometry(16, 6.0, 4.0), count, as_they_are(names))
    for name in names:
        episodes = [run_episode(name, [Wavering()], seed)[0] for seed in range(900_000, 900_004)]
        for metric, values in (("success", found.success), ("spl", found.spl)):
            expected = np.mean([metrics(episode)[metric] for episode in episodes])
            assert values[name] == pytest.approx(expected, abs=1e-4)
        assert 0 < found.spl[name] < found.success[name]


def test_validation_runs_the_wanted_episodes_one_after_another(monkeypatch):
    monkeypatch.setattr("crowdbench_agents.learning.validation.ENVIRONMENTS", 2)
    taken, begun = defaultdict(list), []
    reset = crowdbench.CrowdVectorEnv.reset

    def noted(env, *, seed, options):
        for lane in np.flatnonzero(options["reset_mask"]):
            begun.append((env.scenarios[options["scenario"][lane]].name, seed[lane]))
        return reset(env, seed=seed, options=options)

    def ahead(moment):
        for place, steps in zip(moment.place, moment.steps, strict=True):
            taken[place].append(steps)
        return np.tile(np.array([1.0, 0.0], np.float32), (len(moment.place), 1))

    monkeypatch.setattr(crowdbench.CrowdVectorEnv, "reset", noted)
    names = ["corridor_sparse", "unimodal_slow"]
    validate(ahead, crowdbench.MapGeometry(16, 6.0, 4.0), 2, as_they_are(names), first_seed=900_500)
    assert sorted(begun) == [(name, seed) for name in names for seed in (900_500, 900_501)]
    assert set(taken) == {0, 1}
    assert sum(steps.count(0) for steps in taken.values()) == 4
    for steps in taken.values():
        assert all(b in (0, a + 1) for a, b in pairwise([-1, *steps]))
