"""CrowdNavEnv: the Gymnasium view of one robot in the crowd.

``gymnasium.make("crowdbench:CrowdNav-v0", scenario="multimodal_fast")``. Spaces, rewards, episode
end, information and copies are those of one robot in CrowdEnv (see ``crowdbench.simulation.env``).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Scenario, ScenarioError
from crowdbench.simulation.env import CrowdEnv, RenderMode, parallel_env
from crowdbench.simulation.obstacle_map import MapGeometry

_ROBOT = "robot_0"


class CrowdNavEnv(gymnasium.Env[dict[str, Any], NDArray[np.float32]]):
    """One robot of a scenario, for libraries that know Gymnasium."""

    metadata = CrowdEnv.metadata

    def __init__(
        self,
        scenario: str | Path | Scenario = "multimodal_fast",
        render_mode: RenderMode | None = None,
        obstacle_map: MapGeometry | None = None,
        **overrides: Any,
    ) -> None:
        """Make the environment; arguments as in ``crowdbench.parallel_env``.

        Raises:
            ScenarioError: unknown scenario or field, or a scenario with more than one agent.
        """
        self.crowd = parallel_env(scenario, render_mode, obstacle_map, **overrides)
        if self.crowd.possible_agents != [_ROBOT]:
            raise ScenarioError(
                f"scenario {self.crowd.scenario.name!r}: the Gymnasium view needs robots.count = 1 "
                f"and pedestrians.control = scripted, got agents {self.crowd.possible_agents}; "
                "use crowdbench.parallel_env"
            )
        self.render_mode = render_mode
        self.metadata = self.crowd.metadata
        self.observation_space = self.crowd.observation_space(_ROBOT)
        self.action_space = self.crowd.action_space(_ROBOT)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode; see ``CrowdEnv.reset``."""
        super().reset(seed=seed)
        observations, infos = self.crowd.reset(seed=seed, options=options)
        return observations[_ROBOT], infos[_ROBOT]

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Advance by one control period; see ``CrowdEnv.step``."""
        if not self.crowd.agents:
            raise RuntimeError("the episode is over (or has not begun): call reset()")
        seen, rewards, terminations, truncations, infos = self.crowd.step({_ROBOT: action})
        ended = terminations[_ROBOT], truncations[_ROBOT]
        return seen[_ROBOT], rewards[_ROBOT], *ended, infos[_ROBOT]

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the present state; see ``CrowdEnv.render``."""
        return self.crowd.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self.crowd.close()
