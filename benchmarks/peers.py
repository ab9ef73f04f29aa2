"""Peers of the simulation in a scene like ``multimodal_fast``, for ``simulation.py --peers``.

Run by a Python that has the peer (``pip install navground navground-learning pettingzoo`` or
``ir-sim``), as ``python peers.py navground|irsim``. For each line that it reads it takes a thousand
steps with random actions, resets included, and prints how many these were per second of processor
time.

One robot with 180 beams of 6 m among six people who avoid each other by ORCA (in IR-SIM, RVO), at
0.7 to 1 m/s in 10 x 10 m, 0.2 s a step, 40 s an episode.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

STEPS = 1000
PEOPLE = 6

NAVGROUND = f"""
groups:
  - type: robot
    number: 1
    radius: 0.25
    control_period: 0.2
    kinematics: {{type: 2WDiff, wheel_axis: 0.3, max_speed: 1.0}}
    behavior: {{type: Dummy, optimal_speed: 1.0}}
    task: {{type: Waypoints, waypoints: [[4, 0]], tolerance: 0.3}}
    position: [-4, 0]
  - type: person
    number: {PEOPLE}
    radius: 0.25
    control_period: 0.2
    kinematics: {{type: Omni, max_speed: 1.0}}
    behavior: {{type: ORCA, optimal_speed: 0.85, time_horizon: 2.0, horizon: 5.0}}
    state_estimation: {{type: Bounded, range: 5.0}}
    task:
      type: Waypoints
      waypoints: [[4, 4], [-4, -4], [4, -4], [-4, 4]]
      tolerance: 0.3
      loop: true
      random: true
    position: {{sampler: uniform, from: [-3, -4.5], to: [4.5, 4.5]}}
"""

IRSIM = f"""
world: {{width: 10, height: 10, offset: [-5, -5], step_time: 0.2, sample_time: 0.2,
         collision_mode: unobstructed, control_mode: auto}}
robot:
  - kinematics: {{name: diff}}
    shape: {{name: rectangle, length: 0.4, width: 0.3}}
    state: [-4, 0, 0]
    goal: [4, 0, 0]
    vel_min: [0, -1.5]
    vel_max: [1, 1.5]
    sensors:
      - {{type: lidar2d, range_min: 0, range_max: 6, angle_range: 6.28, number: 180}}
obstacle:
  - number: {PEOPLE}
    distribution: {{name: random, range_low: [-4, -4, -3.14], range_high: [4, 4, 3.14]}}
    kinematics: {{name: omni}}
    behavior: {{name: rvo, wander: true, range_low: [-4, -4, -3.14], range_high: [4, 4, 3.14]}}
    shape: {{name: circle, radius: 0.25}}
    vel_max: [1, 1]
"""


def navground() -> Callable[[np.ndarray], None]:
    """Return a step of navground through its PettingZoo environment."""
    from navground.learning import ControlActionConfig, DefaultObservationConfig, Indices
    from navground.learning.parallel_env import shared_parallel_env

    env = shared_parallel_env(
        scenario=NAVGROUND,
        indices=Indices([0]),
        sensor={"type": "Lidar", "resolution": 180, "range": 6.0, "field_of_view": 2 * np.pi},
        action=ControlActionConfig(max_speed=1.0, max_angular_speed=1.5),
        observation=DefaultObservationConfig(
            include_target_direction=True,
            include_target_distance=True,
            include_velocity=True,
            include_angular_speed=True,
        ),
        time_step=0.2,
        max_duration=40.0,
        include_action=False,
    )
    env.reset(seed=0)

    def step(action: np.ndarray) -> None:
        env.step({0: action})
        if not env.agents:
            env.reset()

    return step


def irsim() -> Callable[[np.ndarray], None]:
    """Return a step of IR-SIM."""
    import irsim

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.yaml"
        path.write_text(IRSIM)
        env: Any = irsim.make(str(path), headless=True, log_level="ERROR")
    count = 0

    def step(action: np.ndarray) -> None:
        nonlocal count
        env.step(np.array([[(action[0] + 1) / 2], [1.5 * action[1]]]))
        env.get_lidar_scan()
        count += 1
        if count % 200 == 0:
            env.reset()

    return step


def main() -> None:
    """Print a rate for every line read."""
    step = {"navground": navground, "irsim": irsim}[sys.argv[1]]()
    actions = np.random.default_rng(0).uniform(-1, 1, (STEPS, 2)).astype(np.float32)
    for _ in sys.stdin:
        begin = time.process_time()
        for action in actions:
            step(action)
        print("rate", STEPS / (time.process_time() - begin), flush=True)


if __name__ == "__main__":
    main()
