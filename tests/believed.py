"""Futures that are drawn from what is believed of people, and what may not change them."""

import numpy as np
from crowdbench_agents.informed.goals import Goals


def drawn(goals, state, name):
    """(F, ...) what a state is in each of the futures."""
    return np.array([future[name] for future in goals.draw(state)])


def futures(env, name, hidden=None):
    """What is drawn in six steps of an episode that has begun, in which the robot stands.

    Args:
        env: of one robot.
        name: of what is drawn.
        hidden: what is added to parts of the state before it is told; times and intents are set
            to 0 then.
    """
    people = env.scenario.pedestrians.count
    goals, told = None, []
    for _ in range(6):
        state = env.state()
        if hidden is not None:
            for part, change in hidden.items():
                state[part] += change
            state["pedestrian_switch_time"][:] = 0.0
            state["pedestrian_intent"][:] = 0
        goals = goals or Goals(state, 0.2, 0.25, 3, np.random.default_rng(1))
        goals.update(state, np.ones(people, dtype=bool))
        told.append(drawn(goals, state, name))
        env.step({"robot_0": (0.0, 0.0)})
    return np.array(told)
