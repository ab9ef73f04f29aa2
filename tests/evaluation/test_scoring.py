from __future__ import annotations

import json
import math
import time

import pytest

import crowdbench
from crowdbench.evaluation.driven import Driven
from crowdbench.evaluation.results import Origin
from crowdbench.evaluation.rollout import run_episode
from crowdbench.evaluation.scoring import Scorer

TINY = crowdbench.load_scenario("multimodal_fast", time_limit=1)


class Takes(crowdbench.Agent):
    """Computes and sleeps for given times at every step [s]."""

    def __init__(self, computing, sleeping):
        self.computing, self.sleeping = computing, sleeping

    def reset(self, robot, seed):
        pass

    def act(self, observation):
        until = time.process_time() + self.computing
        while time.process_time() < until:
            pass
        time.sleep(self.sleeping)
        return 0.3, 0.0


def scored(episode, **changes):
    driven = [Driven.of(episode)]
    for name, value in changes.items():
        object.__setattr__(driven[0], name, value)
    (result,) = Scorer().score(TINY, "takes", episode.seed, driven, Origin.of("a machine"))
    return result


def test_the_share_is_processor_time_over_wall_time():
    (waits,) = run_episode(TINY, [Takes(0.002, 0.02)], seed=0)
    (computes,) = run_episode(TINY, [Takes(0.02, 0.0)], seed=0)
    assert 0 < waits.processor_share < 0.2
    assert computes.processor_share > 2 * waits.processor_share


@pytest.mark.parametrize(("share", "kept"), [(1.02, True), (0.9, True), (0.89, False)])
def test_a_time_in_which_the_process_waited_is_left_out_and_the_reason_kept(share, kept):
    (episode,) = run_episode(TINY, [Takes(0.0, 0.002)], seed=0)
    result = scored(episode, processor_share=share)
    assert math.isnan(result.metrics["inference_s"]) != kept
    assert result.metrics["path_length"] > 0
    told = json.loads(json.dumps(dict(result.diagnostics)))
    assert told == ({} if kept else {"crowdbench.processor_share": 0.89})
    assert len(result.inference_s) == episode.steps, "what was measured is stored all the same"
