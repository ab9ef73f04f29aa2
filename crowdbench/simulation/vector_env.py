"""Many environments at once, as a Gymnasium vector environment: batched arrays in and out.

Lanes
-----
``crowdbench.vector_env(scenario, num_envs=64)``, or
``gymnasium.make_vec("crowdbench:CrowdNav-v0", num_envs=64)``. Each of ``num_envs`` lanes runs
episodes of its own, exactly those of ``CrowdNavEnv`` under the same scenario, seed and actions: to
the last bit, whatever the number of lanes. Spaces are those of one robot (see
``crowdbench.simulation.env``) with a leading axis of lanes; rewards are float64. With
``obstacle_map=crowdbench.MapGeometry()`` observations have the stacked obstacle map too.

Arrays that ``reset`` and ``step`` return are the caller's own; nothing writes to them later.

Scenarios and seeds
-------------------
Where ``scenario`` is a list, each episode's scenario is drawn by ``weights``, which can be changed
while it runs. All of them need the same robots and LiDAR; the attribute ``robot`` is the first
one's, from which ``control_period`` and ``goal_tolerance`` of others may differ.

``reset(seed=s)`` begins lane i with the episode seed s + i, ``reset(seed=[...])`` with one of a
list. The seeds of a lane's later episodes, and its scenarios, are drawn from the lane's first one.
``infos`` name both.

The end of an episode
---------------------
As Gymnasium's autoreset modes say, named in ``metadata["autoreset_mode"]``:

=============  =====================================================================================
mode           what happens
=============  =====================================================================================
``NEXT_STEP``  the default: the step after an end begins the next episode and ignores the action
``SAME_STEP``  the step itself does; ``infos["final_obs"]`` (one observation per lane that ended,
               otherwise None) and ``infos["final_info"]`` are of the episode that ended
``DISABLED``   ``reset(options={"reset_mask": ...})`` does; until then a lane stays as it is, with
               reward 0 and its flags
=============  =====================================================================================

``reset`` takes in ``options``, all optional: ``reset_mask``, (num_envs,) bool, the lanes to begin
anew; ``scenario``, the index of the scenario for each lane.

Information
-----------
Batched as Gymnasium does: beside every key a mask with an underscore says which lanes have it.
``outcome``, ``reward_terms`` and ``contact`` of a step as in ``CrowdEnv``; ``seed`` and
``scenario`` (its index) of the present episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from crowdbench.messages import short
from crowdbench.robot import RobotSpec
from crowdbench.scenario import Scenario, ScenarioError
from crowdbench.simulation.episodes import Episodes, Step, load_all, read_seeds
from crowdbench.simulation.lanes import OUTCOMES, RUNNING, TERMS, TIMEOUT
from crowdbench.simulation.obstacle_map import MapGeometry

_NAMES = np.array(OUTCOMES, dtype=object)
_ROBOT = "robot_0"


def vector_env(
    scenario: str | Path | Scenario | Sequence[str | Path | Scenario] = "multimodal_fast",
    num_envs: int = 1,
    weights: Sequence[float] | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    obstacle_map: MapGeometry | None = None,
    **overrides: Any,
) -> CrowdVectorEnv:
    """Make the vector environment of one scenario or several.

    Args:
        scenario: as for ``parallel_env``, or a list of such, for one robot each.
        num_envs: number of lanes.
        weights: how often each scenario is drawn, in any unit; None draws all alike.
        autoreset_mode: what follows the end of an episode, or its value (``"SameStep"``).
        obstacle_map: where the map lies that robots also observe; None: they observe none.
        overrides: scenario fields, nested or dotted, for all scenarios.

    Raises:
        ScenarioError: unknown scenario or field, a value out of range, or scenarios whose robots or
            LiDARs differ.
        ValueError: bad ``num_envs``, ``weights`` or ``autoreset_mode``.
    """
    return CrowdVectorEnv(scenario, num_envs, weights, autoreset_mode, obstacle_map, **overrides)


class CrowdVectorEnv(VectorEnv[dict[str, NDArray[Any]], NDArray[Any], NDArray[Any]]):
    """Lanes of one robot each; the docstring of this module describes it.

    Attributes:
        scenarios: that are drawn from.
        robot: what a planner may know about the robot.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario | Sequence[str | Path | Scenario] = "multimodal_fast",
        num_envs: int = 1,
        weights: Sequence[float] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        obstacle_map: MapGeometry | None = None,
        **overrides: Any,
    ) -> None:
        """Make the lanes; arguments as for ``vector_env``."""
        scenarios = load_all(scenario, overrides)
        self._episodes = Episodes(scenarios, num_envs, weights, obstacle_map)
        if self._episodes.robots != 1:
            raise ScenarioError(
                f"scenario {scenarios[0].name!r}: robots.count: {self._episodes.robots}; the "
                "Gymnasium view needs 1, use crowdbench.parallel_vector_env"
            )
        try:
            self._mode = AutoresetMode(autoreset_mode)
        except ValueError:
            allowed = ", ".join(repr(mode.value) for mode in AutoresetMode)
            raise ValueError(
                f"autoreset_mode: {short(autoreset_mode)}; allowed: {allowed}"
            ) from None
        self.metadata = {"render_modes": [], "autoreset_mode": self._mode}
        self.num_envs = self._episodes.count
        self.scenarios = self._episodes.scenarios
        self.robot = RobotSpec.from_scenario(scenarios[0])
        self.single_action_space = self._episodes.action_spaces[_ROBOT]
        self.single_observation_space = self._episodes.observation_spaces[_ROBOT]
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._ended, self._late = np.zeros((2, self.num_envs), dtype=np.bool_)

    @property
    def weights(self) -> NDArray[np.float64]:
        """(scenarios,) how often each is drawn, in shares of 1; episodes to come follow a change.

        Raises:
            ValueError: set to something other than one weight a scenario, none negative and not
                all zero.
        """
        return self._episodes.weights

    @weights.setter
    def weights(self, weights: Sequence[float]) -> None:
        self._episodes.weights = weights

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Begin an episode in every lane, or in those of ``options["reset_mask"]``.

        Args:
            seed: lane i gets seed + i, or its own of a list; None, there or here, draws the next.
            options: ``reset_mask`` and ``scenario``, see above.

        Raises:
            ValueError: seeds or options of another shape or kind; the message says which.
            ScenarioError: a scenario has no room.
        """
        self._episodes.require_open()
        mask, scenarios = self._read_options(options or {})
        seeds = read_seeds(seed, self.num_envs)
        if not (self._episodes.begun or mask.all()):
            raise ValueError("reset_mask: every lane has to begin first; call reset() without it")
        lanes = np.flatnonzero(mask)
        self._begin(lanes, seeds, scenarios)
        return self._episodes.observations(0), self._begun_infos(mask)

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[
        dict[str, NDArray[Any]],
        NDArray[np.float64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Advance all lanes by one control period.

        Args:
            actions: (num_envs, 2); rows of lanes that do not act are ignored.

        Returns:
            Observations, rewards, terminations, truncations and infos, batched.

        Raises:
            ValueError: actions of another shape, or not finite; the message names the lane.
            RuntimeError: ``reset`` has not been called, or the environment is closed.
        """
        self._episodes.require_running()
        resting = self._episodes.over.copy()
        lanes = np.flatnonzero(~resting)
        done = self._episodes.step(lanes, self._episodes.read_actions(actions, lanes, 0)[:, None])
        rewards = np.zeros(self.num_envs)
        terms = done.terms[:, 0]
        rewards[lanes] = 0.0 + terms[:, 0] + terms[:, 1] + terms[:, 2]
        outcome = done.outcome[:, 0]
        self._late[lanes] = outcome == TIMEOUT
        self._ended[lanes] = (outcome != RUNNING) & (outcome != TIMEOUT)
        ended, late = self._ended.copy(), self._late.copy()
        infos = self._infos(lanes, done)
        if self._mode is AutoresetMode.NEXT_STEP and resting.any():
            ended[resting] = late[resting] = False
            self._begin(np.flatnonzero(resting))
            infos |= self._begun_infos(np.ones(self.num_envs, dtype=np.bool_))
        elif self._mode is AutoresetMode.SAME_STEP and self._episodes.over.any():
            infos = self._begin_now(lanes, done)
        return self._episodes.observations(0), rewards, ended, late, infos

    def state(self, lane: int) -> dict[str, NDArray[Any]]:
        """Everything about a lane, as ``CrowdEnv.state()``: for privileged agents and tests.

        Raises:
            RuntimeError: ``reset`` has not been called.
        """
        return self._episodes.state(lane)

    def close_extras(self, **kwargs: Any) -> None:
        """Let no more episodes begin nor go on."""
        self._episodes.close()

    def _begin(self, lanes: NDArray[np.int64], *chosen: Sequence[int | None]) -> None:
        """Begin episodes, as ``Episodes.begin`` does."""
        self._episodes.begin(lanes, *chosen)
        self._ended[lanes] = self._late[lanes] = False

    def _begin_now(self, lanes: NDArray[np.int64], done: Step) -> dict[str, Any]:
        """Begin the next episodes of the lanes that have just ended; infos of both."""
        over = np.flatnonzero(self._episodes.over)
        finals = self._episodes.observations(0)
        final = np.full(self.num_envs, None, dtype=object)
        for lane in over.tolist():
            final[lane] = {name: values[lane] for name, values in finals.items()}
        mask = self._episodes.over.copy()
        last = self._infos(over, done.of(mask[lanes]))
        self._begin(over)
        going = ~mask[lanes]
        infos = self._infos(lanes[going], done.of(going))
        infos |= self._begun_infos(np.ones(self.num_envs, dtype=np.bool_))
        return infos | {
            "final_obs": final,
            "_final_obs": mask,
            "final_info": last,
            "_final_info": mask.copy(),
        }

    def _infos(self, lanes: NDArray[np.int64], done: Step) -> dict[str, Any]:
        """Infos of lanes (M,) that have done a step."""
        mask = np.zeros(self.num_envs, dtype=np.bool_)
        mask[lanes] = True
        outcome, contact = np.full((2, self.num_envs), None, dtype=object)
        outcome[lanes], contact[lanes] = _NAMES[done.outcome[:, 0]], done.contacts[:, 0]
        terms = np.zeros((len(TERMS), self.num_envs))
        terms[:, lanes] = done.terms[:, 0].T
        parts: dict[str, Any] = dict(zip(TERMS, terms, strict=True))
        parts |= {f"_{name}": mask.copy() for name in TERMS}
        return {
            "outcome": outcome,
            "_outcome": mask,
            "reward_terms": parts,
            "_reward_terms": mask.copy(),
            "contact": contact,
            "_contact": mask.copy(),
        } | self._begun_infos(mask)

    def _begun_infos(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        """Seeds and scenarios of the present episodes."""
        return {
            "seed": np.where(mask, self._episodes.seed, 0),
            "_seed": mask.copy(),
            "scenario": np.where(mask, self._episodes.scenario, 0),
            "_scenario": mask.copy(),
        }

    def _read_options(self, options: dict[str, Any]) -> tuple[NDArray[np.bool_], list[int | None]]:
        """Lanes to begin, and their scenarios."""
        if unknown := sorted(options.keys() - {"reset_mask", "scenario"}):
            raise ValueError(f"options: unknown {unknown}; allowed: 'reset_mask', 'scenario'")
        mask = np.asarray(options.get("reset_mask", np.ones(self.num_envs, dtype=np.bool_)))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"reset_mask: expected ({self.num_envs},) bool, at least one True")
        chosen = options.get("scenario")
        if chosen is None:
            return mask, [None] * self.num_envs
        indices = np.asarray(chosen)
        if indices.shape != (self.num_envs,) or indices.dtype.kind not in "iu":
            raise ValueError(f"scenario: expected ({self.num_envs},) indices, got {chosen!r}")
        if ((indices < 0) | (indices >= len(self.scenarios))).any():
            raise ValueError(f"scenario: expected indices from 0 to {len(self.scenarios) - 1}")
        return mask, [int(index) for index in indices]
