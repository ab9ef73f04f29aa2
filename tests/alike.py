"""Lanes side by side against environments by themselves."""

import numpy as np

from crowdbench import parallel_env, vector_env


def assert_lanes_alike(scenarios, steps):
    """Three scenarios in lanes that had others before: states are the single ones to the bit."""
    env = vector_env(scenarios, 3, autoreset_mode="Disabled")
    env.reset(seed=4, options={"scenario": np.array([1, 1, 2])})
    env.reset(seed=7, options={"scenario": np.array([2, 0, 1])})
    singles = [parallel_env(scenarios[k]) for k in (2, 0, 1)]
    for lane, single in enumerate(singles):
        single.reset(seed=7 + lane)
    for _ in range(steps):
        env.step(np.zeros((3, 2)))
        for lane, single in enumerate(singles):
            if single.agents:
                single.step({"robot_0": np.zeros(2)})
                for name, value in single.state().items():
                    assert single.state_space[name].contains(value), name
                    np.testing.assert_array_equal(env.state(lane)[name], value, err_msg=name)
