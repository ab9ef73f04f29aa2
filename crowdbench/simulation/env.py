"""Robots with LiDAR among pedestrians, as a PettingZoo parallel environment.

Description
-----------
One or more robots each have to reach a goal on the far side of a crowd, or of a corridor, without
touching anybody or anything. Pedestrians walk to goals of their own. Reactive ones see the robots
and evade them, non-reactive ones do not. A scenario says what the world is like.

The agents are ``robot_0``, ``robot_1``, ... With ``pedestrians.control: agents`` the pedestrians
are agents too, ``pedestrian_0``, ``pedestrian_1``, ...

Action space
------------
Robots: ``Box(2,)``, held for one control period (``control_period``, 0.2 s). Actions out of range
are clipped, then limited by ``robots.acceleration`` where the scenario has such limits. With
``robots.latency`` they act that many control periods later; until the first one does the robot
stands. The first number is the forward speed (``robots.speed``, 0 to 1 m/s), the second is the
drive's (left > 0):

===================  ======================================================================
``robots.drive``     second number of an action
===================  ======================================================================
``differential``     turn rate (``robots.turn_rate``, -1.5 to 1.5 rad/s)
``omnidirectional``  sideways speed (``robots.lateral_speed``, -1 to 1 m/s); it never turns
===================  ======================================================================

Pedestrians: ``Box(2,)``, desired velocity in the world frame, -2 to 2 m/s along x and y. A
pedestrian without an action walks by itself.

A non-finite or wrongly shaped action is refused with an error that names the agent, and so is a
missing one of a robot that is still in the scene.

Observation space
-----------------
Robots: ``Dict`` of float32.

============  ==========  ==================================================================
key           shape       meaning
============  ==========  ==================================================================
``lidar``     (beams,)    distance from the LiDAR (``lidar.mount``, the robot's centre) to the
                          nearest surface along each beam [m], ``lidar.range`` where nothing is
                          hit; a full circle starts ahead of it and goes counter-clockwise
``velocity``  (2,)        what the drive does, in the terms of its actions
``goal``      (2,)        goal in the robot frame, x ahead, y left [m]; on a map, a point ahead
                          on the shortest path to it, which a straight line reaches
``pose``      (3,)        odometry since reset: x, y [m], heading [rad]; starts at zero, and
                          drifts by ``robots.odometry``
``map``       (cells,     uint8, where ``obstacle_map`` is given: bit k of a cell says that
              cells)      something was there in the scan k steps ago, k = 0 .. 7; drawn from
                          where the robot will be when its next action begins to act
============  ==========  ==================================================================

Pedestrians: ``Dict`` of float32, in world axes; everything but ``velocity`` is relative to the
pedestrian. R robots, P pedestrians.

===============  ===========  ==============================================================
key              shape        meaning
===============  ===========  ==============================================================
``velocity``     (2,)         its own velocity [m/s]
``goal``         (2,)         offset to its current goal, or the next point of its way there [m]
``robots``       (R, 4)       offset [m] and relative velocity [m/s] of each robot; zeros for
                              one that has left the scene
``pedestrians``  (P - 1, 4)   the same of every other pedestrian
===============  ===========  ==============================================================

``state()`` is everything there is, hidden intents included, as a dictionary of arrays in world
coordinates; ``state_space`` has its keys and shapes. No agent that is to be compared may use it.

Starting state
--------------
Drawn from the episode seed. In the open, robots start on a circle of diameter ``robots.travel``
with their goals opposite; in a corridor, ``robots.travel`` metres from them along it; where several
robots leave no room there, on lines elsewhere in the arena. ``robots.start`` and ``robots.goal``
say other places, as on every map. Both ends lie inside the arena. Robots stand still and face their
goals, or the first stretch of the path, to within 30 degrees. Obstacles and pedestrians lie at
random without overlap, pedestrians at least ``pedestrians.spawn_clearance`` from every robot and
already walking.

Rewards
-------
Robots: the sum of three terms (paper, section III.B), weights in the scenario's ``reward``; their
defaults are given here.

- ``goal``: 20 on arrival, else 9 per metre gained towards the goal, on a map along the path.
- ``collision``: -60 on contact, else -0.4 (1 - d / 1.25 m) where the nearest surface is
  d < 1.25 m from the LiDAR.
- ``social``: 0.2 (1 - d / 1.2 m), negative for cutting in front of a walking pedestrian that would
  come nearer than 1.2 m within 2 s, positive for yielding where full speed would have cut in.

Pedestrians: metres gained towards their current goal, or the next point of their way there.

Episode end
-----------
A robot terminates on arrival (within ``robots.goal_tolerance``, 0.3 m) or on any contact, and
leaves the scene; one that touches something while arriving has collided. At ``time_limit``
everybody still there is truncated, pedestrians as soon as the last robot is gone.

Information
-----------
After ``step``, for robots:

================  ===================================================================
key               meaning
================  ===================================================================
``outcome``       ``running``, ``success``, ``collision`` or ``timeout``
``reward_terms``  the terms above by name, weighted; they add up to the reward
``contact``       what was touched and how fast both closed in, or None
================  ===================================================================

Empty for pedestrians, and after ``reset``: some libraries take what they find there for numbers.

Copies
------
``copy.deepcopy(env)`` and ``pickle`` give an environment that goes on exactly as this one would.
A copy is scenario, seed and actions so far, simulated again: it costs as much as the episode so
far, about a tenth of a millisecond per step, and has no window.

Making one
----------
``crowdbench.parallel_env`` does; once ``crowdbench`` has been imported,
``pettingzoo.make("parallel", "crowdbench/crowd-v0", ...)`` too, and for one robot
``gymnasium.make("crowdbench:CrowdNav-v0", ...)``.

Version history
---------------
v0 is the first. What happens with the same scenario, seed and actions changes only with the world's
version; ``crowdbench.simulation`` says what each has changed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from crowdbench.robot import RobotSpec
from crowdbench.scenario import Scenario, load_scenario
from crowdbench.simulation import observations, streams
from crowdbench.simulation.kinematics import make_drive
from crowdbench.simulation.map_layout import places_of
from crowdbench.simulation.obstacle_map import MapGeometry
from crowdbench.simulation.routes import routes_of
from crowdbench.simulation.sensing import as_observation
from crowdbench.simulation.substeps import check_speeds
from crowdbench.simulation.world import World

RenderMode = Literal["human", "rgb_array"]
StepResult = tuple[
    dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]
]

PEDESTRIAN_TOP_SPEED = 2.0
"""Limit on either component of a pedestrian agent's velocity [m/s]."""


def parallel_env(
    scenario: str | Path | Scenario = "multimodal_fast",
    render_mode: RenderMode | None = None,
    obstacle_map: MapGeometry | None = None,
    **overrides: Any,
) -> CrowdEnv:
    """Make the PettingZoo parallel environment of a scenario.

    Args:
        scenario: name of a built-in scenario, path of a YAML file, or a Scenario.
        render_mode: ``human`` (a window), ``rgb_array`` or None.
        obstacle_map: where the image lies as which robots also observe the last eight scans
            (``ObstacleMap``), ``MapGeometry()`` for that of learned agents; None: they have none.
        overrides: scenario fields, nested (``pedestrians={"count": 12}``) or dotted.

    Raises:
        ScenarioError: unknown scenario or field, or a value out of range.
    """
    return CrowdEnv(load_scenario(scenario, **overrides), render_mode, obstacle_map)


class CrowdEnv(ParallelEnv):
    """Robots among pedestrians; the docstring of ``crowdbench.simulation.env`` describes it.

    Attributes:
        scenario: the world that is simulated.
        possible_agents: ``robot_0``, ... and, where they are agents, ``pedestrian_0``, ...
        agents: those that still take part in the episode.
        state_space: keys and shapes of ``state()``.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo's, adapted per instance
        "name": "crowdbench/crowd-v0",
        "render_modes": ["human", "rgb_array"],
        "is_parallelizable": True,
        "render_fps": 5,
    }

    def __init__(
        self,
        scenario: Scenario,
        render_mode: RenderMode | None = None,
        obstacle_map: MapGeometry | None = None,
    ) -> None:
        """Prepare the spaces; the world is built by ``reset``.

        Raises:
            ValueError: an unknown render mode.
            ScenarioError: the drive cannot be used, bodies are too fast for their size, or a region
                has no room.
        """
        if render_mode not in (None, *(modes := self.metadata["render_modes"])):
            raise ValueError(f"render_mode {render_mode!r}: expected None or one of {modes}")
        self.scenario = scenario
        self.render_mode = render_mode
        self._obstacle_map = obstacle_map
        fps = round(1 / scenario.control_period, 6)
        whole = int(fps) if fps.is_integer() and fps > 0 else 1 / scenario.control_period
        self.metadata = {**type(self).metadata, "render_fps": whole}
        self._robots = [f"robot_{r}" for r in range(scenario.robots.count)]
        steered = scenario.pedestrians.count if scenario.pedestrians.control == "agents" else 0
        self._walkers = {f"pedestrian_{p}": p for p in range(steered)}
        self.possible_agents = [*self._robots, *self._walkers]
        self.agents: list[str] = []
        drive = make_drive(scenario)
        self.action_spaces, self.observation_spaces = observations.agent_spaces(
            scenario, drive, self._robots, list(self._walkers), PEDESTRIAN_TOP_SPEED, obstacle_map
        )
        steered_speed = math.hypot(PEDESTRIAN_TOP_SPEED, PEDESTRIAN_TOP_SPEED) if steered else 0.0
        check_speeds(scenario, drive, max(scenario.pedestrians.speed[1], steered_speed))
        places_of(scenario), routes_of(scenario)  # what they refuse
        self.state_space = observations.state_space(scenario)
        self._low, self._high = drive.low, drive.high
        self._max_steps = scenario.max_steps
        self._next_seed: np.random.Generator | None = None
        self._renderer: Any = None
        self._world: World | None = None

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The agent's observation space, always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The agent's action space, always the same object."""
        return self.action_spaces[agent]

    def robot_spec(self, agent: str = "robot_0") -> RobotSpec:
        """What a planner may know about a robot; its goal once the environment has been reset."""
        spec = RobotSpec.from_scenario(self.scenario, agent)
        if self._world is None or agent not in self._robots:
            return spec
        return replace(spec, goal=observations.final_goal(self._world, self._robots.index(agent)))

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: fixes everything that happens except what agents decide; None draws the next
                one from the last seed given (or from the operating system).
            options: ignored; there are none.

        Returns:
            Observations and (empty) infos by agent.

        Raises:
            ScenarioError: the scenario has no room.
        """
        if seed is None:
            if self._next_seed is None:
                self._next_seed = np.random.default_rng()
            seed = int(self._next_seed.integers(2**31))
        else:
            self._next_seed = streams.next_episode(seed)
        seen = self._begin(seed)
        if self.render_mode == "human":
            self.render()
        return seen, {name: {} for name in self.agents}

    def _begin(self, seed: int) -> dict[str, Any]:
        """Build the world of an episode; observations by agent."""
        if self._world is None:
            self._world = World(self.scenario, seed, self._obstacle_map)
        else:
            self._world.begin(seed)
        self._seed = seed
        self._taken: list[tuple[NDArray[np.float64], dict[int, NDArray[np.float64]]]] = []
        self._steps = 0
        self.agents = list(self.possible_agents)
        seen: dict[str, Any] = observations.observe_robots(self._world, self._robots)
        return seen | observations.observe_pedestrians(self._world, self._walkers)

    def __getstate__(self) -> dict[str, Any]:
        """What fixes the episode so far; ``copy.deepcopy`` and ``pickle`` take this."""
        return {
            "scenario": self.scenario,
            "render_mode": self.render_mode,
            "obstacle_map": self._obstacle_map,
            "spaces": (self.action_spaces, self.observation_spaces),
            "next_seed": self._next_seed,
            "episode": None if self._world is None else (self._seed, self._taken),
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Simulate the episode so far again: physics cannot be copied, but is exact."""
        self.__init__(*(state[key] for key in ("scenario", "render_mode", "obstacle_map")))  # type: ignore[misc]
        self.action_spaces, self.observation_spaces = state["spaces"]
        self._next_seed = state["next_seed"]
        if state["episode"] is not None:
            seed, taken = state["episode"]
            self._begin(seed)
            for actions in taken:
                self._advance(*actions)
            self._taken = taken

    def step(self, actions: Mapping[str, Any]) -> StepResult:
        """Advance everybody by one control period.

        Args:
            actions: (2,) per robot still in the scene, optionally per pedestrian agent.

        Returns:
            Observations, rewards, terminations, truncations and infos, each by agent.

        Raises:
            ValueError: a missing, non-finite or wrongly shaped action, or an unknown agent.
            RuntimeError: ``reset`` has not been called.
        """
        world = self._world
        if world is None:
            raise RuntimeError("call reset() before step()")
        if not self.agents:
            return {}, {}, {}, {}, {}
        commands, walking = observations.read_actions(world, actions, self._robots, self._walkers)
        commands = np.minimum(np.maximum(commands, self._low), self._high)
        top = PEDESTRIAN_TOP_SPEED
        walking = {p: np.clip(velocity, -top, top) for p, velocity in walking.items()}
        result = self._advance(commands, walking)
        self._taken.append((commands, walking))
        if self.render_mode == "human":
            self.render()
        return result

    def _advance(
        self, commands: NDArray[np.float64], walking: dict[int, NDArray[np.float64]]
    ) -> StepResult:
        """One control period with actions (R, 2) and velocities (2,) within their limits."""
        world = self._world
        assert world is not None
        before = world.pedestrians.position.copy()
        world.step(commands, walking)
        self._steps += 1
        late = self._steps >= self._max_steps
        seen: dict[str, Any] = observations.observe_robots(world, self._robots)
        world.judge()
        acted = {name: self._robots.index(name) for name in seen}
        rewards, terminations, truncations, infos = observations.results(world, acted, late)
        for name, ended in terminations.items():
            if ended:
                world.remove(self._robots.index(name))
        over = late or not world.active.any()
        seen |= observations.observe_pedestrians(world, self._walkers)
        rewards |= observations.progress(world, before, self._walkers)
        for name in self._walkers:
            terminations[name], truncations[name], infos[name] = False, over, {}
        ended_now = {name for name in seen if terminations[name] or truncations[name]}
        self.agents = [name for name in self.agents if name not in ended_now]
        return seen, rewards, terminations, truncations, infos

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything about the world, as copies; keys and shapes as in ``state_space``.

        Hidden intents are included: for privileged agents, replay and tests.

        Raises:
            RuntimeError: ``reset`` has not been called.
        """
        if self._world is None:
            raise RuntimeError("call reset() before state()")
        return observations.state(self._world)

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the present state: an (H, W, 3) image, or None in ``human`` mode."""
        if self.render_mode is None or self._world is None:
            return None
        if self._renderer is None:
            from crowdbench.simulation.rendering import Renderer

            self._renderer = Renderer(self.scenario, self.render_mode)
        scans = as_observation(self._world.seen)["lidar"]
        return self._renderer.draw(self.state(), dict(zip(self._robots, scans, strict=True)))

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
