"""Chunks of episodes: how long they are, who gets them, and what becomes of lost ones."""

from __future__ import annotations

from collections import deque

import pytest

from crowdbench import AgentSpec, load_scenario
from crowdbench.evaluation.protocol import Describe, Job
from crowdbench.evaluation.results import Cell
from crowdbench.evaluation.work import LONGEST, Work

SCENARIO = load_scenario("multimodal_fast")
CELL = Cell("multimodal_fast", SCENARIO.digest, "", "{}", "0.2.0", "", "")


def jobs(agent, seeds):
    return [Job(SCENARIO, AgentSpec(agent, {}), CELL, seed) for seed in seeds]


def seeds(messages):
    return [message.seed for message in messages]


def test_a_chunk_has_one_agent_and_gets_shorter_towards_the_end():
    work, taken = Work(deque(jobs("a", range(100)) + jobs("b", range(10)))), []
    lengths = []
    for worker in range(1000):
        chunk = work.take(worker, place=worker, workers=2)
        if not chunk:
            break
        assert len({str(message.agent) for message in chunk}) == 1
        lengths.append(len(chunk))
        taken += chunk
    assert [(str(m.agent), m.seed) for m in taken] == [
        *(("a", seed) for seed in range(100)),
        *(("b", seed) for seed in range(10)),
    ]
    assert lengths[0] == LONGEST
    assert lengths[-1] == 1
    assert max(lengths) == LONGEST


def test_an_agent_new_to_a_machine_goes_to_one_worker_of_it_until_it_has_acted():
    work = Work(deque([*jobs("a", range(50)), *jobs("b", range(2))]))
    assert work.take(1, "here", workers=4)
    assert [str(m.agent) for m in work.take(2, "here", workers=4)] == ["b", "b"]
    assert work.take(3, "here", workers=4) == []
    assert work.take(4, "there", workers=4), "another machine compiles for itself"
    work.answered(1)
    assert work.take(3, "here", workers=4)


def test_describing_an_agent_compiles_nothing():
    messages = [Describe(AgentSpec("a", {})), *jobs("a", range(2))]
    work = Work(deque(messages))
    assert work.take(1, "here", workers=4) == messages[:1]
    work.answered(1)
    work.finished(1)
    assert seeds(work.take(2, "here", workers=4)) == [0]
    assert work.take(3, "here", workers=4) == []


def test_what_a_lost_worker_has_not_answered_comes_first_again():
    work = Work(deque(jobs("a", range(32))))
    assert seeds(work.take(1, "here", workers=2)) == list(range(8))
    assert [work.answered(1).seed for _ in range(3)] == [0, 1, 2]
    assert work.lost(1) is None
    assert work.busy == 0
    assert seeds(work.take(2, "there", workers=2))[:6] == [3, 4, 5, 6, 7, 8]


def test_an_episode_that_is_lost_with_two_workers_is_given_up_and_its_neighbours_are_not():
    work = Work(deque(jobs("a", range(8))))
    given_up = []
    for worker in range(3):
        assert work.take(worker, worker, workers=1)
        given_up.append(work.lost(worker))
    assert [one and one.seed for one in given_up] == [None, 0, None]
    assert seeds(work.take(9, 9, workers=1))[0] == 1


@pytest.mark.parametrize("answered", [0, 4])
def test_a_worker_that_owes_nothing_may_be_lost(answered):
    work = Work(deque(jobs("a", range(8))))
    if answered:
        work.take(1, "here", workers=1)
        for _ in range(answered):
            work.answered(1)
    assert work.lost(1) is None
    assert work.busy == 0
    assert seeds(work.take(2, "here", workers=1))[0] == answered
