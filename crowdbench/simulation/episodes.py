"""Episodes in many lanes: which begins next in each, what a step does, and how each ends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.messages import short
from crowdbench.scenario import Scenario, ScenarioError, load_scenario
from crowdbench.simulation import observations, streams
from crowdbench.simulation.kinematics import make_drive
from crowdbench.simulation.lanes import RUNNING, TIMEOUT
from crowdbench.simulation.map_layout import places_of
from crowdbench.simulation.obstacle_map import MapGeometry
from crowdbench.simulation.routes import routes_of
from crowdbench.simulation.sensing import as_observation
from crowdbench.simulation.substeps import check_speeds
from crowdbench.simulation.world import Lane
from crowdbench.simulation.worlds import Worlds

_OWN = {
    "robots": {"travel", "start", "goal", "look_ahead", "goal_tolerance", "odometry"},
    "lidar": {"noise", "dropout"},
}
"""Fields of robots and LiDAR in which lanes may differ."""


class Step(NamedTuple):
    """What a step did in M lanes with R robots each.

    Attributes:
        acted: (M, R) the robot was in the scene.
        terms: (M, R, 3) of the reward, as in TERMS; zeros for robots that were not there.
        outcome: (M, R) index into OUTCOMES.
        contacts: (M, R) Contact or None.
    """

    acted: NDArray[np.bool_]
    terms: NDArray[np.float64]
    outcome: NDArray[np.int64]
    contacts: NDArray[np.object_]

    def of(self, which: NDArray[Any]) -> Step:
        """The same of some of the lanes, by a mask (M,)."""
        return Step(self.acted[which], self.terms[which], self.outcome[which], self.contacts[which])


class Episodes:
    """The episodes of N lanes, each in a scenario that is drawn by weight.

    Attributes:
        scenarios: that may be drawn.
        count, robots: N, and R in each lane.
        drive: of all robots.
        action_spaces, observation_spaces: of a robot in one lane, by name.
        begun: whether there have been episodes.
        over: (N,) no episode is running.
        scenario: (N,) index of the present one.
        seed: (N,) of the present episode.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        count: int,
        weights: Sequence[float] | None = None,
        obstacle_map: MapGeometry | None = None,
    ) -> None:
        """Make room; no episode begins.

        Args:
            scenarios: that may be drawn.
            count: N.
            weights: how often each is drawn; None draws all alike.
            obstacle_map: where the map lies that robots also observe; None: they observe none.

        Raises:
            ValueError: no lanes, no scenarios, or weights that cannot be.
            ScenarioError: a scenario cannot be used, or not together with the first.
        """
        if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 1:
            raise ValueError(f"num_envs: {count!r}; allowed: a whole number of at least 1")
        if not scenarios:
            raise ValueError("scenario: an empty list; allowed: at least one scenario")
        for place, scenario in enumerate(scenarios):
            _check_alike(scenarios[0], scenario, place)
            if scenario.pedestrians.control != "scripted":
                raise ScenarioError(
                    f"scenario {scenario.name!r}: pedestrians.control: "
                    f"{scenario.pedestrians.control!r}; allowed in lanes: 'scripted'"
                )
            check_speeds(scenario, make_drive(scenario), scenario.pedestrians.speed[1])
            places_of(scenario), routes_of(scenario)  # what they refuse
        self.scenarios = list(scenarios)
        self.count, self.robots = int(count), scenarios[0].robots.count
        self.over = np.ones(count, dtype=np.bool_)
        self.scenario, self.seed = np.zeros((2, count), dtype=np.int64)
        self.drive = make_drive(scenarios[0])
        robots = [f"robot_{r}" for r in range(self.robots)]
        self.action_spaces, self.observation_spaces = observations.agent_spaces(
            scenarios[0], self.drive, robots, [], 0.0, obstacle_map
        )
        self.begun = self._closed = False
        self._worlds = Worlds(count, scenarios, obstacle_map)
        self._limits = np.array([scenario.max_steps for scenario in scenarios])
        self._steps = np.zeros(count, dtype=np.int64)
        self._seeds = [np.random.default_rng() for _ in range(count)]
        self._draws = [np.random.default_rng() for _ in range(count)]
        self.weights = [1.0] * len(scenarios) if weights is None else weights

    @property
    def weights(self) -> NDArray[np.float64]:
        """(scenarios,) how often each is drawn, in shares of 1; episodes to come follow a change.

        Raises:
            ValueError: set to something other than one weight a scenario, none negative and not
                all zero.
        """
        return self._shares.copy()

    @weights.setter
    def weights(self, weights: Sequence[float]) -> None:
        try:
            shares = np.array(weights, dtype=np.float64)
        except (TypeError, ValueError):
            shares = np.full(1, np.nan)
        fits = shares.shape == (len(self.scenarios),) and np.isfinite(shares).all()
        if not fits or (shares < 0).any() or not 0 < shares.sum() < math.inf:
            raise ValueError(
                f"weights: {weights!r}; allowed: {len(self.scenarios)} finite numbers, one per "
                "scenario, none negative and not all zero"
            )
        self._shares = shares / shares.sum()

    def begin(
        self,
        lanes: NDArray[np.int64],
        seeds: Sequence[int | None] | None = None,
        scenarios: Sequence[int | None] | None = None,
    ) -> None:
        """Begin episodes in some lanes (M,); ``observations`` has what is seen then.

        Args:
            lanes: which.
            seeds: (N,) of the episodes, by lane; from it a lane also draws those of later episodes
                and their scenarios. None, there or here, draws the next one.
            scenarios: (N,) indices of their scenarios, by lane; None draws them by weight.

        Raises:
            ScenarioError: a scenario has no room.
        """
        nothing = [None] * self.count
        for lane in lanes.tolist():
            self._begin(lane, (seeds or nothing)[lane], (scenarios or nothing)[lane])
        self._worlds.observe(lanes)
        self.begun = True

    def _begin(self, lane: int, seed: int | None, scenario: int | None) -> None:
        if seed is None:
            seed = int(self._seeds[lane].integers(2**31))
        else:
            self._seeds[lane] = streams.next_episode(seed)
            self._draws[lane] = streams.scenario(seed)
        if scenario is None:
            scenario = self._draw(lane)
        self._worlds.begin(lane, self.scenarios[scenario], seed)
        self.scenario[lane], self.seed[lane] = scenario, seed
        self._steps[lane] = 0
        self.over[lane] = False

    def observations(self, robot: int) -> dict[str, NDArray[Any]]:
        """What a robot observes in all lanes, by name, as arrays of their own."""
        drawn = self._worlds.drawn
        maps = None if drawn is None else drawn.maps[:, robot].copy()
        return as_observation(self._worlds.state.seen[:, robot].copy(), maps)

    @property
    def present(self) -> NDArray[np.bool_]:
        """(N, R) which robots are in the scene."""
        present: NDArray[np.bool_] = self._worlds.state.robots["active"]
        return present

    def read_actions(
        self, actions: Any, lanes: NDArray[np.int64], robot: int, whose: str = ""
    ) -> NDArray[np.float64]:
        """A robot's commands (M, 2) in some lanes, within the drive's bounds.

        Args:
            actions: (N, 2) as they come from outside.
            lanes: (M,) which act.
            robot: which; where it has left a lane its action is ignored.
            whose: names it in messages.

        Raises:
            ValueError: actions of another shape, or not finite; the message names the lane.
        """
        try:
            array = observations.as_numbers(actions)
        except (TypeError, ValueError) as error:
            raise ValueError(f"actions{whose}: {short(actions)} is not numeric") from error
        if array.shape != (self.count, 2):
            raise ValueError(f"actions{whose}: expected shape ({self.count}, 2), got {array.shape}")
        there = self.present[lanes, robot]
        finite = np.isfinite(array[lanes]).all(axis=1) | ~there
        if not finite.all():
            lane = int(lanes[np.argmin(finite)])
            raise ValueError(
                f"action{whose} in lane {lane}: expected finite numbers, got {array[lane]}"
            )
        commands = np.where(there[:, None], array[lanes], 0.0)
        return np.minimum(np.maximum(commands, self.drive.low), self.drive.high)

    def step(self, lanes: NDArray[np.int64], commands: NDArray[np.float64]) -> Step:
        """Advance some lanes whose episodes are running by a control period.

        Args:
            lanes: (M,) which.
            commands: (M, R, 2) actions within the drive's bounds.
        """
        robots, worlds = self._worlds.state.robots, self._worlds
        acted = robots["active"][lanes]
        worlds.choose(lanes)
        worlds.move(lanes, commands)
        worlds.observe(lanes)
        worlds.judge(lanes)
        self._steps[lanes] += 1
        outcome = np.where(acted, robots["outcome"][lanes], RUNNING)
        ended = outcome != RUNNING
        contacts = np.full(ended.shape, None, dtype=object)
        for i, r in np.argwhere(ended).tolist():
            contacts[i, r] = worlds.episode(int(lanes[i])).bodies.touched(r)
            if robots["active"][lanes[i]].sum() > 1:
                worlds.remove(int(lanes[i]), r)
            else:  # nothing moves here any more
                robots["active"][lanes[i], r] = False
        late = self._steps[lanes] >= self._limits[self.scenario[lanes]]
        outcome[late[:, None] & acted & ~ended] = TIMEOUT
        self.over[lanes] = late | ~robots["active"][lanes].any(axis=1)
        terms = np.where(acted[..., None], robots["terms"][lanes], 0.0)
        return Step(acted, terms, outcome, contacts)

    def state(self, lane: int) -> dict[str, NDArray[Any]]:
        """Everything about a lane, as ``CrowdEnv.state()``: for privileged agents and tests.

        Raises:
            RuntimeError: no episode has begun.
        """
        if not self.begun:
            raise RuntimeError("call reset() before state()")
        return observations.state(Lane(self._worlds, range(self.count)[lane]))

    def require_running(self) -> None:
        """See that there is something to step.

        Raises:
            RuntimeError: no episode has begun, or the environment is closed.
        """
        self.require_open()
        if not self.begun:
            raise RuntimeError("call reset() before step()")

    def require_open(self) -> None:
        """See that episodes may begin and go on.

        Raises:
            RuntimeError: the environment is closed.
        """
        if self._closed:
            raise RuntimeError("the environment is closed")

    def close(self) -> None:
        """Let no more episodes begin nor go on; may be called again."""
        self._closed = True

    def _draw(self, lane: int) -> int:
        if len(self.scenarios) == 1:
            return 0
        bounds = np.cumsum(self._shares)
        return int(np.searchsorted(bounds / bounds[-1], self._draws[lane].random(), side="right"))


def read_seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """The seed of each of ``count`` lanes.

    Raises:
        ValueError: neither a seed nor one for each lane, or a seed out of range.
    """
    if seed is None:
        return [None] * count
    if isinstance(seed, (int, np.integer)):
        seed = [int(seed) + lane for lane in range(count)]
    elif not isinstance(seed, (Sequence, np.ndarray)) or isinstance(seed, str):
        raise ValueError(f"seed: {short(seed)}; allowed: a whole number, or one per lane")
    if len(seed) != count:
        raise ValueError(f"seed: {len(seed)} seeds for {count} lanes")
    for lane, own in enumerate(seed):
        whole = isinstance(own, (int, np.integer)) and not isinstance(own, bool)
        if own is not None and not (whole and 0 <= own < 2**63):
            raise ValueError(
                f"seed of lane {lane}: {short(own)}; allowed: whole numbers from 0 to 2^63 - 1"
            )
    return [None if own is None else int(own) for own in seed]


def load_all(
    scenario: str | Path | Scenario | Sequence[str | Path | Scenario], overrides: dict[str, Any]
) -> list[Scenario]:
    """One scenario or several, each with the same overrides.

    Raises:
        ScenarioError: unknown scenario or field, or a value out of range.
    """
    alone = isinstance(scenario, (str, Path, Scenario))
    names: Sequence[Any] = [scenario] if alone else scenario  # type: ignore[assignment]
    return [load_scenario(name, **overrides) for name in names]


def _check_alike(first: Scenario, other: Scenario, place: int) -> None:
    """See that two scenarios have the same robots and LiDAR.

    Args:
        first, other: the first of several, and another one.
        place: of the other one among them; variants of a scenario have the same name.

    Raises:
        ScenarioError: names the field and both values.
    """
    for section, own in _OWN.items():
        expected, found = getattr(first, section), getattr(other, section)
        for field in type(expected).model_fields:
            mine, others = getattr(expected, field), getattr(found, field)
            if field not in own and mine != others:
                raise ScenarioError(
                    f"scenario {place} ({other.name!r}): {section}.{field}: {others!r}, but "
                    f"{mine!r} in scenario 0 ({first.name!r}); all lanes need the same robots and "
                    "LiDAR"
                )
