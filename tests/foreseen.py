"""Episodes that go on while the robot does as it is told, for what was predicted to be compared."""

STAND = (0.0, 0.0)


def episodes(env, agent, seeds, begin, go_on, steps):
    """The state after some steps of each episode, and those that follow.

    Args:
        env: of one robot.
        agent: is told that an episode begins, and decides nothing.
        seeds: of the episodes.
        begin: actions before the first state.
        go_on: the action that is repeated after it.
        steps: how often at most; an episode that ends gives no more states.

    Yields:
        The state, and an iterator over the number of the step, from 1, and the state after it.
    """
    for seed in seeds:
        env.reset(seed=seed)
        agent.reset(env.robot_spec(), seed)
        for action in begin:
            env.step({"robot_0": action})
        yield env.state(), _states(env, go_on, steps)


def _states(env, action, steps):
    for step in range(1, steps + 1):
        env.step({"robot_0": action})
        if not env.agents:
            return
        yield step, env.state()


def ways_left(state):
    """How far it is to everybody's goal [m]."""
    return ((state["pedestrian_goal"] - state["pedestrian_position"]) ** 2).sum(axis=1) ** 0.5
