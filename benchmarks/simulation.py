"""Speed and memory of the simulation on one core, with random actions and resets included.

Run ``python benchmarks/simulation.py [SCENARIO ...]``. Prints environment steps per second through
the PettingZoo API, what the stacked obstacle map of the learned agents costs on top, the start-up
time of the command line, and the memory of 32 environments in one process.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time

import numpy as np
from crowdbench_agents.learning.perception import ObstacleMap
from rich.console import Console
from rich.table import Table

import crowdbench

STEPS, REPEATS = 10_000, 5


def steps_per_second(scenario: str) -> tuple[float, float]:
    """Median over repeats, and the share of resets in the time."""
    env = crowdbench.parallel_env(scenario)
    env.reset(seed=0)
    rates, shares = [], []
    for repeat in range(REPEATS + 1):
        actions = np.random.default_rng(repeat).uniform([0, -1.5], [1, 1.5], (STEPS, 2))
        begin, resetting = time.perf_counter(), 0.0
        for action in actions.astype(np.float32):
            env.step({"robot_0": action})
            if not env.agents:
                moment = time.perf_counter()
                env.reset()
                resetting += time.perf_counter() - moment
        duration = time.perf_counter() - begin
        rates.append(STEPS / duration)
        shares.append(resetting / duration)
    # The first repeat loads compiled kernels.
    return float(np.median(rates[1:])), float(np.median(shares[1:]))


def map_microseconds(scenario: str) -> float:
    """Median cost of moving eight scans into the robot frame."""
    env = crowdbench.parallel_env(scenario)
    observation = env.reset(seed=0)[0]["robot_0"]
    robot = env.robot_spec()
    stack = ObstacleMap(robot.lidar_angles, robot.lidar_range)
    costs = []
    for _ in range(2_000):
        begin = time.perf_counter()
        stack.update(observation["lidar"], observation["pose"])
        costs.append(time.perf_counter() - begin)
    return float(np.median(costs)) * 1e6


def startup_seconds(*arguments: str) -> float:
    """Median wall time of a fresh Python process."""
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def memory_of_32() -> float:
    """Peak memory of this process with 32 environments that have run [MB]."""
    envs = [crowdbench.parallel_env("multimodal_fast") for _ in range(32)]
    for seed, env in enumerate(envs):
        env.reset(seed=seed)
        for _ in range(20):
            if env.agents:
                env.step({"robot_0": (0.5, 0.1)})
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenarios", nargs="*", default=["multimodal_fast", "corridor_very_dense"])
    console = Console()
    memory = memory_of_32()
    table = Table("scenario", "steps/s", "of that resets", "obstacle map, us/step")
    for scenario in parser.parse_args().scenarios:
        rate, share = steps_per_second(scenario)
        table.add_row(scenario, f"{rate:,.0f}", f"{share:.0%}", f"{map_microseconds(scenario):.1f}")
    console.print(table)
    console.print(f"32 environments in one process: {memory:.0f} MB peak")
    console.print(f"import crowdbench: {startup_seconds('-c', 'import crowdbench'):.2f} s")
    console.print(f"crowdbench --help: {startup_seconds('-m', 'crowdbench.cli', '--help'):.2f} s")


if __name__ == "__main__":
    main()
