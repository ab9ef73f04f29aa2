"""A picture of a scenario's arena, as figures show it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Scenario

SPEED = 0.5
"""Of the robots, straight on [m/s]."""


def arena_picture(scenario: Scenario, seed: int, steps: int) -> NDArray[np.uint8]:
    """(H, W, 3) the arena, without the margin, after some steps straight on."""
    from crowdbench.simulation.canvas import View
    from crowdbench.simulation.env import CrowdEnv
    from crowdbench.simulation.rendering import Renderer

    env, renderer = CrowdEnv(scenario), Renderer(scenario, "rgb_array")
    seen, _ = env.reset(seed=seed)
    for _ in range(steps):
        renderer.follow(env.state())
        seen, *_ = env.step(dict.fromkeys(env.agents, (SPEED, 0.0)))
    picture = renderer.draw(env.state(), {name: one["lidar"] for name, one in seen.items()})
    assert picture is not None
    view = View(scenario.arena.length, scenario.arena.width)
    across, up = (round(view.scale * side) for side in (view.length, view.width))
    top, left = (picture.shape[0] - up) // 2, (picture.shape[1] - across) // 2
    return np.ascontiguousarray(picture[top : top + up, left : left + across])
