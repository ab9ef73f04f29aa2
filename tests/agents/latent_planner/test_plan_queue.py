"""Plans are taken action by action, each robot's on its own."""

import numpy as np
import torch
from crowdbench_agents.latent_planner.plan_queue import PlanQueue

BOTH = np.arange(2)


def filled():
    """Robot 0 has planned 0, 1, 2, robot 1 10, 11, 12."""
    queue = PlanQueue(2, 3)
    numbers = torch.tensor([[0.0, 1, 2], [10, 11, 12]])
    queue.put(BOTH, numbers[..., None].expand(-1, -1, 2))
    return queue


def test_actions_come_in_order_and_the_last_goes_on():
    queue = filled()
    taken = [queue.take(BOTH)[:, 0].tolist() for _ in range(5)]
    assert taken == [[0, 10], [1, 11], [2, 12], [2, 12], [2, 12]]
    assert queue.taken.tolist() == [5, 5]


def test_robots_take_plan_and_forget_each_on_its_own():
    queue = filled()
    queue.take(np.array([1]))
    assert queue.rest(BOTH)[..., 0].tolist() == [[0, 1, 2], [11, 12, 12]]
    queue.put(np.array([1]), torch.full((1, 3, 2), 7.0))
    queue.take(np.array([0]))
    queue.clear(np.array([0]))
    assert queue.rest(BOTH)[..., 1].tolist() == [[0, 0, 0], [7, 7, 7]]
    assert queue.taken.tolist() == [0, 0]


def test_what_is_left_of_a_plan_that_was_outlived_is_its_last_action():
    queue = filled()
    for _ in range(4):
        queue.take(BOTH)
    assert queue.rest(BOTH)[..., 0].tolist() == [[2, 2, 2], [12, 12, 12]]
